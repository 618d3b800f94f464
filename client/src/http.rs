//! What is fetched over HTTP.

use std::fmt;
use std::io::Write;
use std::str::FromStr;

use serde::Deserialize;

use crate::Trajectory;
use crate::error::{ClientError, causes};

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
    /// Those of key frames.
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
    http: reqwest::Client,
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
        Self { address, http: reqwest::Client::new() }
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
        let url = format!("{}/v1/sessions/{session_id}/trajectory?format={format}&kind={kind}", self.address);
        let mut response = self.http.get(url).send().await.map_err(|error| self.unreachable(error))?;
        if !response.status().is_success() {
            return Err(refusal(response).await);
        }
        while let Some(chunk) = response.chunk().await.map_err(|error| self.unreachable(error))? {
            out.write_all(&chunk)?;
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
        Ok(Trajectory::parse_tum(&String::from_utf8_lossy(&tum))?)
    }

    fn unreachable(&self, error: reqwest::Error) -> ClientError {
        ClientError::Unreachable { server: self.address.clone(), reason: causes(&error.without_url()) }
    }
}

async fn refusal(response: reqwest::Response) -> ClientError {
    let status = response.status();
    let code = match status.as_u16() {
        400 => tonic::Code::InvalidArgument,
        404 => tonic::Code::NotFound,
        503 => tonic::Code::Unavailable,
        _ => tonic::Code::Unknown,
    };
    let problem = response.json::<Problem>().await.ok();
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
