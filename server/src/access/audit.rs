//! Logs requests that change something, with their token and status.

use axum::http::{Method, StatusCode};

use super::keyring::{TokenOwner, Visitor};

/// Requests with a writing method that change nothing lasting.
const CHANGELESS: [(&str, &str); 3] =
    [("POST", "/v1/sessions/{name}/frames"), ("POST", "/v1/models:check"), ("POST", "/v1/models/{name}:fit")];

/// Changes by sliders and leases, many times a second: logged at debug.
const FREQUENT: [&str; 3] = ["/v1/sources/{name}/scene", "/v1/sources/{name}/playback", "/v1/sources/{name}/control"];

/// A request with a token that may change something.
pub struct ChangeRequest {
    owner: TokenOwner,
    method: Method,
    path: String,
    is_frequent: bool,
    is_answered: bool,
}

impl ChangeRequest {
    /// `None` for reads and requests without a token. `route` is the router's pattern, for actions of models with the verb.
    pub fn of(visitor: &Visitor, method: &Method, route: &str, path: &str) -> Option<ChangeRequest> {
        let Visitor::Known(owner, _) = visitor else { return None };
        let is_read = matches!(*method, Method::GET | Method::HEAD);
        if is_read || CHANGELESS.contains(&(method.as_str(), route)) {
            return None;
        }
        let (owner, path, is_frequent) = (owner.clone(), path.to_string(), FREQUENT.contains(&route));
        Some(ChangeRequest { owner, method: method.clone(), path, is_frequent, is_answered: false })
    }

    /// Logs the outcome; refused and frequent changes at debug.
    pub fn answered(mut self, status: StatusCode) {
        self.is_answered = true;
        let (token, tenant) = (self.owner.name(), self.owner.tenant());
        let (method, path, status_code) = (self.method.as_str(), self.path.as_str(), status.as_u16());
        match (status.is_success(), self.is_frequent) {
            (true, false) => tracing::info!(token, tenant, method, path, status = status_code, "change made"),
            (true, true) => tracing::debug!(token, tenant, method, path, status = status_code, "change made"),
            (false, _) => tracing::debug!(token, tenant, method, path, status = status_code, "change refused"),
        }
    }
}

/// Logs a connection closed before the answer: the change may have been made all the same.
impl Drop for ChangeRequest {
    fn drop(&mut self) {
        if self.is_answered {
            return;
        }
        let (token, tenant) = (self.owner.name(), self.owner.tenant());
        let (method, path) = (self.method.as_str(), self.path.as_str());
        match self.is_frequent {
            false => tracing::info!(token, tenant, method, path, "change not answered: connection closed"),
            true => tracing::debug!(token, tenant, method, path, "change not answered: connection closed"),
        }
    }
}
