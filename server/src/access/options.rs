//! Access options of a start, and their checks.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use isophote_capture::ReadableFolder;

use super::file::{TokenError, TokenFile};
use super::hosts::{HostName, Hosts, Scheme};
use super::keyring::Keyring;
use super::recordings::Recordings;
use super::tls::{Certificates, TlsError};
use crate::recording::RecordingQuota;

/// Options of access to the service.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AccessOptions {
    /// Requires tokens on loopback, too; elsewhere they are always required.
    pub require_token: bool,
    /// The token file; naming one requires tokens.
    pub tokens: Option<PathBuf>,
    /// Encrypts connections.
    pub tls: Option<TlsFiles>,
    /// Allows plain connections off loopback.
    pub insecure: bool,
    /// Host names that it accepts besides its address.
    pub hosts: Vec<HostName>,
    /// Folder of the recordings that documents may name. Without it: any on this machine if no tokens are required, else none.
    pub recordings: Option<PathBuf>,
    /// Disk quota of recordings.
    pub quota: RecordingQuota,
}

/// PEM files of the certificate and its key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// The service's certificate with the chain to its authority.
    pub certificate: PathBuf,
    /// The key of the service's certificate.
    pub key: PathBuf,
}

/// Why these options are refused.
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    /// Tokens would be sent in plain text.
    #[error(
        "{0} is not a loopback address, and nothing encrypts: give --tls-cert FILE and --tls-key FILE, or --insecure where \
         a proxy or a tunnel does"
    )]
    Unencrypted(SocketAddr),
    /// Tokens are required, but there are none.
    #[error(
        "{address} needs tokens, and there are none in {}; make one with `isophote token new --role admin --tokens {}`",
        file.display(), file.display()
    )]
    NoTokens {
        /// The listen address.
        address: SocketAddr,
        /// The token file.
        file: PathBuf,
    },
    /// The token file.
    #[error(transparent)]
    Tokens(#[from] TokenError),
    /// The folder of recordings.
    #[error("--recordings {}: {reason}", folder.display())]
    Recordings {
        /// As configured.
        folder: PathBuf,
        /// The system's error.
        reason: std::io::Error,
    },
    /// Certificate or key.
    #[error(transparent)]
    Tls(#[from] TlsError),
}

/// Access control of a running service.
pub struct Access {
    /// Accepted host names.
    pub hosts: Hosts,
    /// Tokens; absent if none are required.
    pub keyring: Option<Arc<Keyring>>,
    /// Certificates; absent without encryption.
    pub tls: Option<Arc<Certificates>>,
    /// Recordings that documents may name.
    pub recordings: Recordings,
}

impl AccessOptions {
    /// Reads the files; refuses options that leave the service open or unusable.
    pub fn open(&self, listen: SocketAddr, data: Option<&Path>) -> Result<Access, AccessError> {
        let is_private = listen.ip().to_canonical().is_loopback();
        if !is_private && self.tls.is_none() && !self.insecure {
            return Err(AccessError::Unencrypted(listen));
        }
        let keyring = if !is_private || self.require_token || self.tokens.is_some() {
            let file = TokenFile::of(self.tokens.as_deref(), data)?;
            let keyring = Keyring::open(file.clone())?;
            if keyring.len() == 0 {
                return Err(AccessError::NoTokens { address: listen, file: file.path().to_path_buf() });
            }
            if let Err(error) = file.reserve() {
                // The file may belong to another user, whose next change creates the spare.
                tracing::debug!(%error, "nothing is reserved beside the file of tokens");
            }
            Some(Arc::new(keyring))
        } else {
            None
        };
        let scheme = match (&self.tls, is_private) {
            (Some(_), _) => Scheme::Https,
            (None, true) if self.hosts.is_empty() => Scheme::Http,
            (None, _) => Scheme::Either,
        };
        let tls = self.tls.clone().map(Certificates::open).transpose()?.map(Arc::new);
        let recordings = match (&self.recordings, &keyring) {
            (Some(folder), _) => Recordings::Within(
                ReadableFolder::below(folder)
                    .map_err(|reason| AccessError::Recordings { folder: folder.clone(), reason })?,
            ),
            (None, Some(_)) => Recordings::Nowhere,
            (None, None) => Recordings::Within(ReadableFolder::default()),
        };
        Ok(Access { hosts: Hosts { names: self.hosts.clone(), scheme }, keyring, tls, recordings })
    }
}
