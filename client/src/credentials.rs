//! What a client shows to a server, and what it asks of it.

use std::fmt;

use hyper_rustls::{HttpsConnector, HttpsConnectorBuilder};
use hyper_util::client::legacy::connect::HttpConnector;
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use rustls::{ClientConfig, RootCertStore};
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::transport::{Certificate, ClientTlsConfig};
use tonic::{Request, Status};

use crate::error::ClientError;

/// A token and whose certificates are trusted. Addresses with `https` are encrypted.
#[derive(Clone, Default)]
pub struct Credentials {
    /// The token, as `monoslam-server token create` printed it. Sent to the server and nowhere else; over
    /// `http` it can be read on the way.
    pub token: Option<String>,
    /// Certificates in PEM that the server's must be or be vouched for by; without any, the system's.
    pub ca_pem: Option<Vec<u8>>,
}

impl fmt::Debug for Credentials {
    /// Without the token.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (has_token, has_ca) = (self.token.is_some(), self.ca_pem.is_some());
        f.debug_struct("Credentials").field("has_token", &has_token).field("has_ca", &has_ca).finish()
    }
}

impl Credentials {
    /// With a token.
    pub fn token(token: impl Into<String>) -> Self {
        Self { token: Some(token.into()), ca_pem: None }
    }

    /// How tonic encrypts.
    pub(crate) fn grpc_tls(&self) -> ClientTlsConfig {
        match &self.ca_pem {
            Some(pem) => ClientTlsConfig::new().ca_certificate(Certificate::from_pem(pem)),
            None => ClientTlsConfig::new().with_native_roots(),
        }
    }

    /// What connects to HTTP servers, encrypted or not.
    pub(crate) fn connector(&self, is_encrypted: bool) -> Result<HttpsConnector<HttpConnector>, ClientError> {
        // The system's certificates are not read for nothing.
        let roots = if is_encrypted { self.roots()? } else { RootCertStore::empty() };
        let provider = rustls::crypto::ring::default_provider();
        let config =
            ClientConfig::builder_with_provider(provider.into()).with_safe_default_protocol_versions();
        let config = config.map_err(|error| ClientError::Credentials(error.to_string()))?;
        let config = config.with_root_certificates(roots).with_no_client_auth();
        Ok(HttpsConnectorBuilder::new().with_tls_config(config).https_or_http().enable_http1().build())
    }

    fn roots(&self) -> Result<RootCertStore, ClientError> {
        let mut roots = RootCertStore::empty();
        let Some(pem) = &self.ca_pem else {
            roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
            return Ok(roots);
        };
        let refuse = || ClientError::Credentials("the file of certificates holds none in PEM".to_owned());
        for certificate in CertificateDer::pem_slice_iter(pem) {
            let certificate = certificate.map_err(|_| refuse())?;
            roots.add(certificate).map_err(|error| ClientError::Credentials(error.to_string()))?;
        }
        if roots.is_empty() { Err(refuse()) } else { Ok(roots) }
    }

    /// The header `authorization`.
    pub(crate) fn header(&self) -> Result<Option<MetadataValue<Ascii>>, ClientError> {
        let Some(token) = &self.token else { return Ok(None) };
        let refuse =
            |_| ClientError::Credentials("a token is one line of letters, digits, `-` and `_`".to_owned());
        let mut header: MetadataValue<Ascii> = format!("Bearer {}", token.trim()).parse().map_err(refuse)?;
        header.set_sensitive(true);
        Ok(Some(header))
    }
}

/// Sends the token with every call.
#[derive(Clone, Debug)]
pub struct Bearer(pub(crate) Option<MetadataValue<Ascii>>);

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(header) = &self.0 {
            request.metadata_mut().insert("authorization", header.clone());
        }
        Ok(request)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_not_shown_and_nonsense_is_refused() {
        assert!(!format!("{:?}", Credentials::token("secret")).contains("secret"));
        assert!(Credentials::token("two\nlines").header().is_err());
        let no_pem = Credentials { token: None, ca_pem: Some(b"x".to_vec()) };
        assert!(no_pem.connector(true).is_err() && no_pem.connector(false).is_ok());
    }
}
