//! Access control: tokens, roles, host names and encryption.
//!
//! It identifies the sender of a request ([`Visitor`]) or refuses it. On loopback no token is required: whoever can connect
//! there can run programs here already. It depends on no route, and stores the sha256 of tokens only.

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
