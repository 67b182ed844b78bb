//! `/v1/models`

use axum::body::Body;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Extension, Query, Request};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use isophote_machine::monotonic_ns;
use isophote_wire::{
    CheckAnswer, Explanation, Items, ModelAnswer, ModelItem, ModelView, RollbackDocument, VersionList, explain,
};
use serde::Deserialize;
use utoipa::IntoParams;

use super::paging::{PageQuery, RawPage, page};
use super::parameters::{MatchHeaders, NameParam};
use super::{Answer, App, RawName, fit, json, listed, new_name, old_name, put_status, raw, representation, tagged};
use crate::access::Visitor;
use crate::http::documents::{media_type, read_body, read_json, text};
use crate::http::preconditions::Preconditions;
use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::{Media, ModelEntry};
use crate::service::Service;
use crate::service::compiler::Owner;
use crate::service::turns::FairWorkers;
use crate::service::workshop::Lane;
use crate::session::SlowModels;

/// A session that must be able to use a model; otherwise the model is not stored.
#[derive(Clone, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ModelUseQuery {
    /// Session that must be able to swap to the model; otherwise the request fails.
    swap: Option<String>,
    /// Session that must be able to fit the model as a shadow; otherwise the request fails.
    shadow: Option<String>,
}

impl ModelUseQuery {
    /// The error of a swap to it, or a shadow of it; changes nothing.
    fn check(&self, service: &Service, entry: &ModelEntry, workers: &FairWorkers) -> Result<(), Problem> {
        if let Some(session) = &self.swap {
            service.session(session)?.prepare_swap(entry, SlowModels::Refused, workers)?;
        }
        if let Some(session) = &self.shadow {
            service.session(session)?.check_shadow(entry, workers)?;
        }
        Ok(())
    }
}

/// Creates or replaces a model.
#[utoipa::path(put, path = "/v1/models/{name}", tag = "models", operation_id = "put_model",
    params(NameParam, MatchHeaders, ModelUseQuery),
    request_body(content((String = "application/toml"), (Object = "application/json")), description = "The model document."),
    responses((status = 201, description = "The model was created.", body = ModelAnswer),
              (status = 200, description = "The model was replaced.", body = ModelAnswer)))]
pub async fn put(
    app: App,
    Extension(visitor): Extension<Visitor>,
    name: RawName,
    preconditions: Preconditions,
    query: Result<Query<ModelUseQuery>, QueryRejection>,
    headers: HeaderMap,
    body: Body,
) -> Answer {
    let name = new_name(name)?;
    let Query(usage) = query.map_err(|error| Problem::bad_request(error.body_text()))?;
    keep_shipped(&app, &visitor, &name)?;
    app.service.registry.check(&name, &preconditions)?;
    let (media, text) = document(&headers, body).await?;
    let service = app.service.clone();
    let _in_order = service.workshop.in_order("model", name.as_str()).await;
    let (preparing, wanted, asked) = (service.clone(), name.clone(), preconditions.clone());
    let prepare = move |workers: &FairWorkers| {
        preparing.registry.check(&wanted, &asked)?;
        let prepared = preparing.check_model(&wanted, media, &text, workers)?;
        usage.check(&preparing, &prepared.0, workers)?;
        Ok(prepared)
    };
    let prepared = service.workshop.prepare(Lane::Uploads, prepare).await?;
    let committing = service.clone();
    let work = move |owner: &mut Owner| committing.put_model(owner, &name, &preconditions, prepared);
    let (put, entry, answer) = app.service.compiler.run(work).await?;
    tagged(put_status(put), &answer, Some(&entry.tag()))
}

/// Checks a model document without storing it.
#[utoipa::path(post, path = "/v1/models:check", tag = "models", operation_id = "check_model",
    request_body(content((String = "application/toml"), (Object = "application/json")), description = "The model document."),
    responses((status = 200, description = "Report of the check.", body = CheckAnswer)))]
pub async fn check(app: App, headers: HeaderMap, body: Body) -> Answer {
    let (media, text) = document(&headers, body).await?;
    let service = app.service.clone();
    let work = move |workers: &FairWorkers| {
        let name = Name::parse("check").ok_or_else(|| Problem::bug("check is a name"))?;
        service.check_model(&name, media, &text, workers)
    };
    let (entry, answer) = app.service.workshop.prepare(Lane::Uploads, work).await?;
    json(StatusCode::OK, &CheckAnswer { report: answer.report, formulas: explain::formulas(&entry.model) })
}

/// `POST /v1/models/{name}:{verb}`: dispatches by verb, since routes cannot match a part of a segment. The verbs' handlers
/// document themselves.
pub async fn act(
    app: App,
    Extension(visitor): Extension<Visitor>,
    name: RawName,
    uri: Uri,
    preconditions: Preconditions,
    headers: HeaderMap,
    body: Body,
) -> Answer {
    let name = raw(name)?;
    match name.split_once(':') {
        Some((_, "fit")) if preconditions != Preconditions::default() => Err(Preconditions::refusal()),
        Some((model, "fit")) => fit::post(app, model, &uri, &headers, body).await,
        Some((model, "rollback")) => roll_back(app, &visitor, (model, preconditions), &uri, &headers, body).await,
        Some((_, verb)) => Err(Problem::unknown("action of models", verb)),
        None => Err(Problem::wrong_method()), // `methods` answers this earlier
    }
}

/// Middleware: models and their actions share a route, but not the methods.
pub async fn methods(name: RawName, request: Request, next: Next) -> Response {
    let has_verb = raw(name).is_ok_and(|name| name.contains(':'));
    let allowed: &[Method] =
        if has_verb { &[Method::POST] } else { &[Method::GET, Method::HEAD, Method::PUT, Method::DELETE] };
    if allowed.contains(request.method()) {
        return next.run(request).await;
    }
    let allowed: Vec<&str> = allowed.iter().map(Method::as_str).collect();
    ([(header::ALLOW, allowed.join(","))], Problem::wrong_method()).into_response()
}

/// Makes a stored version of a model the active one.
#[utoipa::path(post, path = "/v1/models/{name}:rollback", tag = "models", operation_id = "roll_back_model",
    params(NameParam, MatchHeaders, ModelUseQuery), request_body = RollbackDocument,
    responses((status = 200, description = "The version is active.", body = ModelAnswer)))]
pub async fn roll_back(
    app: App,
    visitor: &Visitor,
    (name, preconditions): (&str, Preconditions),
    uri: &Uri,
    headers: &HeaderMap,
    body: Body,
) -> Answer {
    let usage = Query::<ModelUseQuery>::try_from_uri(uri);
    let Query(usage) = usage.map_err(|error| Problem::bad_request(error.body_text()))?;
    let name = Name::parse(name).ok_or_else(|| Problem::unknown("model", name))?;
    keep_shipped(&app, visitor, &name)?;
    let (document, _) = read_json::<RollbackDocument>(headers, body).await?;
    let (service, version) = (app.service.clone(), document.version);
    let _in_order = service.workshop.in_order("model", name.as_str()).await;
    let (preparing, wanted, asked) = (service.clone(), name.clone(), preconditions.clone());
    let prepare = move |workers: &FairWorkers| {
        preparing.registry.check(&wanted, &asked)?;
        let content = preparing.registry.version(&wanted, version)?;
        let prepared = preparing.check_model(&wanted, content.media, &content.text, workers)?;
        usage.check(&preparing, &prepared.0, workers)?;
        Ok(prepared)
    };
    let prepared = service.workshop.prepare(Lane::Uploads, prepare).await?;
    let committing = service.clone();
    let work = move |owner: &mut Owner| committing.roll_back_model(owner, &name, &preconditions, version, prepared);
    let (entry, answer) = app.service.compiler.run(work).await?;
    tagged(StatusCode::OK, &answer, Some(&entry.tag()))
}

/// Lists the versions of a model, newest first.
#[utoipa::path(get, path = "/v1/models/{name}/versions", tag = "models", operation_id = "list_versions", params(NameParam),
    responses((status = 200, description = "All stored versions.", body = VersionList)))]
pub async fn versions(app: App, name: RawName, preconditions: Preconditions) -> Answer {
    listed(&preconditions, &app.service.registry.versions(&raw(name)?)?)
}

/// Returns a model as JSON, or as the original TOML if it was sent as TOML and `Accept` names TOML.
#[utoipa::path(get, path = "/v1/models/{name}", tag = "models", operation_id = "get_model", params(NameParam, MatchHeaders),
    responses((status = 304, description = "The model is unchanged."),
              (status = 200, description = "The model.", content((ModelView = "application/json"), (String = "application/toml")))))]
pub async fn get(app: App, name: RawName, preconditions: Preconditions, headers: HeaderMap) -> Answer {
    let entry = app.service.registry.get(&raw(name)?)?;
    let accept = headers.get(header::ACCEPT).and_then(|accept| accept.to_str().ok()).unwrap_or_default();
    let (tag, response) = if accept.contains("application/toml") && entry.media == Media::Toml {
        let mut response = entry.text.to_string().into_response();
        response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/toml"));
        (entry.text_tag(), response)
    } else {
        (entry.tag(), json(StatusCode::OK, &entry.view())?)
    };
    let mut response = representation(&preconditions, &format!("the model `{}`", entry.name), &tag, response)?;
    response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept"));
    Ok(response)
}

/// Removes a model that no session uses.
#[utoipa::path(delete, path = "/v1/models/{name}", tag = "models", operation_id = "delete_model", params(NameParam, MatchHeaders),
    responses((status = 204, description = "The model was removed.")))]
pub async fn delete(
    app: App,
    Extension(visitor): Extension<Visitor>,
    name: RawName,
    preconditions: Preconditions,
) -> Answer {
    let name = old_name("model", name)?;
    keep_shipped(&app, &visitor, &name)?;
    let service = app.service.clone();
    app.service.compiler.run(move |owner| service.remove_model(owner, &name, &preconditions)).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// Lists all models by name.
#[utoipa::path(get, path = "/v1/models", tag = "models", operation_id = "list_models", params(PageQuery),
    responses((status = 200, description = "All models, or one page of them.", body = Items<ModelItem>)))]
pub async fn list(app: App, query: RawPage, preconditions: Preconditions) -> Answer {
    let all = app.service.registry.list();
    listed(&preconditions, &page(query, all, |entry| entry.name.as_str(), |entry| entry.item())?)
}

/// Options of an explanation.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ExplainQuery {
    /// Free parameters, e.g. `bx,by`; those of the last stage when absent.
    parameters: Option<String>,
    /// Text to return: `derivative` (the default), `sums`, `program`, `clif`, `asm`, `latex`, `mathml`, `formulas` or `table`.
    show: Option<String>,
    /// Method: `newton` (the default), `gauss-newton` or `levenberg-marquardt`.
    method: Option<String>,
}

/// Returns the derivation or the generated code of a model for a subset of its parameters.
#[utoipa::path(get, path = "/v1/models/{name}/explain", tag = "models", operation_id = "explain_model",
    params(NameParam, ExplainQuery), responses((status = 200, description = "Costs and text.", body = Explanation)))]
pub async fn explain(
    app: App,
    name: RawName,
    query: Result<Query<ExplainQuery>, QueryRejection>,
    preconditions: Preconditions,
) -> Answer {
    let entry = app.service.registry.get(&raw(name)?)?;
    let Query(query) = query.map_err(|error| Problem::bad_request(error.body_text()))?;
    let work = move |workers: &FairWorkers| {
        let subset = query.parameters.as_deref().map(explain::split);
        let show = query.show.as_deref().unwrap_or("derivative");
        let method = query.method.as_deref();
        let explain = || explain::explain(&entry.model, subset.as_deref(), method, show, &monotonic_ns);
        workers.piece(explain).map_err(Problem::from)
    };
    listed(&preconditions, &app.service.workshop.prepare(Lane::Uploads, work).await?)
}

/// Protects shipped models on services with tokens, so that they mean the same to all users.
fn keep_shipped(app: &App, visitor: &Visitor, name: &Name) -> Result<(), Problem> {
    if !visitor.is_known() || !app.service.registry.is_shipped(name) {
        return Ok(());
    }
    let detail =
        format!("`{name}` is shipped with the service and stays as it is; put the document under another name");
    Err(Problem::new(StatusCode::FORBIDDEN, "read-only", detail))
}

async fn document(headers: &HeaderMap, body: Body) -> Result<(Media, String), Problem> {
    let media = match media_type(headers).as_str() {
        "application/toml" => Media::Toml,
        "application/json" => Media::Json,
        _ => return Err(Problem::wrong_type("application/toml or application/json")),
    };
    Ok((media, text(read_body(body, LIMITS.document_bytes).await?)?))
}
