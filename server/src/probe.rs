//! `monoslam-server health`: asks the server of this machine whether it is ready, as containers without other
//! programs need it.

use crate::config::Config;
use anyhow::{Context, bail, ensure};
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::{CryptoProvider, verify_tls12_signature, verify_tls13_signature};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use rustls::{ClientConfig, DigitallySignedStruct, SignatureScheme};
use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;

/// An answer takes this long at most.
const PATIENCE: Duration = Duration::from_secs(5);

/// As much of an answer is read.
const MAX_ANSWER_BYTES: u64 = 64 << 10;

/// Asks `/readyz` of the server that this configuration is of, and prints what it says to `out`.
///
/// # Errors
/// If it does not answer, or is not ready.
pub async fn probe(config: &Config, out: &mut impl Write) -> anyhow::Result<()> {
    let addr = reached_at(config.http_addr);
    let asked = tokio::time::timeout(PATIENCE, ask(addr, config.tls.cert.as_deref())).await;
    let answer = match asked {
        Ok(answer) => answer.with_context(|| format!("the server at {addr} cannot be asked"))?,
        Err(_elapsed) => bail!("the server at {addr} did not answer within {PATIENCE:?}"),
    };
    let (head, body) = answer.split_once("\r\n\r\n").context("the answer is not HTTP")?;
    let status = head.split(' ').nth(1).unwrap_or_default();
    write!(out, "{body}")?;
    ensure!(status == "200", "the server at {addr} is not ready ({status})");
    Ok(())
}

/// Where a server that listens everywhere is found.
fn reached_at(listening: SocketAddr) -> SocketAddr {
    let ip = match listening.ip() {
        IpAddr::V4(Ipv4Addr::UNSPECIFIED) => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(Ipv6Addr::UNSPECIFIED) => Ipv6Addr::LOCALHOST.into(),
        ip => ip,
    };
    SocketAddr::new(ip, listening.port())
}

async fn ask(addr: SocketAddr, cert: Option<&Path>) -> anyhow::Result<String> {
    let socket = TcpStream::connect(addr).await?;
    match cert {
        None => exchange(socket, addr).await,
        Some(cert) => {
            let connector = TlsConnector::from(Arc::new(trusting(cert)?));
            exchange(connector.connect(ServerName::from(addr.ip()), socket).await?, addr).await
        }
    }
}

async fn exchange(
    mut socket: impl AsyncRead + AsyncWrite + Unpin,
    addr: SocketAddr,
) -> anyhow::Result<String> {
    // Not 1.1: the body comes in one piece.
    let request = format!("GET /readyz HTTP/1.0\r\nhost: {addr}\r\nconnection: close\r\n\r\n");
    socket.write_all(request.as_bytes()).await?;
    let mut answer = Vec::new();
    socket.take(MAX_ANSWER_BYTES).read_to_end(&mut answer).await?;
    Ok(String::from_utf8_lossy(&answer).into_owned())
}

/// Trusts the server's own certificate, by whatever name it goes, and none else.
fn trusting(cert: &Path) -> anyhow::Result<ClientConfig> {
    let own =
        CertificateDer::from_pem_file(cert).with_context(|| format!("cannot read {}", cert.display()))?;
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let verifier = Arc::new(OwnCertificate { own, provider: provider.clone() });
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions()?;
    Ok(config.dangerous().with_custom_certificate_verifier(verifier).with_no_client_auth())
}

/// The certificate in the server's file.
#[derive(Debug)]
struct OwnCertificate {
    own: CertificateDer<'static>,
    provider: Arc<CryptoProvider>,
}

impl ServerCertVerifier for OwnCertificate {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _server_name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        if *end_entity == self.own {
            return Ok(ServerCertVerified::assertion());
        }
        // As when the file was changed a moment ago.
        Err(rustls::Error::General("it has another certificate than the configured one".into()))
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls12_signature(message, cert, signed, &self.provider.signature_verification_algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls13_signature(message, cert, signed, &self.provider.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::server::Server;

    async fn said(config: &Config) -> anyhow::Result<String> {
        let mut out = Vec::new();
        probe(config, &mut out).await?;
        Ok(String::from_utf8(out)?)
    }

    #[tokio::test]
    async fn a_server_is_asked_plainly_and_encrypted() {
        for is_encrypted in [false, true] {
            let folder = tempfile::tempdir().unwrap();
            let mut config = Config::local(folder.path().join("data"));
            if is_encrypted {
                let made = rcgen::generate_simple_self_signed(["slam.example".to_owned()]).unwrap();
                let [cert, key] = ["cert.pem", "key.pem"].map(|name| folder.path().join(name));
                std::fs::write(&cert, made.cert.pem()).unwrap();
                std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
                (config.tls.cert, config.tls.key) = (Some(cert), Some(key));
            }
            let running = Server::start(config.clone()).await.unwrap();
            config.http_addr = running.http_addr;
            assert_eq!(said(&config).await.unwrap(), "ready\n");
            running.shutdown().await;
            assert!(said(&config).await.is_err(), "nobody answers any more");
        }
    }

    #[test]
    fn a_server_that_listens_everywhere_is_found_here() {
        let at = |text: &str| reached_at(text.parse().unwrap()).to_string();
        assert_eq!(at("0.0.0.0:8080"), "127.0.0.1:8080");
        assert_eq!(at("[::]:8080"), "[::1]:8080");
        assert_eq!(at("192.0.2.1:8080"), "192.0.2.1:8080");
    }
}
