//! Requests that one server of a fleet passes on to another: marked, so that they are passed on once, and
//! signed, so that the other believes whose they are.
//!
//! A passed request comes from the address of the server that passes it. Whom it asks for, and whether that
//! was encrypted, stands in its mark, which is signed with a secret that the servers' database holds and only
//! they read. A mark that nobody signed changes nothing about who asks; it only keeps the request from being
//! passed on, so that no loop arises, however wrong the servers are configured.

use crate::connections::Peer;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, Uri};
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ring::hmac;
use std::net::{IpAddr, SocketAddr};

/// Marks a request that was passed on.
const MARK: HeaderName = HeaderName::from_static("monoslam-passed");

/// What this server signs marks with, and knows others' by.
pub struct Marks {
    key: hmac::Key,
    own_name: String,
}

/// What is known of a request that was passed on. Kept in its extensions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Passed {
    /// Whether a server of this fleet signed it.
    pub is_proven: bool,
}

/// Which request a mark is for.
#[derive(Clone, Copy)]
pub struct Asked<'a> {
    /// Its method.
    pub method: &'a Method,
    /// Its path, with the query.
    pub uri: &'a Uri,
}

impl Marks {
    /// Those of a fleet with this secret.
    pub fn new(secret: &[u8], own_name: String) -> Self {
        Self { key: hmac::Key::new(hmac::HMAC_SHA256, secret), own_name }
    }

    /// The mark of a request that is passed on to the server of this name.
    pub fn mark(&self, to: &str, peer: Peer, asked: Asked<'_>) -> (HeaderName, HeaderValue) {
        let who = who(peer);
        let signature = hmac::sign(&self.key, content(to, &who, asked).as_bytes());
        let text = format!("{who} {}", URL_SAFE_NO_PAD.encode(signature));
        // Letters, digits, and what addresses and base64 have besides.
        (MARK, HeaderValue::try_from(text).unwrap_or_else(|_| HeaderValue::from_static("unsigned")))
    }

    /// Who asks, if a server of the fleet says so in the request's mark.
    fn read(&self, headers: &HeaderMap, asked: Asked<'_>) -> Option<Peer> {
        let (who, signature) = headers.get(MARK)?.to_str().ok()?.rsplit_once(' ')?;
        let signature = URL_SAFE_NO_PAD.decode(signature).ok()?;
        hmac::verify(&self.key, content(&self.own_name, who, asked).as_bytes(), &signature).ok()?;
        let (address, is_encrypted) = who.split_once(' ')?;
        let addr = SocketAddr::new(address.parse::<IpAddr>().ok()?, 0);
        Some(Peer { addr, is_encrypted: is_encrypted == "encrypted" })
    }
}

/// What is known of a request's mark, if it has one, and who asks, if that can be believed.
pub fn read(marks: Option<&Marks>, headers: &HeaderMap, asked: Asked<'_>) -> Option<(Passed, Option<Peer>)> {
    headers.get(MARK)?;
    let peer = marks.and_then(|marks| marks.read(headers, asked));
    Some((Passed { is_proven: peer.is_some() }, peer))
}

fn who(peer: Peer) -> String {
    let how = if peer.is_encrypted { "encrypted" } else { "plain" };
    format!("{} {how}", peer.addr.ip().to_canonical())
}

fn content(to: &str, who: &str, Asked { method, uri }: Asked<'_>) -> String {
    let path = uri.path_and_query().map_or("", |path| path.as_str());
    format!("monoslam-passed\n{to}\n{who}\n{method}\n{path}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const POST: Method = Method::POST;

    fn peer(addr: &str) -> Peer {
        Peer { addr: addr.parse().unwrap(), is_encrypted: true }
    }

    #[test]
    fn what_another_server_signed_is_believed_and_nothing_else() {
        let here = Marks::new(b"secret", "here".into());
        let there = Marks::new(b"secret", "there".into());
        let uri = Uri::from_static("/v1/sessions/a/stream?policy=lossless");
        let asked = Asked { method: &POST, uri: &uri };
        let headers = HeaderMap::from_iter([there.mark("here", peer("203.0.113.7:99"), asked)]);
        let (passed, found) = read(Some(&here), &headers, asked).unwrap();
        assert!(passed.is_proven);
        assert_eq!(found, Some(peer("203.0.113.7:0")));

        let unproven = |marks: &Marks, headers: &HeaderMap, asked| {
            read(Some(marks), headers, asked) == Some((Passed { is_proven: false }, None))
        };
        assert!(unproven(&there, &headers, asked), "it is for another server");
        assert!(unproven(&Marks::new(b"guess", "here".into()), &headers, asked));
        let other = Uri::from_static("/v1/sessions/b");
        assert!(unproven(&here, &headers, Asked { method: &POST, uri: &other }), "of another request");
        let text = headers[MARK].to_str().unwrap().replace("203.0.113.7", "127.0.0.1");
        let forged = HeaderMap::from_iter([(MARK, HeaderValue::try_from(text).unwrap())]);
        assert!(unproven(&here, &forged, asked));
        for forged in ["", "127.0.0.1 plain", "127.0.0.1 plain AAAA", "x"] {
            assert!(unproven(&here, &HeaderMap::from_iter([(MARK, forged.parse().unwrap())]), asked));
        }
        assert_eq!(read(Some(&here), &HeaderMap::new(), asked), None);
        assert_eq!(read(None, &headers, asked), Some((Passed { is_proven: false }, None)));
    }
}
