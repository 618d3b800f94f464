//! What goes wrong between a client and its server.

use thiserror::Error;
use tonic::Code;
use tonic_types::StatusExt;

use crate::source::FrameError;

/// Why something asked of the server was not done.
#[derive(Debug, Error)]
pub enum ClientError {
    /// The address is not one.
    #[error("`{address}` is not the address of a server: {reason}")]
    Address {
        /// What was given.
        address: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The token or the certificates cannot be used.
    #[error("the credentials cannot be used: {0}")]
    Credentials(String),
    /// The server cannot be reached, or the connection broke.
    #[error("the server at {server} cannot be reached: {reason}")]
    Unreachable {
        /// Its address.
        server: String,
        /// The reason, innermost cause last.
        reason: String,
    },
    /// Somebody answers at the address, but not by gRPC.
    #[error(
        "what answers at {server} does not speak gRPC; is it the address of the HTTP interface, which goes with --http?"
    )]
    NotGrpc {
        /// The address.
        server: String,
    },
    /// The server said no.
    #[error("{message}")]
    Refused {
        /// The kind of error.
        code: Code,
        /// The server's sentence.
        message: String,
    },
    /// Another server of the same fleet works with the session.
    #[error("{message}")]
    OwnedElsewhere {
        /// The address of that server's gRPC.
        owner: String,
        /// The server's sentence.
        message: String,
    },
    /// The server answered what the contract does not allow.
    #[error("the server's answer cannot be used: {0}")]
    Protocol(String),
    /// The source could not give a frame.
    #[error("frame {frame_idx}: {reason}")]
    Frame {
        /// Its place in the source.
        frame_idx: usize,
        /// Why.
        reason: FrameError,
    },
    /// What came could not be written.
    #[error("cannot write")]
    Write(#[from] std::io::Error),
}

impl ClientError {
    /// Whether the same request may succeed later: the server did not answer, or said that it cannot now.
    pub fn is_passing(&self) -> bool {
        match self {
            Self::Unreachable { .. } | Self::OwnedElsewhere { .. } => true,
            Self::Refused { code, .. } => *code == Code::Unavailable,
            _ => false,
        }
    }

    /// A server that does not answer, and what of the environment may lead astray.
    pub(crate) fn unreachable(server: &str, reason: String) -> Self {
        let proxies = PROXY_VARIABLES.iter().filter_map(|name| Some((*name, std::env::var(name).ok()?)));
        let hint = proxy_hint(server, proxies).unwrap_or_default();
        Self::Unreachable { server: server.to_owned(), reason: reason + &hint }
    }

    pub(crate) fn protocol(message: impl Into<String>) -> Self {
        Self::Protocol(message.into())
    }

    /// Sorts a status into what the server said and what befell the connection.
    ///
    /// Both use codes such as INTERNAL, but the server's errors carry an `ErrorInfo`, and those made on this
    /// side for a broken connection do not.
    pub(crate) fn from_status(server: &str, status: &tonic::Status) -> Self {
        let details = status.get_error_details();
        let is_from_server = details.error_info().is_some();
        let owner = details.error_info().filter(|info| info.reason == OWNED_ELSEWHERE);
        if let Some(owner) = owner.and_then(|info| info.metadata.get(OWNER_URL)) {
            return Self::OwnedElsewhere { owner: owner.clone(), message: status.message().to_owned() };
        }
        let is_of_connection =
            matches!(status.code(), Code::Unavailable | Code::Unknown | Code::Internal | Code::Cancelled);
        if is_from_web_server(status) {
            return Self::NotGrpc { server: server.to_owned() };
        }
        if is_of_connection && !is_from_server {
            return Self::unreachable(server, causes(status));
        }
        Self::Refused { code: status.code(), message: status.message().to_owned() }
    }
}

/// What the server calls it when another one works with the session, and where it tells which.
const OWNED_ELSEWHERE: &str = "OWNED_ELSEWHERE";
const OWNER_URL: &str = "grpc_url";

/// Variables that name a proxy, for other programs.
const PROXY_VARIABLES: [&str; 6] =
    ["http_proxy", "HTTP_PROXY", "https_proxy", "HTTPS_PROXY", "all_proxy", "ALL_PROXY"];

/// What to say of a server that is not reached where there is a proxy, unless it is on this machine.
fn proxy_hint<'a>(server: &str, mut proxies: impl Iterator<Item = (&'a str, String)>) -> Option<String> {
    let uri: tonic::transport::Uri = server.parse().ok()?;
    let host = uri.host()?.trim_matches(['[', ']']);
    let is_loopback = host == "localhost" || host.parse().is_ok_and(|ip: std::net::IpAddr| ip.is_loopback());
    let (name, proxy) = proxies.find(|(_, proxy)| !is_loopback && !proxy.is_empty())?;
    Some(format!("; the connection goes to it directly: the proxy {proxy} that {name} names is not used"))
}

/// Whether a status stands for the page of a web server that knows nothing of what was asked. There is no
/// other sign of that than tonic's words.
fn is_from_web_server(status: &tonic::Status) -> bool {
    let message = status.message();
    let is_page =
        message.contains("invalid compression flag") || message.contains("grpc-status header missing");
    is_page && ["404", "405", "415"].iter().any(|code| message.contains(code))
}

/// An error with its causes, each once, from the outermost in.
pub(crate) fn causes(error: &(dyn std::error::Error + 'static)) -> String {
    let mut sentences: Vec<String> = Vec::new();
    let mut next = Some(error);
    while let Some(cause) = next {
        // The display of a status is its debug form; its message is the sentence.
        let sentence = cause
            .downcast_ref::<tonic::Status>()
            .map_or_else(|| cause.to_string(), |s| s.message().to_owned());
        if !sentence.is_empty() && !sentences.iter().any(|said| said.contains(&sentence)) {
            sentences.push(sentence);
        }
        next = cause.source();
    }
    sentences.join(": ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;
    use tonic::Status;
    use tonic_types::ErrorDetails;

    #[test]
    fn a_proxy_is_named_unless_the_server_is_on_this_machine() {
        let hint = |server: &str, proxy: &str| {
            proxy_hint(server, [("http_proxy", proxy.to_owned())].into_iter()).unwrap_or_default()
        };
        let told = hint("http://slam.example:50051", "http://10.0.0.1:3128");
        assert!(told.contains("http://10.0.0.1:3128") && told.contains("http_proxy"), "{told}");
        for local in ["http://127.0.0.1:50051", "http://[::1]:50051", "http://localhost:50051"] {
            assert_eq!(hint(local, "http://10.0.0.1:3128"), "", "{local}");
        }
        assert_eq!(hint("http://slam.example:50051", ""), "");
    }

    #[test]
    fn a_broken_connection_passes_and_a_refusal_does_not() {
        let classify = |status: &Status| ClientError::from_status("http://h:1", status);
        assert!(classify(&Status::unknown("h2 protocol error")).is_passing());
        assert!(classify(&Status::unavailable("connection refused")).is_passing());
        assert!(!classify(&Status::not_found("there is no session \"x\"")).is_passing());
        let page = "protocol error: received message with invalid compression flag: 123 (valid flags are 0 and 1) while \
                    receiving response with status: 404 Not Found";
        let page = classify(&Status::internal(page));
        assert!(!page.is_passing() && page.to_string().contains("does not speak gRPC"), "{page}");
        let details = ErrorDetails::with_error_info("SESSION_FAILED", "monoslam", HashMap::new());
        let failed = Status::with_error_details(Code::Internal, "the session failed", details);
        assert!(!classify(&failed).is_passing());
        assert_eq!(classify(&failed).to_string(), "the session failed");
        let details = ErrorDetails::with_error_info("SHUTTING_DOWN", "monoslam", HashMap::new());
        let closing = Status::with_error_details(Code::Unavailable, "the server is about to stop", details);
        assert!(classify(&closing).is_passing());
    }
}
