//! `/v1/sources`

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use isophote_wire::{Items, SourceDocument, SourceView};

use super::paging::{PageQuery, RawPage, page};
use super::parameters::{MatchHeaders, NameParam};
use super::{Answer, App, RawName, listed, new_name, old_name, opened_ahead, put_status, raw, stateful, tagged};
use crate::http::documents::{place, read_json};
use crate::http::preconditions::Preconditions;
use crate::service::compiler::Owner;
use crate::service::declared::Keeping;
use crate::source::Taker;

/// Creates or replaces a source.
#[utoipa::path(put, path = "/v1/sources/{name}", tag = "sources", operation_id = "put_source", params(NameParam, MatchHeaders),
    request_body = SourceDocument,
    responses((status = 201, description = "The source was created.", body = SourceView),
              (status = 200, description = "The source was replaced.", body = SourceView)))]
pub async fn put(app: App, name: RawName, preconditions: Preconditions, headers: HeaderMap, body: Body) -> Answer {
    let name = new_name(name)?;
    app.service.check_source(name.as_str(), &preconditions)?;
    let (mut document, text) = read_json::<SourceDocument>(&headers, body).await?;
    let taker = Taker::Source(name.clone());
    let opened = place(opened_ahead(&app, &mut document, &taker, None).await, &text).await?;
    let service = app.service.clone();
    let work = move |owner: &mut Owner| {
        service.check_source(name.as_str(), &preconditions)?;
        let put = service.put_source(owner, &name, document, opened, Keeping::Declared)?;
        Ok((put, service.source_tag(name.as_str())?, service.source_view(name.as_str())?))
    };
    let (put, tag, view) = place(app.service.compiler.run(work).await, &text).await?;
    tagged(put_status(put), &view, Some(&tag))
}

/// Returns a source and its state.
#[utoipa::path(get, path = "/v1/sources/{name}", tag = "sources", operation_id = "get_source", params(NameParam, MatchHeaders),
    responses((status = 200, description = "Document and state of the source.", body = SourceView)))]
pub async fn get(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let name = raw(name)?;
    let tag = app.service.source_tag(&name)?; // before the view, as for a session
    let view = app.service.source_view(&name)?;
    stateful(&preconditions, &format!("the source `{name}`"), Some(&tag), &view)
}

/// Stops and removes a source that no session uses.
#[utoipa::path(delete, path = "/v1/sources/{name}", tag = "sources", operation_id = "delete_source", params(NameParam, MatchHeaders),
    responses((status = 204, description = "The source was removed.")))]
pub async fn delete(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    let name = old_name("source", name)?;
    let service = app.service.clone();
    let work = move |owner: &mut Owner| {
        service.source_tag(name.as_str())?; // 404 before 412
        service.check_source(name.as_str(), &preconditions)?;
        service.remove_source(owner, &name)
    };
    app.service.compiler.run(work).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// Lists all named sources by name.
#[utoipa::path(get, path = "/v1/sources", tag = "sources", operation_id = "list_sources", params(PageQuery),
    responses((status = 200, description = "All sources, or one page of them.", body = Items<SourceView>)))]
pub async fn list(app: App, query: RawPage, preconditions: Preconditions) -> Answer {
    listed(&preconditions, &page(query, app.service.source_views(), |view| view.name.as_str(), Clone::clone)?)
}
