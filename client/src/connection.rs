//! Connections to the service: plain or TLS, with or without a token.

use std::fs::File;
use std::io::{Read, Write};
use std::net::{IpAddr, TcpStream, ToSocketAddrs};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use rustls::crypto::{CryptoProvider, ring};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use tungstenite::http::{HeaderValue, Uri};
use ureq::tls::{Certificate, RootCerts, TlsConfig};

use crate::failure::Failure;
use crate::http::ServiceArgs;

/// Environment variable of the token.
const TOKEN: &str = "ISOPHOTE_TOKEN";
/// Upper bound on the size of a token file.
const TOKEN_BYTES_MAX: u64 = 4096;

/// A plain or TLS stream.
pub trait ByteStream: Read + Write {}
impl<T: Read + Write> ByteStream for T {}

/// Address of the service, trusted authorities and credentials.
pub struct Connection {
    /// Without a trailing slash.
    pub url: String,
    host: String,
    port: u16,
    /// Trusted authorities; absent without TLS.
    authorities: Option<Vec<CertificateDer<'static>>>,
    authorization: Option<HeaderValue>,
}

impl Connection {
    /// Connects lazily: sends nothing yet.
    pub fn new(args: &ServiceArgs) -> Result<Connection, Failure> {
        let url = args.server.trim_end_matches('/').to_string();
        let wrong = || Failure::Usage(format!("`{url}` is not an address like http://127.0.0.1:7240 or https://HOST"));
        let uri: Uri = url.parse().map_err(|_| wrong())?;
        let port = match uri.scheme_str() {
            Some("http") => 80,
            Some("https") => 443,
            _ => return Err(wrong()),
        };
        let host = uri.host().filter(|host| !host.is_empty()).ok_or_else(wrong)?;
        let host = host.trim_matches(['[', ']']).to_string();
        let port = uri.port_u16().unwrap_or(port);
        let is_encrypted = uri.scheme_str() == Some("https");
        let authorization = token(args)?;
        if authorization.is_some() && !is_encrypted && !is_own(&host) && !args.insecure {
            return Err(Failure::Usage(format!(
                "the token would go to {host} in clear text: use https://, or --insecure where something else encrypts"
            )));
        }
        let authorities = if is_encrypted { Some(authorities(args.ca.as_deref())?) } else { None };
        Ok(Connection { url, host, port, authorities, authorization })
    }

    /// The `Bearer …` header, if there is a token.
    pub fn authorization(&self) -> Option<&HeaderValue> {
        self.authorization.as_ref()
    }

    /// HTTP agent. It follows no redirects: the token is for this service alone.
    pub fn agent(&self, timeout: Duration) -> ureq::Agent {
        let trusted = self.authorities.iter().flatten().map(|one| Certificate::from_der(one).to_owned()).collect();
        let tls = TlsConfig::builder()
            .unversioned_rustls_crypto_provider(provider())
            .root_certs(RootCerts::Specific(Arc::new(trusted)))
            .build();
        let config = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(timeout))
            .max_redirects(0)
            .proxy(None)
            .tls_config(tls);
        config.build().into()
    }

    /// Whether the connection uses TLS.
    pub fn is_encrypted(&self) -> bool {
        self.authorities.is_some()
    }

    /// Opens a stream for a WebSocket, and its socket; the timeout also applies to reads and writes.
    pub fn open(&self, timeout: Duration) -> Result<(Box<dyn ByteStream>, TcpStream), Box<dyn std::error::Error>> {
        let stream = self.connected(timeout)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(timeout))?;
        stream.set_write_timeout(Some(timeout))?;
        let socket = stream.try_clone()?;
        let Some(authorities) = &self.authorities else { return Ok((Box::new(stream), socket)) };
        let mut trusted = RootCertStore::empty();
        trusted.add_parsable_certificates(authorities.iter().cloned());
        let config = ClientConfig::builder_with_provider(provider())
            .with_safe_default_protocol_versions()?
            .with_root_certificates(trusted)
            .with_no_client_auth();
        let name = ServerName::try_from(self.host.clone())?;
        Ok((Box::new(StreamOwned::new(ClientConnection::new(Arc::new(config), name)?, stream)), socket))
    }

    /// Connects to the first address of the host that answers.
    fn connected(&self, timeout: Duration) -> std::io::Result<TcpStream> {
        let mut refused = std::io::Error::other("the host has no address");
        for address in (self.host.as_str(), self.port).to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, timeout) {
                Ok(stream) => return Ok(stream),
                Err(error) => refused = error,
            }
        }
        Err(refused)
    }
}

fn provider() -> Arc<CryptoProvider> {
    Arc::new(ring::default_provider())
}

/// Whether the host is this machine's loopback.
fn is_own(host: &str) -> bool {
    host.parse::<IpAddr>().map_or(host.eq_ignore_ascii_case("localhost"), |address| address.is_loopback())
}

/// Reads the token from its file or the environment. Messages never quote it.
fn token(args: &ServiceArgs) -> Result<Option<HeaderValue>, Failure> {
    let (text, place) = match (&args.token_file, std::env::var(TOKEN)) {
        (Some(path), _) => {
            let wrong = |error| Failure::Usage(format!("--token-file {}: cannot be read: {error}", path.display()));
            (read(path).map_err(wrong)?, format!("--token-file {}", path.display()))
        }
        (None, Ok(text)) if !text.trim().is_empty() => (text, TOKEN.to_string()),
        (None, Err(std::env::VarError::NotUnicode(_))) => (String::new(), TOKEN.to_string()),
        (None, _) => return Ok(None),
    };
    let first = text.lines().next().unwrap_or_default().trim();
    let is_plain = !first.is_empty() && first.bytes().all(|byte| byte.is_ascii_graphic());
    let value = HeaderValue::from_str(&format!("Bearer {first}")).ok().filter(|_| is_plain);
    let mut value = value.ok_or_else(|| Failure::Usage(format!("{place}: there is no token in it")))?;
    value.set_sensitive(true);
    Ok(Some(value))
}

/// Reads a token file, which may be a pipe from a secret manager.
fn read(path: &Path) -> std::io::Result<String> {
    let mut text = String::new();
    File::open(path)?.take(TOKEN_BYTES_MAX).read_to_string(&mut text)?;
    Ok(text)
}

/// Certificates of the trusted authorities.
fn authorities(ca: Option<&Path>) -> Result<Vec<CertificateDer<'static>>, Failure> {
    let Some(path) = ca else {
        let found = rustls_native_certs::load_native_certs().certs;
        let none = || Failure::Usage("this machine trusts no authority; give --ca FILE with the service's".into());
        return Some(found).filter(|found| !found.is_empty()).ok_or_else(none);
    };
    let wrong = |reason: &dyn std::fmt::Display| Failure::Usage(format!("--ca {}: {reason}", path.display()));
    let found = CertificateDer::pem_file_iter(path).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let found = found.map_err(|error| wrong(&error))?;
    if found.is_empty() { Err(wrong(&"there is no certificate in it")) } else { Ok(found) }
}

#[cfg(test)]
mod tests {
    use super::is_own;

    #[test]
    fn loopback_hosts_are_recognised() {
        for own in ["127.0.0.1", "127.9.9.9", "::1", "localhost", "LocalHost"] {
            assert!(is_own(own), "{own}");
        }
        for other in ["128.0.0.1", "::2", "localhost.evil.example", "127.0.0.1.evil.example", "0.0.0.0", ""] {
            assert!(!is_own(other), "{other}");
        }
    }
}
