//! What tests share: maps made by hand, rendered sequences through the engine, and errors against the truth.
//!
//! * [`world`]: seeded maps made by hand, and updates between them; with the feature `store`, databases of
//!   them.
//! * [`postgres`]: with the feature of that name, databases of PostgreSQL; [`stored::Home`] is one of either
//!   kind.
//! * [`Session`]: frames through the engine, every map on the way checked, the trajectory kept as a store
//!   would.
//! * [`evaluate`]: the error of poses against true ones after alignment, by frame number.
//! * [`gray_image`]: rendered images as the engine takes them; [`line_error`]: lines against true edges.
//!
//! Only a dev-dependency of other crates, and not of unit tests of `slam`, `geometry` and `vision`: those
//! would see two versions of their types. Its programs, `track_synthetic` and `track_folder`, are the
//! engine's laboratory.
//!
//! ```
//! use synthetic::{Preset, Sequence};
//! use testkit::{Session, evaluate, gray_image, inline};
//!
//! let sequence = Sequence::preset(Preset::RoomRich, 1);
//! let mut session = Session::new(inline(1), sequence.camera());
//! let report = session.show(0, 0, gray_image(sequence.frame(0).image));
//! assert_eq!(report.sequence, 0);
//!
//! let truth = |number: u64| sequence.camera_from_world(number as usize).inverse();
//! let same = (0..9).map(|number| (number, truth(number))).collect();
//! assert!(evaluate(&same, truth).unwrap().ate_rmse < 1e-9);
//! ```

mod alignment;
mod edges;
pub mod laboratory;
#[cfg(all(feature = "postgres", unix))]
pub mod postgres;
mod session;
#[cfg(feature = "store")]
pub mod stored;
pub mod world;

pub use alignment::{evaluate, largest_submap, truth_from_map};
pub use edges::{LineError, line_error};
pub use session::{FRAME_INTERVAL_NS, Session, gray_image, inline};
