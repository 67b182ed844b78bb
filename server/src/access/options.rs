//! What is said at the start about who may use the service, and what of it cannot be.

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

/// Who may use the service, and how they reach it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AccessOptions {
    /// Every request needs a token on loopback, too; elsewhere it does in any case.
    pub require_token: bool,
    /// The file of tokens; naming one is asking for tokens.
    pub tokens: Option<PathBuf>,
    /// The service encrypts.
    pub tls: Option<TlsFiles>,
    /// Off loopback without encryption.
    pub insecure: bool,
    /// Names under which it answers, besides its address.
    pub hosts: Vec<HostName>,
    /// The folder of the recordings that documents may name. Without, it is any of this machine where nobody needs a token, and
    /// none where everybody does.
    pub recordings: Option<PathBuf>,
    /// How much of the disk recordings may take.
    pub quota: RecordingQuota,
}

/// PEM files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// The service's certificate, and those between it and its authority.
    pub certificate: PathBuf,
    /// The key of the first.
    pub key: PathBuf,
}

/// Why the service does not start with these.
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    /// Tokens would cross the network in clear text.
    #[error(
        "{0} is not a loopback address, and nothing encrypts: give --tls-cert FILE and --tls-key FILE, or --insecure where \
         a proxy or a tunnel does"
    )]
    Unencrypted(SocketAddr),
    /// Nobody could use it.
    #[error(
        "{address} needs tokens, and there are none in {}; make one with `isophote token new --role admin --tokens {}`",
        file.display(), file.display()
    )]
    NoTokens {
        /// Where it would listen.
        address: SocketAddr,
        /// Where tokens would be.
        file: PathBuf,
    },
    /// The file of tokens.
    #[error(transparent)]
    Tokens(#[from] TokenError),
    /// The folder of recordings.
    #[error("--recordings {}: {reason}", folder.display())]
    Recordings {
        /// As named.
        folder: PathBuf,
        /// The system's words.
        reason: std::io::Error,
    },
    /// Certificate or key.
    #[error(transparent)]
    Tls(#[from] TlsError),
}

/// Who may use the service, ready to be asked.
pub struct Access {
    /// Under which names.
    pub hosts: Hosts,
    /// Absent where nobody needs a token.
    pub keyring: Option<Arc<Keyring>>,
    /// Absent where nothing is encrypted.
    pub tls: Option<Arc<Certificates>>,
    /// Which files of this machine may be named.
    pub recordings: Recordings,
}

impl AccessOptions {
    /// Reads the files, and refuses what would leave the service open or useless.
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
                // Whoever owns the file may be someone else, whose next change makes it.
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
