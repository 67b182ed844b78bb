//! Roles of the routes, in one table; unlisted routes need the highest role.

use std::fmt;

use axum::http::Method;
use serde::{Deserialize, Serialize};

/// Role of a token; each role includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Read documents, states and estimates.
    View,
    /// Run sessions and sources, swap models, push frames, check documents, set cameras.
    Operate,
    /// Put and delete models: formulas that become code on this machine.
    Admin,
}

impl Role {
    /// All roles in ascending order.
    pub const ALL: [Role; 3] = [Role::View, Role::Operate, Role::Admin];
}

impl fmt::Display for Role {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str(match self {
            Role::View => "view",
            Role::Operate => "operate",
            Role::Admin => "admin",
        })
    }
}

/// Routes that need no token: health, and the files of the page and the book, which are the same for everybody.
const OPEN: [&str; 9] =
    ["/livez", "/readyz", "/", "/page.js", "/page.css", "/page/{file}", "/docs", "/docs/", "/docs/{*path}"];

/// Routes that differ from the role of their method or prefix.
const EXCEPTIONS: [(&str, &str, Role); 4] = [
    ("GET", "/v1/sessions/{name}/frames", Role::Operate), // a socket that takes frames
    ("POST", "/v1/models:check", Role::Operate),          // compiles, keeps nothing
    ("POST", "/v1/models/{name}:fit", Role::Operate),     // the same
    ("POST", "/v1/models/{name}:rollback", Role::Admin),
];

/// Prefixes below which writes need `operate`.
const OPERATED: [&str; 4] = ["/v1/sessions", "/v1/sources", "/v1/cameras", "/v1/recordings"];

/// The role that a route needs; `None` if it needs no token. `route` is the router's pattern, for actions of models with the
/// verb. For an unknown route it is the path, so that even its absence needs a token.
pub fn role_needed(method: &Method, route: &str) -> Option<Role> {
    let is_read = matches!(*method, Method::GET | Method::HEAD);
    if is_read && OPEN.contains(&route) {
        return None;
    }
    let exception = EXCEPTIONS.iter().find(|(of, at, _)| *of == method.as_str() && *at == route);
    let is_operated = |below: &str| route.strip_prefix(below).is_some_and(|rest| rest.starts_with('/'));
    Some(match exception {
        Some((_, _, role)) => *role,
        None if is_read => Role::View,
        None if OPERATED.into_iter().any(is_operated) => Role::Operate,
        None => Role::Admin,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unlisted_routes_need_the_highest_role() {
        let cases = [
            (Method::GET, "/livez", None),
            (Method::HEAD, "/page.js", None),
            (Method::POST, "/livez", Some(Role::Admin)),
            (Method::GET, "/readyz", None),
            (Method::GET, "/livez/", Some(Role::View)),
            (Method::GET, "/v1/sessions/{name}/estimates", Some(Role::View)),
            (Method::GET, "/v1/recordings/{file}", Some(Role::View)),
            (Method::DELETE, "/v1/recordings/{file}", Some(Role::Operate)),
            (Method::GET, "/v1/sessions/{name}/frames", Some(Role::Operate)),
            (Method::POST, "/v1/sessions/{name}/frames", Some(Role::Operate)),
            (Method::PUT, "/v1/sessions/{name}/model", Some(Role::Operate)),
            (Method::PUT, "/v1/sessionsx/{name}", Some(Role::Admin)),
            (Method::PUT, "/v1/cameras/{device}/controls", Some(Role::Operate)),
            (Method::POST, "/v1/models:check", Some(Role::Operate)),
            (Method::PUT, "/v1/models/{name}", Some(Role::Admin)),
            (Method::DELETE, "/v1/models/{name}", Some(Role::Admin)),
            (Method::POST, "/v1/models/{name}:fit", Some(Role::Operate)),
            (Method::POST, "/v1/models/{name}:eat", Some(Role::Admin)),
            (Method::TRACE, "/v1/models", Some(Role::Admin)),
            (Method::PUT, "/v1/new", Some(Role::Admin)),
        ];
        for (method, route, role) in cases {
            assert_eq!(role_needed(&method, route), role, "{method} {route}");
        }
    }
}
