//! What is fetched over HTTP.

use std::fmt;
use std::io::Write;
use std::str::FromStr;

use bytes::Bytes;
use http_body_util::{BodyExt, Empty, Limited};
use hyper::body::Incoming;
use hyper_util::client::legacy::Client;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use recordings::Trajectory;
use serde::Deserialize;
use tonic::codegen::http::{StatusCode, Uri};

use crate::error::{ClientError, causes};

/// The longest body of an error that is read, bytes: a problem is a few hundred.
const MAX_PROBLEM_BYTES: usize = 64 << 10;

/// What must be escaped in a segment of a path [RFC 3986, section 2.3].
const NOT_UNRESERVED: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~');

/// How a trajectory is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrajectoryFormat {
    /// `t tx ty tz qx qy qz qw`, seconds.
    Tum,
    /// `t,px,py,pz,qw,qx,qy,qz`, nanoseconds.
    Euroc,
    /// The upper three rows of the matrix, no times.
    Kitti,
    /// Everything that is known, comma-separated.
    Csv,
    /// Everything that is known, as one object.
    Json,
}

impl TrajectoryFormat {
    const ALL: [(Self, &str); 5] = [
        (Self::Tum, "tum"),
        (Self::Euroc, "euroc"),
        (Self::Kitti, "kitti"),
        (Self::Csv, "csv"),
        (Self::Json, "json"),
    ];
}

/// Which poses a trajectory has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrajectoryKind {
    /// Those of all frames that have one.
    Frames,
    /// Those of keyframes.
    Keyframes,
}

impl TrajectoryKind {
    const ALL: [(Self, &str); 2] = [(Self::Frames, "frames"), (Self::Keyframes, "keyframes")];
}

/// Names as in the interface's queries and on the command line.
macro_rules! named {
    ($type:ty, $what:literal) => {
        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(Self::ALL.iter().find(|(value, _)| value == self).map_or("", |(_, name)| *name))
            }
        }

        impl FromStr for $type {
            type Err = String;

            fn from_str(text: &str) -> Result<Self, String> {
                Self::ALL.iter().find(|(_, name)| *name == text).map(|(value, _)| *value).ok_or_else(|| {
                    let names = Self::ALL.map(|(_, name)| name).join(", ");
                    format!(concat!("`{}` is not ", $what, ": {}"), text, names)
                })
            }
        }
    };
}

named!(TrajectoryFormat, "a format");
named!(TrajectoryKind, "a kind of trajectory");

/// The HTTP interface of a server.
#[derive(Clone, Debug)]
pub struct HttpClient {
    address: String,
    http: Client<HttpConnector, Empty<Bytes>>,
}

/// The body of an error [RFC 9457].
#[derive(Deserialize)]
struct Problem {
    title: Option<String>,
    detail: Option<String>,
}

impl HttpClient {
    /// The interface at an address such as `http://127.0.0.1:8080`.
    pub fn new(address: impl Into<String>) -> Self {
        let address = address.into().trim_end_matches('/').to_owned();
        Self { address, http: Client::builder(TokioExecutor::new()).build_http() }
    }

    /// Writes a session's trajectory to `out` as it comes.
    ///
    /// # Errors
    /// If the server cannot be asked or refuses, or `out` fails.
    pub async fn write_trajectory(
        &self,
        session_id: &str,
        format: TrajectoryFormat,
        kind: TrajectoryKind,
        out: &mut impl Write,
    ) -> Result<(), ClientError> {
        let session_id = utf8_percent_encode(session_id, NOT_UNRESERVED);
        let path = format!("/v1/sessions/{session_id}/trajectory?format={format}&kind={kind}");
        let mut body = self.get(&path).await?;
        while let Some(frame) = body.frame().await {
            let frame = frame.map_err(|error| self.unreachable(&error))?;
            if let Some(bytes) = frame.data_ref() {
                out.write_all(bytes)?;
            }
        }
        Ok(out.flush()?)
    }

    /// The session's trajectory, `world_from_camera` of all frames that have a pose.
    ///
    /// # Errors
    /// If the server cannot be asked or refuses.
    pub async fn trajectory(&self, session_id: &str) -> Result<Trajectory, ClientError> {
        let mut tum = Vec::new();
        self.write_trajectory(session_id, TrajectoryFormat::Tum, TrajectoryKind::Frames, &mut tum).await?;
        Trajectory::parse_tum(&String::from_utf8_lossy(&tum))
            .map_err(|error| ClientError::protocol(error.to_string()))
    }

    /// The body of a successful answer.
    async fn get(&self, path: &str) -> Result<Incoming, ClientError> {
        let uri: Uri = format!("{}{path}", self.address).parse().map_err(|_| ClientError::Address {
            address: self.address.clone(),
            reason: "http://HOST:PORT expected".to_owned(),
        })?;
        let response = self.http.get(uri).await.map_err(|error| self.unreachable(&error))?;
        if response.status().is_success() {
            Ok(response.into_body())
        } else {
            Err(refusal(response.status(), response.into_body()).await)
        }
    }

    fn unreachable(&self, error: &(dyn std::error::Error + 'static)) -> ClientError {
        ClientError::Unreachable { server: self.address.clone(), reason: causes(error) }
    }
}

async fn refusal(status: StatusCode, body: Incoming) -> ClientError {
    let code = match status.as_u16() {
        400 => tonic::Code::InvalidArgument,
        404 => tonic::Code::NotFound,
        503 => tonic::Code::Unavailable,
        _ => tonic::Code::Unknown,
    };
    let body = Limited::new(body, MAX_PROBLEM_BYTES).collect().await.ok();
    let problem = body.and_then(|body| serde_json::from_slice::<Problem>(&body.to_bytes()).ok());
    let sentence = problem.and_then(|problem| problem.detail.or(problem.title));
    ClientError::Refused {
        code,
        message: sentence.unwrap_or_else(|| format!("the server answered {status}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_back() {
        for (format, name) in TrajectoryFormat::ALL {
            assert_eq!((name.parse(), format.to_string()), (Ok(format), name.to_owned()));
        }
        assert_eq!("keyframes".parse(), Ok(TrajectoryKind::Keyframes));
        assert_eq!(
            "xml".parse::<TrajectoryFormat>().unwrap_err(),
            "`xml` is not a format: tum, euroc, kitti, csv, json"
        );
    }
}
