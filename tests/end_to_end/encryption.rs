//! Both ports encrypted, with certificates that change while the server runs.

use client::{Credentials, HttpClient, SlamClient};
use std::path::Path;
use std::time::Duration;
use store::TokenRole;
use tests::TestServer;

/// Writes a new certificate for this machine, with its key, and tells it.
fn certify(folder: &Path) -> Vec<u8> {
    let names = vec!["localhost".to_owned(), "127.0.0.1".to_owned()];
    let rcgen::CertifiedKey { cert, signing_key } = rcgen::generate_simple_self_signed(names).unwrap();
    std::fs::write(folder.join("key.pem"), signing_key.serialize_pem()).unwrap();
    std::fs::write(folder.join("cert.pem"), cert.pem()).unwrap();
    cert.pem().into_bytes()
}

async fn n_sessions(server: &TestServer, ca: &[u8], token: &str) -> Result<usize, client::ClientError> {
    let credentials = Credentials { token: Some(token.to_owned()), ca_pem: Some(ca.to_vec()) };
    let address = format!("https://{}", server.running().grpc_addr);
    let mut client = SlamClient::connect_with(&address, credentials.clone()).await?;
    let http: HttpClient = client.http().await?;
    let missing = http.session_json("nowhere", "").await.unwrap_err().to_string();
    assert!(missing.contains("there is no session"), "the HTTP port answers: {missing}");
    Ok(client.sessions().await?.len())
}

#[tokio::test(flavor = "multi_thread")]
async fn certificates_are_read_again_when_they_change() {
    let folder = tempfile::tempdir().unwrap();
    let first = certify(folder.path());
    let server = TestServer::start_with(|config| {
        config.tls.cert = Some(folder.path().join("cert.pem"));
        config.tls.key = Some(folder.path().join("key.pem"));
        config.tls.reload_s = 0.2;
    })
    .await;
    let token = server.token("robot", TokenRole::Writer).await;
    assert_eq!(n_sessions(&server, &first, &token).await.unwrap(), 0);
    let plain = SlamClient::connect(&format!("http://{}", server.running().grpc_addr)).await;
    let plain = match plain {
        Ok(mut client) => client.sessions().await.map(|_| ()),
        Err(error) => Err(error),
    };
    assert!(plain.is_err(), "what is not encrypted is not answered");

    // Half-written files are not used; the ones from before are.
    std::fs::write(folder.path().join("cert.pem"), "-----BEGIN").unwrap();
    tokio::time::sleep(Duration::from_millis(600)).await;
    assert_eq!(n_sessions(&server, &first, &token).await.unwrap(), 0);

    let second = certify(folder.path());
    let renewed = async {
        while n_sessions(&server, &second, &token).await.is_err() {
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(10), renewed).await.expect("the new certificate is used");
    assert!(n_sessions(&server, &first, &token).await.is_err(), "the old one is not");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_key_of_another_certificate_is_named_at_the_start() {
    let folder = tempfile::tempdir().unwrap();
    certify(folder.path());
    let other = tempfile::tempdir().unwrap();
    certify(other.path());
    let mut config = server::Config::local(folder.path().join("data"));
    config.tls.cert = Some(folder.path().join("cert.pem"));
    config.tls.key = Some(other.path().join("key.pem"));
    let error = server::Server::start(config).await.err().expect("it does not start");
    assert!(format!("{error:#}").contains("is not that of"), "{error:#}");
}
