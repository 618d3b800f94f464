//! Tickets: what a browser shows in a cookie where it can send no token, as for events, streams and pictures.
//!
//! A page gets one with its token. It says whose it is and until when, and is signed with a key that this
//! process made and nobody else has, so that a restart ends all of them; servers of one database sign with
//! its secret, so that each takes the others'. Nothing is kept. The server takes tickets for reading and,
//! from its own pages, for streams; changes need the token itself, which no foreign page can send.

use super::Keys;
use crate::clock::since_1970_ns;
use axum::http::header::{COOKIE, HOST};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, Uri};
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ring::hmac;
use ring::rand::SystemRandom;
use std::time::Duration;

/// Number of the token and end of the ticket, nanoseconds since 1970.
const CONTENT_BYTES: usize = 16;

/// Makes and checks tickets.
pub struct Tickets {
    key: hmac::Key,
    lifetime: Duration,
}

/// A ticket for a cookie.
pub struct Ticket {
    /// What the cookie holds.
    pub value: String,
    /// How long it is good.
    pub lifetime: Duration,
}

impl Tickets {
    /// With the key of a fleet, or with a new one.
    ///
    /// # Errors
    /// If the system gives no random numbers.
    pub fn new(lifetime: Duration, secret: Option<&[u8]>) -> anyhow::Result<Self> {
        if let Some(secret) = secret {
            // Not the secret itself, which signs other things as well.
            let secret = hmac::sign(&hmac::Key::new(hmac::HMAC_SHA256, secret), b"monoslam tickets");
            return Ok(Self { key: hmac::Key::new(hmac::HMAC_SHA256, secret.as_ref()), lifetime });
        }
        let key = hmac::Key::generate(hmac::HMAC_SHA256, &SystemRandom::new());
        Ok(Self { key: key.map_err(|_| anyhow::anyhow!("the system gives no random numbers"))?, lifetime })
    }

    /// A ticket for a token of this number.
    pub fn issue(&self, id: i64) -> Ticket {
        let end_ns = since_1970_ns().saturating_add(self.lifetime.as_nanos() as i64);
        let mut bytes = [id.to_le_bytes(), end_ns.to_le_bytes()].concat();
        bytes.extend(hmac::sign(&self.key, &bytes).as_ref());
        Ticket { value: URL_SAFE_NO_PAD.encode(bytes), lifetime: self.lifetime }
    }

    /// The number of the token a ticket is for; `None` if it is not good.
    pub fn check(&self, ticket: &str) -> Option<i64> {
        let bytes = URL_SAFE_NO_PAD.decode(ticket).ok()?;
        let (content, signature) = bytes.split_at_checked(CONTENT_BYTES)?;
        hmac::verify(&self.key, content, signature).ok()?;
        let (id, end_ns) = content.split_at(8);
        let number = |bytes: &[u8]| bytes.try_into().ok().map(i64::from_le_bytes);
        number(end_ns).filter(|end_ns| since_1970_ns() < *end_ns)?;
        number(id)
    }

    /// The number of the token of a request's ticket, if it brings a good one.
    pub fn of_request(&self, headers: &HeaderMap, uri: &Uri, keys: &Keys) -> Option<super::Caller> {
        let name = cookie_name(headers, uri);
        let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
        let pairs =
            cookies.flat_map(|cookies| cookies.split(';')).filter_map(|pair| pair.trim().split_once('='));
        let mut tickets = pairs.filter(|(found, _)| *found == name).map(|(_, ticket)| ticket);
        tickets.find_map(|ticket| keys.numbered(self.check(ticket)?))
    }
}

/// The name of the cookie: browsers give all ports of a host the same cookies, and each may be a server. Over
/// HTTP/2 host and port are in the address.
pub fn cookie_name(headers: &HeaderMap, uri: &Uri) -> String {
    let in_header = || headers.get(HOST).and_then(|host| host.to_str().ok()?.parse::<Authority>().ok());
    let port = uri.port_u16().or_else(|| in_header()?.port_u16());
    format!("monoslam_ticket_{}", port.unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cookie_is_of_the_port_in_every_version_of_http() {
        let host = |host| HeaderMap::from_iter([(HOST, axum::http::HeaderValue::from_static(host))]);
        let relative = Uri::from_static("/v1/sessions");
        assert_eq!(cookie_name(&host("slam:8443"), &relative), "monoslam_ticket_8443");
        assert_eq!(cookie_name(&host("[::1]:8443"), &relative), "monoslam_ticket_8443");
        let whole = Uri::from_static("https://slam:8443/v1/sessions");
        assert_eq!(cookie_name(&HeaderMap::new(), &whole), "monoslam_ticket_8443");
        assert_eq!(cookie_name(&host("slam"), &relative), "monoslam_ticket_0");
    }

    #[test]
    fn a_ticket_is_good_for_its_time_and_as_it_was_signed() {
        let tickets = Tickets::new(Duration::from_secs(60), None).unwrap();
        let Ticket { value, .. } = tickets.issue(7);
        assert_eq!(tickets.check(&value), Some(7));
        let mut forged = URL_SAFE_NO_PAD.decode(&value).unwrap();
        forged[0] = 8;
        assert_eq!(tickets.check(&URL_SAFE_NO_PAD.encode(forged)), None);
        assert_eq!(
            Tickets::new(Duration::from_secs(60), None).unwrap().check(&value),
            None,
            "another server's"
        );
        let of_fleet = || Tickets::new(Duration::from_secs(60), Some(b"secret")).unwrap();
        assert_eq!(of_fleet().check(&of_fleet().issue(7).value), Some(7), "servers of one database");
        assert_eq!(of_fleet().check(&value), None);
        assert_eq!(tickets.check(""), None);
        let over = Tickets::new(Duration::ZERO, None).unwrap();
        assert_eq!(over.check(&over.issue(7).value), None);
    }
}
