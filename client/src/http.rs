//! What is fetched over HTTP.

use std::fmt;
use std::io::Write;
use std::str::FromStr;

use bytes::Bytes;
use http_body_util::{BodyExt, Empty, Limited};
use hyper::body::{Body, Incoming};
use hyper::header::{AUTHORIZATION, HeaderValue};
use hyper::{Request, Response};
use hyper_rustls::HttpsConnector;
use hyper_util::client::legacy::Client;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use recordings::Trajectory;
use serde::Deserialize;
use tonic::codegen::http::{StatusCode, Uri};

use crate::credentials::Credentials;
use crate::error::{ClientError, causes};

/// The longest body of an error that is read, bytes: a problem is a few hundred.
const MAX_PROBLEM_BYTES: usize = 64 << 10;

/// The largest image that is read, bytes: more than a server takes by default.
const MAX_IMAGE_BYTES: usize = 128 << 20;

/// The longest answer that is held in memory, bytes: the graph of a large map has some megabytes.
const MAX_JSON_BYTES: usize = 256 << 20;

/// The response header in which the server tells how many poses a trajectory does not have.
const POSES_LEFT_OUT_HEADER: &str = "x-monoslam-poses-left-out";

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

/// Whose poses a trajectory has: submaps do not share a frame of reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Submaps {
    /// Of all where the format names each pose's submap, else of the one with the most.
    #[default]
    OfFormat,
    /// Of all.
    All,
    /// Of the one with the most.
    Largest,
    /// Of this one.
    One(u32),
}

impl std::fmt::Display for Submaps {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::OfFormat => f.write_str("as the format has it"),
            Self::All => f.write_str("all"),
            Self::Largest => f.write_str("largest"),
            Self::One(number) => write!(f, "{number}"),
        }
    }
}

impl std::str::FromStr for Submaps {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self::All),
            "largest" => Ok(Self::Largest),
            number => number
                .parse()
                .map(Self::One)
                .map_err(|_| format!("`{number}` is not a choice of submaps: all, largest, or a number")),
        }
    }
}

/// How a map is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapFormat {
    /// Polygon file: points as vertices, lines as edges between two vertices each.
    Ply,
    /// One object with keyframes, points, lines and primitives.
    Json,
    /// `cameras.txt` of COLMAP's text model.
    ColmapCameras,
    /// `images.txt` of COLMAP's text model.
    ColmapImages,
    /// `points3D.txt` of COLMAP's text model.
    ColmapPoints,
    /// `transforms.json` of nerfstudio.
    Transforms,
    /// MCAP with Foxglove's schemas.
    Mcap,
}

impl MapFormat {
    /// As in the interface's query.
    fn query(self) -> &'static str {
        match self {
            Self::Ply => "format=ply",
            Self::Json => "format=json",
            Self::ColmapCameras => "format=colmap&part=cameras",
            Self::ColmapImages => "format=colmap&part=images",
            Self::ColmapPoints => "format=colmap&part=points3D",
            Self::Transforms => "format=transforms",
            Self::Mcap => "format=mcap",
        }
    }
}

/// An image as a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageFile {
    /// What it is, such as `image/jpeg`.
    pub media_type: String,
    /// The file.
    pub bytes: Bytes,
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
    authorization: Option<HeaderValue>,
    /// The address is made of what the server tells, which another port may stand for where the client is.
    is_told: bool,
    http: Client<HttpsConnector<HttpConnector>, Empty<Bytes>>,
}

/// The body of an error [RFC 9457].
#[derive(Deserialize)]
struct Problem {
    title: Option<String>,
    detail: Option<String>,
}

impl HttpClient {
    /// The interface at an address such as `http://127.0.0.1:8080`, where no token is needed and the system's
    /// certificates are trusted.
    ///
    /// # Errors
    /// If encryption does not work on this system.
    pub fn new(address: impl Into<String>) -> Result<Self, ClientError> {
        Self::with(address, &Credentials::default())
    }

    /// The interface at an address such as `https://maps.example:8080`.
    ///
    /// # Errors
    /// If the credentials cannot be used.
    pub fn with(address: impl Into<String>, credentials: &Credentials) -> Result<Self, ClientError> {
        let address = address.into().trim_end_matches('/').to_owned();
        let token = credentials.header()?;
        let authorization = token.and_then(|header| HeaderValue::from_bytes(header.as_encoded_bytes()).ok());
        let http = Client::builder(TokioExecutor::new())
            .build(credentials.connector(address.starts_with("https:"))?);
        Ok(Self { address, authorization, is_told: false, http })
    }

    /// The same at an address that the server told, which errors say.
    ///
    /// # Errors
    /// If the credentials cannot be used.
    pub fn told(address: impl Into<String>, credentials: &Credentials) -> Result<Self, ClientError> {
        Ok(Self { is_told: true, ..Self::with(address, credentials)? })
    }

    /// Writes a session's trajectory to `out` as it comes. Returns how many poses are left out, of other
    /// submaps than those chosen.
    ///
    /// # Errors
    /// If the server cannot be asked or refuses, or `out` fails.
    pub async fn write_trajectory(
        &self,
        session_id: &str,
        format: TrajectoryFormat,
        kind: TrajectoryKind,
        submaps: Submaps,
        out: &mut impl Write,
    ) -> Result<u64, ClientError> {
        let session_id = utf8_percent_encode(session_id, NOT_UNRESERVED);
        let mut path = format!("/v1/sessions/{session_id}/trajectory?format={format}&kind={kind}");
        if submaps != Submaps::OfFormat {
            path.push_str(&format!("&submap={submaps}"));
        }
        let response = self.get(&path).await?;
        let told =
            response.headers().get(POSES_LEFT_OUT_HEADER).and_then(|value| value.to_str().ok()?.parse().ok());
        self.write_body(response, out, |_, _| {}).await?;
        Ok(told.unwrap_or(0))
    }

    /// Writes a session's map to `out` as it comes: of one submap, or if none is given of the largest (in
    /// JSON of all). `observe` is told how many bytes there are so far, and how many there will be.
    ///
    /// # Errors
    /// If the server cannot be asked or refuses, or `out` fails.
    pub async fn write_map(
        &self,
        session_id: &str,
        format: MapFormat,
        submap_id: Option<u32>,
        out: &mut impl Write,
        observe: impl FnMut(u64, Option<u64>),
    ) -> Result<(), ClientError> {
        let session_id = utf8_percent_encode(session_id, NOT_UNRESERVED);
        let mut path = format!("/v1/sessions/{session_id}/map?{}", format.query());
        if let Some(submap_id) = submap_id {
            path.push_str(&format!("&submap_id={submap_id}"));
        }
        self.write_body(self.get(&path).await?, out, observe).await
    }

    /// What the interface says below a session's path, such as `keyframes/3` or `graph?kind=primitives`; of
    /// the session itself with nothing. The interface describes itself at `/openapi.json`.
    ///
    /// # Errors
    /// If the server cannot be asked or refuses, or its answer is no JSON.
    pub async fn session_json(
        &self,
        session_id: &str,
        below: &str,
    ) -> Result<serde_json::Value, ClientError> {
        let session_id = utf8_percent_encode(session_id, NOT_UNRESERVED);
        let separator = if below.is_empty() { "" } else { "/" };
        let response = self.get(&format!("/v1/sessions/{session_id}{separator}{below}")).await?;
        let body = Limited::new(response.into_body(), MAX_JSON_BYTES).collect().await;
        let bytes = body.map_err(|error| self.unreachable(error.as_ref()))?.to_bytes();
        serde_json::from_slice(&bytes).map_err(|error| ClientError::protocol(error.to_string()))
    }

    /// Writes everything that a viewer shows of a session, a JSON object a line, to `out`.
    ///
    /// # Errors
    /// If the server cannot be asked or refuses, or `out` fails.
    pub async fn write_scene(&self, session_id: &str, out: &mut impl Write) -> Result<(), ClientError> {
        let session_id = utf8_percent_encode(session_id, NOT_UNRESERVED);
        let path = format!("/v1/sessions/{session_id}/scene");
        self.write_body(self.get(&path).await?, out, |_, _| {}).await
    }

    /// The image of a keyframe, as it was sent; pixels sent raw come as PNG.
    ///
    /// # Errors
    /// If the server cannot be asked, the image is larger than a server takes one, or it was not kept.
    pub async fn keyframe_image(&self, session_id: &str, keyframe_id: u64) -> Result<ImageFile, ClientError> {
        let session_id = utf8_percent_encode(session_id, NOT_UNRESERVED);
        let path = format!("/v1/sessions/{session_id}/keyframes/{keyframe_id}/image");
        let response = self.get(&path).await?;
        let media_type = response.headers().get("content-type").and_then(|value| value.to_str().ok());
        let media_type = media_type.unwrap_or_default().to_owned();
        let body = Limited::new(response.into_body(), MAX_IMAGE_BYTES).collect().await;
        let bytes = body.map_err(|error| self.unreachable(error.as_ref()))?.to_bytes();
        Ok(ImageFile { media_type, bytes })
    }

    async fn write_body(
        &self,
        response: Response<Incoming>,
        out: &mut impl Write,
        mut observe: impl FnMut(u64, Option<u64>),
    ) -> Result<(), ClientError> {
        let mut body = response.into_body();
        let n_bytes = body.size_hint().exact();
        let mut n_written = 0;
        while let Some(frame) = body.frame().await {
            let frame = frame.map_err(|error| self.unreachable(&error))?;
            if let Some(bytes) = frame.data_ref() {
                out.write_all(bytes)?;
                n_written += bytes.len() as u64;
                observe(n_written, n_bytes);
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
        let (format, kind) = (TrajectoryFormat::Tum, TrajectoryKind::Frames);
        self.write_trajectory(session_id, format, kind, Submaps::OfFormat, &mut tum).await?;
        Trajectory::parse_tum(&String::from_utf8_lossy(&tum))
            .map_err(|error| ClientError::protocol(error.to_string()))
    }

    /// A successful answer.
    async fn get(&self, path: &str) -> Result<Response<Incoming>, ClientError> {
        let uri: Uri = format!("{}{path}", self.address).parse().map_err(|_| ClientError::Address {
            address: self.address.clone(),
            reason: "http://HOST:PORT or https://HOST:PORT expected".to_owned(),
        })?;
        let mut request = Request::new(Empty::new());
        *request.uri_mut() = uri;
        if let Some(authorization) = &self.authorization {
            request.headers_mut().insert(AUTHORIZATION, authorization.clone());
        }
        let response = self.http.request(request).await.map_err(|error| self.unreachable(&error))?;
        if response.status().is_success() {
            Ok(response)
        } else {
            Err(refusal(response.status(), response.into_body()).await)
        }
    }

    fn unreachable(&self, error: &(dyn std::error::Error + 'static)) -> ClientError {
        let hint = if self.is_told {
            "; that is the port the server tells of its HTTP interface: where another one leads to it, as with \
             containers, give its address with --http"
        } else {
            ""
        };
        ClientError::unreachable(&self.address, format!("{}{hint}", causes(error)))
    }
}

async fn refusal(status: StatusCode, body: Incoming) -> ClientError {
    let code = match status.as_u16() {
        400 => tonic::Code::InvalidArgument,
        401 => tonic::Code::Unauthenticated,
        403 => tonic::Code::PermissionDenied,
        404 => tonic::Code::NotFound,
        429 => tonic::Code::ResourceExhausted,
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
