//! Who may do what: tokens, roles, names of the service, encryption.
//!
//! What comes in: a file of tokens' digests, names and files that were given at the start, requests. What goes out: who asks
//! ([`Visitor`]), or the refusal. On loopback nobody needs a token, since whoever may connect there runs programs here already.
//! It must never know what a route does, and keeps no token: only its sha256.

mod audit;
mod budget;
mod file;
mod hosts;
mod keyring;
mod options;
mod recordings;
mod roles;
mod stamp;
mod tls;
mod token;

pub use audit::ChangeRequest;
pub use budget::is_compiling;
pub use file::{DEFAULT_TENANT, TokenError, TokenFile, TokenRecord};
pub use hosts::{HostName, LocalAddress};
pub use keyring::Visitor;
pub use options::{Access, AccessError, AccessOptions, TlsFiles};
pub use recordings::Recordings;
pub use roles::{Role, role_needed};
pub use tls::TlsError;
pub use token::{Secret, WEBSOCKET_PREFIX};
