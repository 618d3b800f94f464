//! The last words to a connection that is not taken, in the protocol it expects.

use super::serve::Interface;
use super::table::Full;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio::sync::Semaphore;

/// Refusals that are being said at the same time; further connections are closed without a word.
const MAX_REFUSALS: usize = 64;

/// How long saying one may take.
const PATIENCE: Duration = Duration::from_secs(1);

/// Frames of HTTP/2 [RFC 9113, sections 6.5, 6.8 and 7].
const SETTINGS: u8 = 0x4;
const GO_AWAY: u8 = 0x7;
const ENHANCE_YOUR_CALM: u32 = 0xb;

/// Says why connections are not taken.
pub struct Refusals(Arc<Semaphore>);

impl Refusals {
    /// None is being said.
    pub fn new() -> Self {
        Self(Arc::new(Semaphore::new(MAX_REFUSALS)))
    }

    /// Says it and closes the connection.
    pub fn say(&self, mut stream: TcpStream, interface: Interface, full: Full) {
        let Ok(turn) = self.0.clone().try_acquire_owned() else { return };
        tokio::spawn(async move {
            let _turn = turn;
            let said = async {
                stream.write_all(&words(interface, full)).await?;
                stream.shutdown().await?;
                // What the client has sent is read: closing before would take the words from it.
                tokio::io::copy(&mut stream, &mut tokio::io::sink()).await
            };
            let _ = tokio::time::timeout(PATIENCE, said).await;
        });
    }
}

fn words(interface: Interface, full: Full) -> Vec<u8> {
    let sentence = format!("{full}; try again later");
    match interface {
        Interface::Http => {
            let problem = serde_json::json!({
                "type": "urn:monoslam:error:TOO_MANY_CONNECTIONS", "title": "Too many connections", "status": 503,
                "detail": sentence, "code": "TOO_MANY_CONNECTIONS",
            });
            let body = problem.to_string();
            let head = "HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/problem+json\r\n\
                        retry-after: 1\r\nconnection: close\r\n";
            format!("{head}content-length: {}\r\n\r\n{body}", body.len()).into_bytes()
        }
        Interface::Grpc => {
            let mut bytes = frame(SETTINGS, &[]);
            let mut reason = vec![0; 4];
            reason.extend(ENHANCE_YOUR_CALM.to_be_bytes());
            reason.extend(sentence.as_bytes());
            bytes.extend(frame(GO_AWAY, &reason));
            bytes
        }
    }
}

/// A frame of the connection as a whole, without flags.
fn frame(kind: u8, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u32).to_be_bytes();
    let mut bytes = vec![length[1], length[2], length[3], kind, 0, 0, 0, 0, 0];
    bytes.extend(payload);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_say_why() {
        let http = String::from_utf8(words(Interface::Http, Full::InAll(7))).unwrap();
        let (head, body) = http.split_once("\r\n\r\n").unwrap();
        assert!(head.contains(&format!("content-length: {}", body.len())) && body.contains("7 connections"));
        let grpc = words(Interface::Grpc, Full::OfAddress(3));
        assert_eq!(&grpc[..9], [0, 0, 0, SETTINGS, 0, 0, 0, 0, 0]);
        assert_eq!((usize::from(grpc[11]), grpc[12]), (grpc.len() - 18, GO_AWAY));
        assert!(String::from_utf8_lossy(&grpc).contains("3 connections of this address"));
    }
}
