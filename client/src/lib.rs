//! Typed client of the SLAM service: streams frames, asks for sessions, places and trajectories.
//!
//! * [`SlamClient`]: sessions, localization, events and open streams, by gRPC.
//! * [`stream_frames`]: streams a [`FrameSource`], such as a [`Recording`], until every frame is answered and
//!   saved. A connection that breaks is made again; each frame is mapped exactly once.
//! * [`Sequential`]: a source of what is read in turn, such as a video ([`Ffmpeg`]), a robot's recording
//!   (`Bag`, by the feature `bags`) or a camera of your own ([`FrameReader`]).
//! * [`HttpClient`]: trajectories and maps in every format, images of keyframes.
//!
//! Where the server needs a token or has a certificate of its own, [`Credentials`] hold both
//! ([`SlamClient::connect_with`]).
//!
//! A recording, streamed into a session of its own; `SERVER` is where the service is, such as
//! `http://127.0.0.1:50051`:
//!
//! ```
//! use client::{FrameSource, Recording, SlamClient, StreamPlan, stream_frames, v1};
//! use std::{path::Path, sync::Arc};
//!
//! async fn map(server: &str, folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
//!     let recording = Recording::open(folder, None)?;
//!     let mut client = SlamClient::connect(server).await?;
//!     client.create_session("kitchen", recording.camera.parameters(), v1::SessionOptions::default()).await?;
//!     let source: Arc<dyn FrameSource> = Arc::new(recording);
//!     let plan = StreamPlan::lossless("kitchen", source.as_ref());
//!     let summary = stream_frames(&mut client, &source, &plan, |event| println!("{event:?}")).await?;
//!     let trajectory = client.http().await?.trajectory("kitchen").await?;
//!     println!("{} of {} frames have a pose", trajectory.len(), summary.frames);
//!     Ok(())
//! }
//! # // A server of its own and eight rendered frames: what is printed above is run here.
//! # let runtime = tokio::runtime::Runtime::new()?;
//! # runtime.block_on(async {
//! #     let folder = tempfile::tempdir()?;
//! #     let mut config = synthetic::SequenceConfig::preset(synthetic::Preset::RoomRich, 1);
//! #     config.n_frames = Some(8);
//! #     synthetic::Sequence::new(config)?.write_dataset(folder.path().join("room"))?;
//! #     let server = server::Server::start(server::Config::local(folder.path())).await?;
//! #     let address = format!("http://{}", server.grpc_addr);
//! #     map(&address, &folder.path().join("room")).await?;
//! #     let session = SlamClient::connect(&address).await?.session("kitchen").await?.ok_or("no session")?;
//! #     assert_eq!(session.n_frames, 8);
//! #     assert_eq!(server.shutdown().await, server::Shutdown::Complete);
//! #     Ok::<(), Box<dyn std::error::Error>>(())
//! # })?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod convert;
mod credentials;
mod error;
mod grpc;
mod http;
mod pacing;
mod placement;
mod sequential;
mod source;
mod streaming;
mod summary;
mod tally;

pub use convert::camera_message;
pub use credentials::Credentials;
pub use error::ClientError;
#[doc(no_inline)]
pub use geometry::{CameraModel, CameraParameters};
pub use grpc::{Answers, Events, FrameSender, FrameStream, HTTP_PORT_HEADER, SlamClient};
pub use http::{HttpClient, ImageFile, MapFormat, Submaps, TrajectoryFormat, TrajectoryKind};
pub use pacing::Pacing;
pub use placement::{Placement, SessionEnd};
#[doc(no_inline)]
pub use proto::v1;
#[doc(no_inline)]
#[cfg(feature = "bags")]
pub use recordings::Bag;
pub use recordings::{
    Ffmpeg, FileError, FrameImage, FrameReader, Layout, PixelFormat, RawImage, Recording, StampedPose,
    TimedFrame, Trajectory, VideoInput,
};
pub use sequential::Sequential;
pub use source::{FrameError, FrameSource, ReadyFrame, SourceFrame, read_ahead};
pub use streaming::{StreamEvent, StreamPlan, stream_frames};
pub use summary::{CameraFinding, Distribution, FrameAnswer, StageSummary, StreamSummary};
