//! Connections to other servers of the fleet: one for each request, so that no stream waits for another's
//! flow control, and that a request given up takes its connection along.

use crate::connections::Interface;
use crate::fleet::FleetConfig;
use anyhow::Context as _;
use axum::http::Uri;
use hyper_util::rt::TokioIo;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;

/// A connection, encrypted or not.
pub trait Wire: AsyncRead + AsyncWrite + Send {}
impl<T: AsyncRead + AsyncWrite + Send> Wire for T {}
type Socket = TokioIo<Pin<Box<dyn Wire>>>;

/// See the module's documentation.
pub struct Dialer {
    timeout: Duration,
    grpc: TlsConnector,
    http: TlsConnector,
}

/// A connection to a server.
pub struct Dialed {
    /// What goes over it.
    pub socket: Socket,
    /// `http` or `https`.
    pub scheme: &'static str,
    /// Its host and port.
    pub authority: String,
}

impl Dialer {
    /// As configured.
    ///
    /// # Errors
    /// If the certificates cannot be used.
    pub fn new(config: &FleetConfig) -> anyhow::Result<Self> {
        let roots = roots(config)?;
        let connector = |protocol: &[u8]| -> anyhow::Result<TlsConnector> {
            let provider = Arc::new(rustls::crypto::ring::default_provider());
            let config =
                ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions()?;
            let mut config = config.with_root_certificates(roots.clone()).with_no_client_auth();
            config.alpn_protocols = vec![protocol.to_vec()];
            Ok(TlsConnector::from(Arc::new(config)))
        };
        let (grpc, http) = (connector(b"h2")?, connector(b"http/1.1")?);
        Ok(Self { timeout: config.connect_timeout(), grpc, http })
    }

    /// Connects to a server within the time that is given for it.
    ///
    /// # Errors
    /// If nobody is reached there, or nobody who can prove to be meant.
    pub async fn dial(&self, url: &str, interface: Interface) -> io::Result<Dialed> {
        let connected = tokio::time::timeout(self.timeout, self.connect(url, interface)).await;
        connected.map_err(|_elapsed| {
            io::Error::new(io::ErrorKind::TimedOut, format!("nobody answered for {:?}", self.timeout))
        })?
    }

    async fn connect(&self, url: &str, interface: Interface) -> io::Result<Dialed> {
        let url: Uri = url.parse().map_err(io::Error::other)?;
        let is_encrypted = url.scheme_str() == Some("https");
        let host = url.host().ok_or_else(|| io::Error::other("the address has no host"))?;
        let host = host.trim_matches(['[', ']']);
        let port = url.port_u16().unwrap_or(if is_encrypted { 443 } else { 80 });
        let stream = TcpStream::connect((host, port)).await?;
        stream.set_nodelay(true)?;
        let authority = url.authority().map_or_else(String::new, ToString::to_string);
        let (wire, scheme): (Pin<Box<dyn Wire>>, _) = if is_encrypted {
            let connector = if interface == Interface::Grpc { &self.grpc } else { &self.http };
            let name = ServerName::try_from(host.to_owned()).map_err(io::Error::other)?;
            (Box::pin(connector.connect(name, stream).await?), "https")
        } else {
            (Box::pin(stream), "http")
        };
        Ok(Dialed { socket: TokioIo::new(wire), scheme, authority })
    }
}

/// Whose certificates are believed: the configured authorities', else the system's.
fn roots(config: &FleetConfig) -> anyhow::Result<RootCertStore> {
    let mut roots = RootCertStore::empty();
    let Some(file) = &config.ca else {
        roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
        return Ok(roots);
    };
    let refuse = || format!("fleet.ca: {} is no certificate in PEM", file.display());
    for certificate in CertificateDer::pem_file_iter(file).with_context(refuse)? {
        roots.add(certificate.with_context(refuse)?).with_context(refuse)?;
    }
    anyhow::ensure!(!roots.is_empty(), refuse());
    Ok(roots)
}
