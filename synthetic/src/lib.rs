//! Seeded worlds with exact ground truth, smooth camera paths through them, and a renderer of image
//! sequences.
//!
//! Three types matter most: a [`World`] of textured convex faces with its true line segments and vanishing
//! directions, a [`Path`] that gives `camera_from_world` at any time, and a [`Sequence`] that renders one
//! seen along the other. [`PointCloudWorld`] is a world without images, for tests of the back end.
//!
//! World axes: `x` and `y` horizontal, `z` up. Lengths are map units, chosen so that a room has about the
//! size it would have in metres. Everything is a function of its seed: the same configuration gives the same
//! bytes.
//!
//! ```
//! use synthetic::{Preset, Sequence};
//!
//! let sequence = Sequence::preset(Preset::RoomRich, 1);
//! let frame = sequence.frame(0);
//! assert_eq!(frame.image.pixels().len(), 640 * 480);
//! assert_eq!(sequence.ground_truth().len(), sequence.len());
//! ```

mod dataset;
mod image;
mod path;
mod point_cloud;
mod random;
mod render;
mod segments;
mod sequence;
mod spline;
mod texture;
mod world;

pub use image::GrayImage;
pub use path::{Jitter, MotionLimits, Path, PathConfig, PathKind};
pub use point_cloud::{Observation, PointCloudConfig, PointCloudWorld};
pub use render::{ExposureCurve, RenderOptions, Renderer};
pub use segments::VisibleSegment;
pub use sequence::{Preset, Sequence, SequenceConfig, SyntheticFrame, UnknownPreset};
pub use texture::Material;
pub use world::{
    AtlantaConfig, CorridorConfig, CorridorShape, FourRoomsConfig, Light, RayHit, RoomConfig, Surface,
    Texture, TrueSegment, UnstructuredConfig, World, WorldConfig,
};
