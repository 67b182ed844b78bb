//! TLS 1.2 and 1.3 by rustls, from PEM files that are reloaded on change.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use isophote_capture::read_regular;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{self, ServerConfig};

use super::options::TlsFiles;
use super::stamp::{FileStamp, follow, stamp};
use crate::limits::LIMITS;

/// Why the service cannot encrypt.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file cannot be read.
    #[error("{}: cannot be read: {reason}", path.display())]
    Unread {
        /// The file.
        path: PathBuf,
        /// The system's error.
        reason: std::io::Error,
    },
    /// A file is not what it should be.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The fault, without a quotation of the file.
        reason: String,
    },
    /// Certificate and key do not match.
    #[error("{} and {}: {reason}", files.certificate.display(), files.key.display())]
    Pair {
        /// Both files.
        files: TlsFiles,
        /// The error of rustls.
        reason: rustls::Error,
    },
}

/// A certificate and its key, reloaded on change.
pub struct Certificates {
    files: TlsFiles,
    /// Stamps of the files before the first read.
    opened: PairStamp,
    acceptor: RwLock<TlsAcceptor>,
}

type PairStamp = [FileStamp; 2];

/// The result of the last check of the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct SeenFiles {
    /// Stamps at the last read.
    read: PairStamp,
    /// Stamps at that check.
    last: PairStamp,
    /// The files could not be read then; logged once.
    is_unread: bool,
}

fn stamps(files: &TlsFiles) -> PairStamp {
    [stamp(&files.certificate), stamp(&files.key)]
}

impl Certificates {
    /// Reads the files.
    pub fn open(files: TlsFiles) -> Result<Certificates, TlsError> {
        let opened = stamps(&files);
        let acceptor = RwLock::new(acceptor(&files)?);
        Ok(Certificates { files, opened, acceptor })
    }

    /// The acceptor of new connections; open ones keep theirs.
    pub fn acceptor(&self) -> TlsAcceptor {
        self.acceptor.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Reloads the files on change, for as long as this is polled. Logs a wrong pair and keeps the last good one.
    pub async fn follow(self: Arc<Certificates>) {
        let opened = SeenFiles { read: self.opened, last: self.opened, is_unread: false };
        follow(self, opened, Certificates::look).await;
    }

    /// Reads the files once both have stayed unchanged for a check, since they change one after the other. Retries unreadable
    /// files at the next check.
    fn look(&self, seen: SeenFiles) -> SeenFiles {
        let now = stamps(&self.files);
        if now == seen.read || now != seen.last {
            return SeenFiles { last: now, is_unread: false, ..seen };
        }
        let certificate = self.files.certificate.display().to_string();
        let read = acceptor(&self.files);
        let is_unread = matches!(read, Err(TlsError::Unread { .. }));
        match read {
            Ok(acceptor) => {
                *self.acceptor.write().unwrap_or_else(PoisonError::into_inner) = acceptor;
                tracing::info!(certificate, "the certificate was read again");
            }
            Err(_) if is_unread && seen.is_unread => {}
            Err(error) => tracing::error!(%error, "the certificate that was read before stays in use"),
        }
        SeenFiles { read: if is_unread { seen.read } else { now }, last: now, is_unread }
    }
}

/// Reads certificate and key.
fn acceptor(files: &TlsFiles) -> Result<TlsAcceptor, TlsError> {
    let chain = CertificateDer::pem_slice_iter(&read(&files.certificate)?).collect::<Result<Vec<_>, _>>();
    let chain = chain.map_err(|_| wrong(&files.certificate, "not a PEM file"))?;
    if chain.is_empty() {
        return Err(wrong(&files.certificate, "it has no certificate (-----BEGIN CERTIFICATE-----)"));
    }
    let key = PrivateKeyDer::from_pem_slice(&read(&files.key)?)
        .map_err(|_| wrong(&files.key, "it has no unencrypted private key (-----BEGIN PRIVATE KEY-----)"))?;
    let pair = |reason| TlsError::Pair { files: files.clone(), reason };
    let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(pair)?
        .with_no_client_auth()
        .with_single_cert(chain, key)
        .map_err(pair)?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}

fn read(path: &Path) -> Result<Vec<u8>, TlsError> {
    read_regular(path, LIMITS.pem_bytes).map_err(|reason| TlsError::Unread { path: path.to_path_buf(), reason })
}

fn wrong(path: &Path, reason: &str) -> TlsError {
    TlsError::File { path: path.to_path_buf(), reason: reason.into() }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use tokio_rustls::rustls::server::ResolvesServerCertUsingSni;

    use super::*;

    #[test]
    fn unreadable_files_are_retried() {
        let folder = std::env::temp_dir().join(format!("isophote-tls-{}", std::process::id()));
        let [certificate, key] = ["certificate", "key"].map(|name| folder.join(name));
        let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()));
        let config = config.with_safe_default_protocol_versions().unwrap().with_no_client_auth();
        let config = config.with_cert_resolver(Arc::new(ResolvesServerCertUsingSni::new()));
        let files = TlsFiles { certificate: certificate.clone(), key };
        let acceptor = RwLock::new(TlsAcceptor::from(Arc::new(config)));
        let certificates = Certificates { opened: stamps(&files), files, acceptor };
        let opened = SeenFiles { read: certificates.opened, last: certificates.opened, is_unread: false };
        std::fs::create_dir_all(&certificate).unwrap();
        let changed = certificates.look(opened);
        let tried = certificates.look(changed);
        assert_eq!(tried, SeenFiles { is_unread: true, ..changed });
        assert!(tried.read != tried.last && certificates.look(tried) == tried, "they are tried at each look");
        std::fs::remove_dir(&certificate).unwrap();
        std::fs::write(&certificate, "no certificate").unwrap();
        let read = certificates.look(certificates.look(tried));
        assert!(read.read == read.last && !read.is_unread, "what can be read and is wrong is not tried again");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
