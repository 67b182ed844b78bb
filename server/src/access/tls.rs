//! Encryption. PEM files in, what takes TLS connections out: TLS 1.2 and 1.3, by rustls. Files that change are read again.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use isophote_capture::read_regular;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{self, ServerConfig};

use super::options::TlsFiles;
use super::stamp::{FileStamp, stamp};
use crate::limits::LIMITS;

/// Why the service cannot encrypt.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file is not what it should be.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong, never quoting it.
        reason: String,
    },
    /// The files do not belong together.
    #[error("{} and {}: {reason}", files.certificate.display(), files.key.display())]
    Pair {
        /// Both.
        files: TlsFiles,
        /// What is wrong with them.
        reason: rustls::Error,
    },
}

/// A certificate and its key, read again when their files change.
pub struct Certificates {
    files: TlsFiles,
    /// Of the files before they were read first.
    opened: PairStamp,
    acceptor: RwLock<TlsAcceptor>,
}

type PairStamp = [FileStamp; 2];

fn stamps(files: &TlsFiles) -> PairStamp {
    [stamp(&files.certificate), stamp(&files.key)]
}

impl Certificates {
    /// As the files have them now.
    pub fn open(files: TlsFiles) -> Result<Certificates, TlsError> {
        let opened = stamps(&files);
        let acceptor = RwLock::new(acceptor(&files)?);
        Ok(Certificates { files, opened, acceptor })
    }

    /// For the next connection; those that are open keep theirs.
    pub fn acceptor(&self) -> TlsAcceptor {
        self.acceptor.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Reads the files again whenever they change, for as long as this is polled. A pair that is wrong is logged, and the last
    /// good one stays.
    pub async fn follow(self: Arc<Certificates>) {
        let mut seen = (self.opened, self.opened);
        let mut ticks = tokio::time::interval(LIMITS.token_interval);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            let certificates = self.clone();
            // Where the disk hangs, what was known goes on being known.
            let looked = tokio::task::spawn_blocking(move || certificates.look(seen)).await;
            seen = looked.unwrap_or(seen);
        }
    }

    /// `read` when they were read last, `last` at the last look. Of two files that change one after the other neither is read
    /// before both have stayed the same for a look.
    fn look(&self, (read, last): (PairStamp, PairStamp)) -> (PairStamp, PairStamp) {
        let now = stamps(&self.files);
        if now == read || now != last {
            return (read, now);
        }
        let certificate = self.files.certificate.display().to_string();
        match acceptor(&self.files) {
            Ok(acceptor) => {
                *self.acceptor.write().unwrap_or_else(PoisonError::into_inner) = acceptor;
                tracing::info!(certificate, "the certificate was read again");
            }
            Err(error) => tracing::error!(%error, "the certificate that was read before stays in use"),
        }
        (now, now)
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
    read_regular(path, LIMITS.pem_bytes).map_err(|reason| wrong(path, &format!("cannot be read: {reason}")))
}

fn wrong(path: &Path, reason: &str) -> TlsError {
    TlsError::File { path: path.to_path_buf(), reason: reason.into() }
}
