//! Encryption. PEM files in, what takes TLS connections out: TLS 1.2 and 1.3, by rustls.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use isophote_capture::read_regular;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{self, ServerConfig};

use super::options::TlsFiles;
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

/// Reads certificate and key.
pub fn acceptor(files: &TlsFiles) -> Result<TlsAcceptor, TlsError> {
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
