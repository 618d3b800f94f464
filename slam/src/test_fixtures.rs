//! What unit tests of several modules are made of. (The crate `testkit` cannot serve them: it would bring a
//! second version of this crate's types.)

use geometry::{Camera, CameraModel, CameraParameters};

use crate::features::PyramidGeometry;

/// A pinhole camera of 640 x 480 with a focal length of 500 pixels.
pub fn camera() -> Camera {
    Camera::new(CameraParameters {
        model: CameraModel::Pinhole,
        width: 640,
        height: 480,
        fx: 500.0,
        fy: 500.0,
        cx: 320.0,
        cy: 240.0,
        distortion: Vec::new(),
    })
    .unwrap()
}

/// The pyramid of the default configuration.
pub fn pyramid() -> PyramidGeometry {
    PyramidGeometry { n_levels: 8, scale_factor: 1.2 }
}
