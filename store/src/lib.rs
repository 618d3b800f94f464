//! Where maps are kept: sessions, keyframes, points, lines, global primitives and trajectories, in one SQLite
//! file or in a database of PostgreSQL.
//!
//! Start at [`Store`]. It takes and returns the types of `slam` and `geometry`, and nothing outside this
//! crate knows that SQL is behind it.
//!
//! - [`Store::save_update`] writes one [`slam::MapUpdate`] in one transaction, and of it only the rows that
//!   changed.
//! - [`Store::load_session`] gives back what [`slam::Pipeline::resume`] goes on with.
//! - [`Store::trajectory`], [`Store::points`], [`Store::lines`], [`Store::keyframes`], [`Store::primitive`]
//!   answer questions about sessions, loaded or not, without holding a map in memory; [`Store::snapshot`]
//!   reads a whole map piece by piece as of one commit. [`Store::check`] says whether everything stored makes
//!   sense.
//!
//! [`Store::open`] opens a file, [`Store::connect`] a database of PostgreSQL; after that nothing differs but
//! what looks after files. Both take the same statements: `engine` sends them and says what differs.
//!
//! After the end of the process, or of the machine, at any moment the database is as of its last commit:
//! SQLite's write-ahead log, one writing connection, and one transaction per update see to that. Which
//! columns hold wall-clock time is said in the migrations: only `sessions.created_at_ns` and the times of
//! tokens. Everything else depends on the updates alone, which [`Store::digest`] makes comparable.
//!
//! Queries are checked when they run, not when they are compiled: the macros would need a database at build
//! time or a copy of every statement's description in the repository, and could not check the statements here
//! that are made of parts (many rows at once, optional conditions). Each statement is run by a test instead.
//!
//! ```
//! # let runtime = tokio::runtime::Runtime::new().unwrap();
//! # runtime.block_on(async {
//! use geometry::{CameraModel, CameraParameters};
//! use store::{NewSession, SessionOptions, Store, StoreOptions};
//!
//! let folder = tempfile::tempdir().unwrap();
//! let store = Store::open(folder.path().join("maps.db"), StoreOptions::default()).await?;
//! let camera = CameraParameters {
//!     model: CameraModel::Pinhole,
//!     width: 640,
//!     height: 480,
//!     fx: 525.0,
//!     fy: 525.0,
//!     cx: 319.5,
//!     cy: 239.5,
//!     distortion: vec![],
//! };
//! let options = SessionOptions::default();
//! let new = NewSession { id: "kitchen".into(), camera, options, created_at_ns: 0, mask: None, map: None };
//! store.create_session(&new).await?;
//! assert_eq!(store.list_sessions(None, 10).await?.items[0].id, "kitchen");
//! assert!(store.check().await?.is_empty());
//! # Ok::<(), store::StoreError>(())
//! # }).unwrap();
//! ```

mod backup;
mod blob;
mod cameras;
mod check;
mod copy;
mod delete;
mod descriptors;
mod digest;
mod engine;
mod error;
mod fleet;
mod frames;
#[cfg(fuzzing)]
pub mod fuzzing;
mod graph;
mod images;
mod keyframes;
mod lease;
mod lines;
mod load;
mod mask;
mod measured;
mod migrations;
mod motion;
mod number;
mod observations;
mod open;
mod page;
mod place;
mod points;
mod pose;
mod primitives;
mod save;
mod segments;
mod session;
mod snapshot;
mod tokens;
mod trajectory;

pub use backup::Verified;
pub use cameras::LoadedCamera;
pub use check::Finding;
pub use copy::Copied;
pub use digest::{Digest, TableDigest};
pub use error::StoreError;
pub use fleet::{Holder, Load, ServerRecord};
pub use frames::{FrameEntry, FramePlace};
pub use graph::{Covisibility, SharedLandmarks};
pub use images::{Collected, ObjectOptions, Objects};
pub use keyframes::{KeyframeRecord, StoredImage};
pub use lease::Owner;
pub use lines::LineQuery;
pub use load::LoadedSession;
pub use measured::MeasuredKeyframe;
pub use motion::MotionReading;
pub use number::MAX_SEQUENCE;
pub use open::{Durability, Store, StoreOptions};
pub use page::Page;
pub use points::{Bounds, PlacedPoint, PointQuery};
pub use primitives::PrimitiveRecord;
pub use save::{Committed, KeyframeImage, SessionStatus};
pub use segments::Segments;
pub use session::{
    Calibration, MaskShare, NewSession, SessionChanges, SessionCounts, SessionOptions, SessionRecord,
};
pub use snapshot::MapSnapshot;
pub use tokens::{NewToken, TOKEN_HASH_BYTES, TokenQuotas, TokenRecord, TokenRole};
pub use trajectory::{StoredFrame, SubmapChoice, TrajectoryFilter, TrajectoryKind, TrajectoryPose};
