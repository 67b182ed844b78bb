//! `GET /openapi.json`: the API in OpenAPI 3.1, from the attributes of the handlers and the wire types.
//!
//! A new route needs three lines: `#[utoipa::path(…)]` on its handler, the handler's name in `paths` below, and the route in
//! `mod.rs`. The tests at the end report what is missing. `UPDATE_EXPECT=1 cargo test -p isophote-server openapi` rewrites the
//! same text in `docs/openapi.json`.

use std::sync::OnceLock;

use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use isophote_tracker::Target;
use isophote_wire::{CreditDocument, FrameTime, PreviewHeader, ProblemDocument};
use utoipa::openapi::path::Operation;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{ContentBuilder, KnownFormat, ObjectBuilder, Ref, RefOr, ResponseBuilder, SchemaFormat, Type};
use utoipa::{Modify, OpenApi};

use super::{
    Answer, cameras, control, docs, estimates, fit, frames, health, metrics, models, page, playback, preview,
    recordings, schemas, sessions, shadow, sources,
};
use crate::problem::Problem;

#[derive(OpenApi)]
#[openapi(
    info(title = "isophote", description = "Models, sources, sessions and their estimates. Errors are problem documents (RFC 9457)."),
    paths(
        page::html, page::script, page::style, page::part, docs::start, docs::index, docs::page, get, health::livez, health::readyz, health::time, metrics::get,
        models::list, models::check, models::put, models::get, models::delete, models::explain, fit::post,
        models::versions, models::roll_back,
        cameras::list, cameras::get, cameras::set,
        sources::list, sources::put, sources::get, sources::delete,
        playback::scene, playback::set_scene, playback::playback, playback::set_playback,
        control::get, control::put, control::delete,
        sessions::list, sessions::put, sessions::get, sessions::delete, sessions::swap,
        frames::post, frames::get, estimates::get, preview::get,
        shadow::put, shadow::get, shadow::delete, shadow::promote,
        recordings::put, recordings::get, recordings::delete, recordings::list, recordings::read, recordings::remove,
    ),
    components(schemas(ProblemDocument, CreditDocument, FrameTime, PreviewHeader, Target)),
    tags((name = "models"), (name = "sources"), (name = "sessions"), (name = "cameras"),
         (name = "operation", description = "Health, metrics, time, web page and book.")),
    modifiers(&Problems, &Bytes, &Tokens)
)]
struct Description;

/// Adds the problem document as the default response.
struct Problems;

impl Modify for Problems {
    fn modify(&self, api: &mut utoipa::openapi::OpenApi) {
        for item in api.paths.paths.values_mut() {
            let operations = [&mut item.get, &mut item.put, &mut item.post, &mut item.delete];
            operations.into_iter().flatten().for_each(with_problem);
        }
    }
}

fn with_problem(operation: &mut Operation) {
    let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("ProblemDocument"))).build();
    let response = ResponseBuilder::new()
        .description("An error; `code` identifies its kind.")
        .content("application/problem+json", content);
    operation.responses.responses.insert("default".into(), response.build().into());
}

/// Describes images and pixels as binary.
struct Bytes;

impl Modify for Bytes {
    fn modify(&self, api: &mut utoipa::openapi::OpenApi) {
        let posts =
            api.paths.paths.values_mut().filter_map(|item| match item.post.as_mut()?.request_body.as_mut()? {
                RefOr::T(body) => Some(body),
                RefOr::Ref(_) => None,
            });
        let contents = posts.flat_map(|body| body.content.iter_mut());
        let is_bytes = |media: &str| media.starts_with("image/") || media == "application/octet-stream";
        for (_, content) in contents.filter(|(media, _)| is_bytes(media)) {
            let format = SchemaFormat::KnownFormat(KnownFormat::Binary);
            let bytes = ObjectBuilder::new().schema_type(Type::String).format(Some(format));
            *content = RefOr::T(ContentBuilder::new().schema(Some(bytes)).build());
        }
    }
}

/// Adds the token that services off loopback require.
struct Tokens;

impl Modify for Tokens {
    fn modify(&self, api: &mut utoipa::openapi::OpenApi) {
        let description =
            "Token from `isophote token new`; WebSockets may send it as the subprotocol `isophote.token.TOKEN`.";
        let bearer = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some(description)).build();
        let components = api.components.get_or_insert_default();
        components.add_security_scheme("token", SecurityScheme::Http(bearer));
        let none = SecurityRequirement::default(); // on loopback, where no tokens were made
        api.security = Some(vec![none, SecurityRequirement::new::<_, _, String>("token", [])]);
    }
}

/// The description as JSON text.
fn text() -> Result<&'static str, Problem> {
    static TEXT: OnceLock<Option<String>> = OnceLock::new();
    let text = TEXT.get_or_init(|| {
        let mut api = serde_json::to_value(Description::openapi()).ok()?;
        schemas::compose(api["components"]["schemas"].as_object_mut()?);
        serde_json::to_string_pretty(&api).map(|text| text + "\n").ok()
    });
    text.as_deref().ok_or_else(|| Problem::bug("the description of the API is no JSON"))
}

/// Returns this document.
#[utoipa::path(get, path = "/openapi.json", tag = "operation", operation_id = "openapi",
    responses((status = 200, description = "OpenAPI 3.1.", body = Object)))]
pub async fn get() -> Answer {
    let headers = [(header::CONTENT_TYPE, "application/json")];
    Ok((StatusCode::OK, headers, text()?).into_response())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::collections::BTreeSet;
    use std::path::Path;

    const METHODS: [&str; 4] = ["get", "put", "post", "delete"];

    #[test]
    fn the_committed_description_is_up_to_date() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/openapi.json");
        if std::env::var_os("UPDATE_EXPECT").is_some() {
            std::fs::write(&path, text().unwrap()).unwrap();
        }
        let page = std::fs::read_to_string(path).unwrap_or_default();
        let is_same = page == text().unwrap();
        assert!(is_same, "docs/openapi.json is old: UPDATE_EXPECT=1 cargo test -p isophote-server openapi writes it");
    }

    /// Path and method of each route in the source, except those that answer that this build lacks them.
    fn routed(source: &str) -> BTreeSet<(String, String)> {
        let mut found = BTreeSet::new();
        for call in source.split(".route(").skip(1) {
            let (path, handlers) = call.trim_start().trim_start_matches('"').split_once('"').unwrap();
            for method in METHODS {
                let head = format!("{method}(");
                let is_apart = |at: usize| handlers[..at].ends_with([' ', '.']);
                let at = handlers.match_indices(&head).map(|(at, _)| at).find(|at| is_apart(*at));
                if at.is_some_and(|at| !handlers[at + head.len()..].starts_with("|| absent(")) {
                    // OpenAPI has no wildcard for further segments.
                    found.insert((path.replace("{*", "{"), method.to_string()));
                }
            }
        }
        found
    }

    /// The same of the description; a verb after a name has no route of its own.
    fn described() -> BTreeSet<(String, String)> {
        let api: serde_json::Value = serde_json::from_str(text().unwrap()).unwrap();
        let paths = api["paths"].as_object().unwrap().iter();
        let of = |(path, item): (&String, &serde_json::Value)| {
            let path = path.split_once("}:").map_or(path.clone(), |(path, _)| format!("{path}}}"));
            METHODS
                .iter()
                .filter(|method| item[**method].is_object())
                .map(|method| (path.clone(), method.to_string()))
                .collect::<Vec<_>>()
        };
        paths.flat_map(of).collect()
    }

    #[test]
    fn every_route_is_described() {
        let source = include_str!("mod.rs");
        let routes = routed(source.split_once("pub fn full()").unwrap().0);
        assert!(routes.len() > 20, "{routes:?}");
        let (described, remedy) = (described(), "give the handler #[utoipa::path(…)] and name it in openapi.rs");
        let missing: Vec<_> = routes.difference(&described).collect();
        assert!(missing.is_empty(), "not described: {missing:?}; {remedy}");
        let extra: Vec<_> = described.difference(&routes).collect();
        assert!(extra.is_empty(), "described, but no route of mod.rs: {extra:?}");
    }

    #[test]
    fn routes_are_found_in_the_source() {
        let source = ".route(\"/a/{b}\", put(a::put).get(b::get))\n.route(\"/c\", post(|| absent(\"c\")).delete(c::delete))\n\
             .route(\"/d/{*e}\", get(d::get))";
        let found: Vec<_> = routed(source).into_iter().map(|(path, method)| format!("{method} {path}")).collect();
        assert_eq!(found, ["get /a/{b}", "put /a/{b}", "delete /c", "get /d/{e}"]);
    }

    /// Every reference resolves, and operation ids are unique.
    #[test]
    fn references_resolve_and_operation_ids_are_unique() {
        let text = text().unwrap();
        let api: serde_json::Value = serde_json::from_str(text).unwrap();
        assert_eq!(api["openapi"], "3.1.0");
        let named = text.split("\"#/components/schemas/").skip(1).map(|rest| rest.split('"').next().unwrap());
        let lost: BTreeSet<&str> = named.filter(|name| api["components"]["schemas"][name].is_null()).collect();
        assert!(lost.is_empty(), "{lost:?}");
        let ids: Vec<&str> =
            text.split("\"operationId\": \"").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
        assert_eq!(ids.iter().collect::<BTreeSet<_>>().len(), ids.len(), "{ids:?}");
        assert!(text.matches("application/problem+json").count() >= ids.len());
    }
}
