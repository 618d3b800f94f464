//! What the front end measures in one image, in the coordinates the back end works in.

use geometry::nalgebra::Vector2;
use geometry::{Camera, Pinhole};
use vision::{Descriptor, Features, Keypoint, KeypointGrid};

/// The points of one frame. Immutable once made and shared between the frame, its key frame and the store.
#[derive(Clone, Debug)]
pub struct FrameFeatures {
    /// Keypoints as detected, in pixels of the working image.
    pub keypoints: Vec<Keypoint>,
    /// The same keypoints without lens distortion, in pixels of the ideal pinhole camera.
    pub undistorted: Vec<Vector2<f64>>,
    /// One binary descriptor per keypoint.
    pub descriptors: Vec<Descriptor>,
    /// Index of the undistorted positions for window queries.
    pub(crate) grid: KeypointGrid,
    /// The ideal camera the undistorted coordinates belong to.
    pub pinhole: Pinhole,
}
