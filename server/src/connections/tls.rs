//! Certificates, read again when their files change.

use super::serve::Interface;
use crate::network::{TlsConfig, span};
use anyhow::Context;
use rustls::ServerConfig;
use rustls::crypto::CryptoProvider;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::{ClientHello, ResolvesServerCert};
use rustls::sign::CertifiedKey;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, SystemTime};
use tokio_rustls::TlsAcceptor;
use tokio_util::sync::CancellationToken;

/// What both ports encrypt with.
pub struct Certificates {
    current: Arc<Current>,
    grpc: TlsAcceptor,
    http: TlsAcceptor,
    reload_every: Duration,
}

/// The files and what they held when they were read last.
struct Current {
    cert: PathBuf,
    key: PathBuf,
    provider: Arc<CryptoProvider>,
    certified: RwLock<Arc<CertifiedKey>>,
    /// What the files looked like when reading them was tried last.
    seen: Mutex<[Stamp; 2]>,
}

/// How a file looks from outside: time of its last change and length; `None` if it is not there.
type Stamp = Option<(SystemTime, u64)>;

impl Certificates {
    /// Of a configuration; `None` if it asks for no encryption.
    ///
    /// # Errors
    /// If the files cannot be read, or the key is not the certificate's.
    pub fn of(config: &TlsConfig) -> anyhow::Result<Option<Arc<Self>>> {
        let Some((cert, key)) = config.cert.clone().zip(config.key.clone()) else { return Ok(None) };
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let seen = Mutex::new([stamp(&cert), stamp(&key)]);
        let certified = RwLock::new(Arc::new(read(&cert, &key, &provider)?));
        let current = Arc::new(Current { cert, key, provider, certified, seen });
        let (grpc, http) = (acceptor(&current, &[b"h2"])?, acceptor(&current, &[b"h2", b"http/1.1"])?);
        Ok(Some(Arc::new(Self { current, grpc, http, reload_every: span(config.reload_s) })))
    }

    /// Encrypts connections of an interface.
    pub fn acceptor(&self, interface: Interface) -> &TlsAcceptor {
        match interface {
            Interface::Grpc => &self.grpc,
            Interface::Http => &self.http,
        }
    }

    /// Reads the files again. What they held before stays in use if they cannot be used.
    pub fn reload(&self) {
        let Current { cert, key, provider, certified, seen } = &*self.current;
        *seen.lock().unwrap_or_else(PoisonError::into_inner) = [stamp(cert), stamp(key)];
        match read(cert, key, provider) {
            Ok(read) => {
                *certified.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(read);
                tracing::info!("the certificate was read again from {}", cert.display());
            }
            Err(error) => tracing::error!("the certificate from before stays in use: {error:#}"),
        }
    }

    /// Reads the files again whenever they change, until `closing`.
    pub async fn look_after(self: Arc<Self>, closing: CancellationToken) {
        while tokio::time::timeout(self.reload_every, closing.cancelled()).await.is_err() {
            let Current { cert, key, seen, .. } = &*self.current;
            let now = [stamp(cert), stamp(key)];
            if *seen.lock().unwrap_or_else(PoisonError::into_inner) != now {
                self.reload();
            }
        }
    }
}

fn acceptor(current: &Arc<Current>, protocols: &[&[u8]]) -> anyhow::Result<TlsAcceptor> {
    let mut config = ServerConfig::builder_with_provider(current.provider.clone())
        .with_safe_default_protocol_versions()?
        .with_no_client_auth()
        .with_cert_resolver(current.clone());
    config.alpn_protocols = protocols.iter().map(|protocol| protocol.to_vec()).collect();
    Ok(TlsAcceptor::from(Arc::new(config)))
}

fn read(cert: &Path, key: &Path, provider: &CryptoProvider) -> anyhow::Result<CertifiedKey> {
    let chain: Vec<_> = CertificateDer::pem_file_iter(cert)
        .and_then(Iterator::collect)
        .with_context(|| format!("tls.cert: {} is no certificate in PEM", cert.display()))?;
    anyhow::ensure!(!chain.is_empty(), "tls.cert: {} holds no certificate", cert.display());
    let private = PrivateKeyDer::from_pem_file(key)
        .with_context(|| format!("tls.key: {} is no private key in PEM", key.display()))?;
    CertifiedKey::from_der(chain, private, provider)
        .with_context(|| format!("the key in {} is not that of {}", key.display(), cert.display()))
}

fn stamp(file: &Path) -> Stamp {
    let metadata = std::fs::metadata(file).ok()?;
    Some((metadata.modified().ok()?, metadata.len()))
}

impl ResolvesServerCert for Current {
    fn resolve(&self, _: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        Some(self.certified.read().unwrap_or_else(PoisonError::into_inner).clone())
    }
}

impl fmt::Debug for Current {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Certificates").field("cert", &self.cert).finish_non_exhaustive()
    }
}
