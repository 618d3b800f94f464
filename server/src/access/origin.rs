//! Which pages in a browser may ask.
//!
//! A browser sends requests of any page to any server, also to one that only its visitor reaches. Two headers
//! tell: `Origin` says whose page it is, and `Host` by which name it found the server. A foreign name that
//! leads to this server's address makes a page its own (DNS rebinding), so that only names are taken which
//! nobody else can let lead here.

use crate::error::{ApiError, ErrorCode};
use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderName, Uri};
use std::net::IpAddr;

/// The names and pages that are taken.
pub struct Pages {
    hosts: Vec<String>,
    origins: Vec<String>,
}

impl Pages {
    /// Those of the configuration, and this machine's name.
    pub fn new(hosts: &[String], origins: &[String]) -> Self {
        let own = hostname::get().ok().and_then(|name| name.into_string().ok());
        let own = own.into_iter().flat_map(|name| [format!("{name}.local"), name]);
        let hosts = own.chain(hosts.iter().cloned()).map(|host| host.to_ascii_lowercase()).collect();
        Self { hosts, origins: origins.to_vec() }
    }

    /// Checks by which name the server was called.
    ///
    /// # Errors
    /// If it is one by which others could have made a page of theirs come here.
    pub fn check_host(&self, headers: &HeaderMap, uri: &Uri) -> Result<(), ApiError> {
        let Some(host) = uri.host().or_else(|| text(headers, HOST).map(without_port)) else { return Ok(()) };
        let host = host.trim_matches(['[', ']']).trim_end_matches('.').to_ascii_lowercase();
        let is_safe = host.parse::<IpAddr>().is_ok()
            || !host.contains('.')
            || host.ends_with(".localhost")
            || self.hosts.contains(&host);
        if is_safe {
            return Ok(());
        }
        let sentence = format!(
            "this server does not know itself by the name {host:?}; whoever runs it adds the name to access.hosts"
        );
        Err(ApiError::new(ErrorCode::WrongHost, sentence))
    }

    /// Whether a foreign origin was allowed.
    pub fn allows(&self, origin: &str) -> bool {
        self.origins.iter().any(|allowed| allowed == origin)
    }

    /// Checks whose page asks for a change or a stream.
    ///
    /// # Errors
    /// If it is neither this server's nor one that was allowed.
    pub fn check_origin(&self, headers: &HeaderMap, uri: &Uri) -> Result<(), ApiError> {
        let Some(origin) = headers.get(ORIGIN) else { return Ok(()) };
        let origin = origin.to_str().unwrap_or_default();
        let host = text(headers, HOST).or_else(|| uri.authority().map(|authority| authority.as_str()));
        let is_own = origin.split_once("://").is_some_and(|(_, authority)| host == Some(authority));
        if is_own || self.allows(origin) {
            return Ok(());
        }
        let sentence =
            "only pages of this server and those of access.cors_origins may do that from a browser";
        Err(ApiError::new(ErrorCode::ForeignOrigin, sentence))
    }
}

fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn headers(origin: Option<&'static str>, host: &'static str) -> HeaderMap {
        let mut headers = HeaderMap::from_iter([(HOST, HeaderValue::from_static(host))]);
        headers.extend(origin.map(|origin| (ORIGIN, HeaderValue::from_static(origin))));
        headers
    }

    #[test]
    fn pages_of_other_servers_are_refused_and_programs_are_not() {
        let pages = Pages::new(&[], &["https://maps.example".to_owned()]);
        let check = |origin, host| pages.check_origin(&headers(origin, host), &Uri::from_static("/"));
        assert!(check(None, "h:8080").is_ok());
        assert!(check(Some("http://h:8080"), "h:8080").is_ok());
        assert!(check(Some("https://h"), "h").is_ok());
        assert!(check(Some("https://maps.example"), "h").is_ok());
        for origin in ["http://evil.example", "http://h", "null", "h:8080", "http://h:8080.evil.example"] {
            let refused = check(Some(origin), "h:8080");
            assert_eq!(refused.unwrap_err().code, ErrorCode::ForeignOrigin, "{origin}");
        }
    }

    #[test]
    fn names_that_others_can_lead_here_are_refused() {
        let pages = Pages::new(&["Maps.Example".to_owned()], &[]);
        let check = |host| pages.check_host(&headers(None, host), &Uri::from_static("/"));
        for host in [
            "127.0.0.1:8080",
            "[::1]:8080",
            "localhost:1",
            "slam:8080",
            "a.localhost",
            "maps.example",
            "10.0.0.7",
        ] {
            assert!(check(host).is_ok(), "{host}");
        }
        for host in ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", "maps.example.evil"] {
            assert_eq!(check(host).unwrap_err().code, ErrorCode::WrongHost, "{host}");
        }
    }
}
