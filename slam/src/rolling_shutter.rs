//! Rolling shutter: what an image shows whose rows were read one after the other, as a camera would see it
//! that takes the whole image when the middle row is read. [method: Rolling shutter]
//!
//! Behind this all works with one pose per image. A keypoint in a row that is read a share `s` of the readout
//! after the middle row is seen from `exp(s ξ) T`, `T` the pose of the middle row and `ξ` the camera's motion
//! in its own frame while the image is read. With the keypoint's depth the place where `T` sees the same
//! point follows.

mod motion_log;

pub(crate) use motion_log::{MotionLog, Motions};

use crate::features::FrameFeatures;
use geometry::nalgebra::{Vector2, Vector6};
use geometry::{Camera, Pinhole, Pose};
use vision::GridBounds;

/// The camera's motion in its own frame: turn, then shift, per nanosecond.
pub(crate) type Velocity = Vector6<f64>;

/// Motions between two frames that are believed to be as smooth as this needs: half a second.
const MAX_INTERVAL_NS: i64 = 500_000_000;

/// A camera that reads its rows one after the other.
#[derive(Clone, Debug)]
pub(crate) struct RollingShutter {
    /// Of the images that features are looked for in, as it was given.
    camera: Camera,
    /// Nanoseconds.
    readout_ns: i64,
}

impl RollingShutter {
    /// With a readout that may be 0. `camera` is that of the images that features are looked for in.
    pub fn new(camera: &Camera, readout_ns: i64) -> Self {
        Self { camera: camera.clone(), readout_ns }
    }

    /// `None` for a global shutter.
    pub fn of(camera: &Camera, readout_ns: i64) -> Option<Self> {
        (readout_ns != 0).then(|| Self::new(camera, readout_ns))
    }

    /// From the first row to the last, nanoseconds.
    pub fn readout_ns(&self) -> i64 {
        self.readout_ns
    }

    /// Takes over another readout.
    pub fn set_readout_ns(&mut self, readout_ns: i64) {
        self.readout_ns = readout_ns;
    }

    /// How the camera moves that turned and shifted so from one frame to another, at the middle between them.
    pub fn velocity(motion: &Pose, interval_ns: i64) -> Option<Velocity> {
        let is_known = interval_ns != 0 && interval_ns.abs() <= MAX_INTERVAL_NS;
        is_known.then(|| motion.log() / interval_ns as f64)
    }

    /// The features as the camera of the middle row sees them if it moves so. It does not matter what was
    /// taken out of them before. `inverse_depth` is that of keypoint `i`, or of what lies at a place.
    pub fn unroll(
        &self,
        rolled: &FrameFeatures,
        velocity: &Velocity,
        inverse_depth: impl Fn(Option<usize>, &Vector2<f64>) -> f64,
    ) -> FrameFeatures {
        let motion = velocity * self.readout_ns as f64;
        let (pinhole, twist) = (rolled.pinhole, motion - rolled.unrolled);
        let place_of = |place: &Vector2<f64>, row: f64, inverse_depth: f64| {
            unrolled(&pinhole, &(twist * self.share(row)), place, inverse_depth).unwrap_or(*place)
        };
        let mut moved = rolled.moved(
            |i, place| place_of(place, f64::from(rolled.keypoints[i].y), inverse_depth(Some(i), place)),
            |place, nominal| {
                let row = self.camera.distort(nominal).map_or(nominal.y, |pixel| pixel.y);
                place_of(place, row, inverse_depth(None, place))
            },
        );
        moved.unrolled = motion;
        moved
    }

    /// When a row is read, as a share of the readout after the middle row.
    pub fn share(&self, row: f64) -> f64 {
        ((row + 0.5) / f64::from(self.camera.height()) - 0.5).clamp(-0.5, 0.5)
    }

    /// The features with keypoints detected where they are now: what is stored of a keyframe.
    pub fn settle(&self, unrolled: &FrameFeatures) -> Option<FrameFeatures> {
        unrolled.settled(&self.camera)
    }
}

/// Where the camera before a motion sees what it sees at `place` after it.
fn unrolled(
    pinhole: &Pinhole,
    motion: &Vector6<f64>,
    place: &Vector2<f64>,
    inverse_depth: f64,
) -> Option<Vector2<f64>> {
    let before_from_after = Pose::exp(&-motion);
    let ray = pinhole.normalized(place).push(1.0);
    let seen = before_from_after.rotation * ray + before_from_after.translation * inverse_depth;
    let is_credible = seen.z > 0.5 && seen.z < 2.0;
    is_credible.then(|| pinhole.project(&seen))
}

/// One over the depth of what an image shows, by place in the image.
pub(crate) struct InverseDepths {
    bounds: GridBounds,
    cells: [f64; N_COLUMNS * N_ROWS],
}

const N_COLUMNS: usize = 12;
const N_ROWS: usize = 9;

impl InverseDepths {
    /// From those at some places; elsewhere those of the nearest prevail. `None` if there are none.
    pub fn new(bounds: GridBounds, places: impl Iterator<Item = (Vector2<f64>, f64)>) -> Option<Self> {
        let (mut sums, mut counts) = ([0.0; N_COLUMNS * N_ROWS], [0.0; N_COLUMNS * N_ROWS]);
        for (place, inverse_depth) in places {
            let cell = cell(&bounds, &place);
            sums[cell] += inverse_depth;
            counts[cell] += 1.0;
        }
        if counts.iter().all(|count| *count == 0.0) {
            return None;
        }
        let seen: Vec<(usize, f64, f64)> = (0..sums.len())
            .filter(|cell| counts[*cell] > 0.0)
            .map(|cell| (cell, sums[cell], counts[cell]))
            .collect();
        let mut cells = [0.0; N_COLUMNS * N_ROWS];
        for (cell, value) in cells.iter_mut().enumerate() {
            let (mut sum, mut weight) = (0.0, 0.0);
            for (other, sum_there, count) in &seen {
                let across = (cell % N_COLUMNS).abs_diff(other % N_COLUMNS) as f64;
                let down = (cell / N_COLUMNS).abs_diff(other / N_COLUMNS) as f64;
                let nearness = 1.0 / (0.1 + across * across + down * down).powi(2);
                sum += nearness * sum_there;
                weight += nearness * count;
            }
            *value = sum / weight;
        }
        Some(Self { bounds, cells })
    }

    pub fn at(&self, place: &Vector2<f64>) -> f64 {
        self.cells[cell(&self.bounds, place)]
    }
}

fn cell(bounds: &GridBounds, place: &Vector2<f64>) -> usize {
    let at = |value: f64, low: f32, high: f32, n: usize| {
        let share = (value - f64::from(low)) / f64::from(high - low);
        ((share * n as f64) as usize).min(n - 1)
    };
    let column = at(place.x, bounds.min_x, bounds.max_x, N_COLUMNS);
    at(place.y, bounds.min_y, bounds.max_y, N_ROWS) * N_COLUMNS + column
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::Vector3;

    #[test]
    fn what_is_seen_in_a_row_lies_where_the_camera_of_the_middle_row_sees_it() {
        let pinhole = Pinhole { fx: 460.0, fy: 458.0, cx: 321.0, cy: 238.0 };
        // A degree and two hundredths of a unit over the readout.
        let twist = Vector6::new(0.01, -0.014, 0.006, 0.02, 0.01, -0.008);
        for (x, y, depth, share) in [(-0.8, -0.6, 1.5, -0.5), (0.3, 0.1, 3.0, 0.1), (0.7, 0.5, 2.0, 0.4)] {
            let seen_at_middle = Vector3::new(x, y, 1.0) * depth;
            let seen_at_row = Pose::exp(&(twist * share)).transform(&seen_at_middle);
            let rolled = pinhole.project(&seen_at_row);
            let place = unrolled(&pinhole, &(twist * share), &rolled, 1.0 / seen_at_row.z).unwrap();
            assert!((place - pinhole.project(&seen_at_middle)).norm() < 1e-9, "{place}");
            assert!((rolled - place).norm() > 0.3, "the row matters");
        }
        let away = Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 5.0);
        assert!(unrolled(&pinhole, &away, &Vector2::new(10.0, 10.0), 1.0).is_none());
    }

    #[test]
    fn between_depths_the_nearest_prevail() {
        let bounds = GridBounds::of_image(640, 480);
        let left = (Vector2::new(30.0, 240.0), 1.0);
        let right = (Vector2::new(610.0, 240.0), 0.2);
        let depths = InverseDepths::new(bounds, [left, right].into_iter()).unwrap();
        assert!((depths.at(&Vector2::new(35.0, 200.0)) - 1.0).abs() < 0.1);
        assert!((depths.at(&Vector2::new(600.0, 300.0)) - 0.2).abs() < 0.1);
        assert!(depths.at(&Vector2::new(-1e9, f64::NAN)).is_finite());
        assert!(InverseDepths::new(bounds, std::iter::empty()).is_none());
    }
}
