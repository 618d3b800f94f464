//! Where things are on the page: seen from above, along the mean of the cameras' downward axes.

use geometry::Pose;
use geometry::nalgebra::{Matrix2, Vector2, Vector3};

/// Share of points and line ends that may lie outside at each side: a few landmarks are always far off.
const OUTLIER_SHARE: f64 = 0.01;
/// Free border around what is drawn, share of its longer side.
const BORDER: f64 = 0.04;
/// Least height of the picture, share of its width.
const MIN_ASPECT: f64 = 0.3;
/// Greatest height, likewise.
const MAX_ASPECT: f64 = 0.8;

/// The horizontal plane, turned so that most goes across from left to right.
pub struct TopView {
    right_in_world: Vector3<f64>,
    up_the_page_in_world: Vector3<f64>,
}

impl TopView {
    /// Of the world of these `world_from_camera`, turned along its lines if there are any, else along the
    /// path; `None` without a pose. Cameras that look all ways on the average are taken to be level as the
    /// first one is.
    pub fn of(poses: &[Pose], lines: &[[Vector3<f64>; 2]]) -> Option<Self> {
        let down = |pose: &Pose| pose.rotation * Vector3::y();
        let sum: Vector3<f64> = poses.iter().map(down).sum();
        let up = -sum.try_normalize(0.1 * poses.len() as f64).or_else(|| Some(down(poses.first()?)))?;
        // Any two axes of the plane, seen from its upper side: `east` turned to the left is `north`.
        let seed = if up.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let east = (seed - up * up.dot(&seed)).normalize();
        let north = up.cross(&east);
        let flat = |vector: &Vector3<f64>| Vector2::new(east.dot(vector), north.dot(vector));
        let mean =
            poses.iter().map(|pose| flat(&pose.translation)).sum::<Vector2<f64>>() / poses.len() as f64;
        let along_lines = spread(lines.iter().map(|[start, end]| flat(&(end - start))));
        let along_path = spread(poses.iter().map(|pose| flat(&pose.translation) - mean));
        let spread = if along_lines.norm() > 0.0 { along_lines } else { along_path };
        // The angle of the longer axis of the spread.
        let angle = 0.5 * (2.0 * spread.m12).atan2(spread.m11 - spread.m22);
        let right_in_world = east * angle.cos() + north * angle.sin();
        Some(Self { right_in_world, up_the_page_in_world: up.cross(&right_in_world) })
    }

    /// The same world seen from the side: what went up the page points away from who looks at it.
    pub fn seen_from_the_side(self) -> Self {
        let up = self.right_in_world.cross(&self.up_the_page_in_world);
        Self { up_the_page_in_world: up, ..self }
    }

    /// To the right and down the page, units of the world.
    pub fn seen(&self, point_in_world: &Vector3<f64>) -> [f64; 2] {
        [self.right_in_world.dot(point_in_world), -self.up_the_page_in_world.dot(point_in_world)]
    }
}

/// Second moments of vectors that are finite.
fn spread(vectors: impl Iterator<Item = Vector2<f64>>) -> Matrix2<f64> {
    let finite = vectors.filter(|vector| vector.iter().all(|value| value.is_finite()));
    finite.map(|vector| vector * vector.transpose()).sum()
}

/// The part of the plane that is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Left and upper border.
    pub min: [f64; 2],
    /// Width and height, both positive.
    pub size: [f64; 2],
}

impl Frame {
    /// Around whole paths, and around landmarks but for a few.
    pub fn around<'a>(
        paths: [&Vec<[f64; 2]>; 2],
        landmarks: impl Iterator<Item = &'a [f64; 2]> + Clone,
    ) -> Self {
        let sides = [0, 1].map(|axis| {
            let of_paths = paths.into_iter().flatten().map(|place| place[axis]);
            let (mut least, mut greatest) = extent(of_paths, 0.0).unwrap_or((0.0, 0.0));
            if let Some((low, high)) = extent(landmarks.clone().map(|place| place[axis]), OUTLIER_SHARE) {
                (least, greatest) = (least.min(low), greatest.max(high));
            }
            (least, greatest)
        });
        let lengths = sides.map(|(least, greatest)| greatest - least);
        let longer = lengths[0].max(lengths[1]);
        // A camera that stood still is drawn in a square of one unit.
        let border = if longer > 0.0 { BORDER * longer } else { 0.5 };
        let [mut width, mut height] = lengths.map(|length| length + 2.0 * border);
        height = height.max(MIN_ASPECT * width);
        width = width.max(height / MAX_ASPECT);
        let size = [width, height];
        let min = [0, 1].map(|axis| 0.5 * (sides[axis].0 + sides[axis].1) - 0.5 * size[axis]);
        Self { min, size }
    }
}

/// Least and greatest but for a share at each end; `None` without finite values.
fn extent(values: impl Iterator<Item = f64>, share: f64) -> Option<(f64, f64)> {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let n_out = (share * values.len() as f64).floor() as usize;
    Some((*values.get(n_out)?, *values.get(values.len() - 1 - n_out)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::UnitQuaternion;

    /// A camera at a place that looks some way, level in a world whose z axis points up.
    fn level(x: f64, y: f64, heading: f64) -> Pose {
        let level_from_camera =
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -0.5 * std::f64::consts::PI);
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
        Pose::new(turned * level_from_camera, Vector3::new(x, y, 1.5))
    }

    #[test]
    fn the_longer_way_goes_across_and_nothing_is_mirrored() {
        let poses: Vec<Pose> =
            (0..20).map(|i| level(0.1 * f64::from(i % 3), f64::from(i), 0.3 * f64::from(i))).collect();
        let view = TopView::of(&poses, &[]).unwrap();
        let [origin, far, left] = [[0.0, 0.0, 0.0], [0.0, 19.0, 0.0], [-1.0, 0.0, 7.0]]
            .map(|place| view.seen(&Vector3::from(place)));
        assert!((far[0] - origin[0]).abs() > 18.9, "{far:?}");
        // Whoever looks along +y from above has -x to the left; on the page that is a turn against the clock.
        let (forward, sideways) =
            ([far[0] - origin[0], far[1] - origin[1]], [left[0] - origin[0], left[1] - origin[1]]);
        assert!(forward[0] * sideways[1] - forward[1] * sideways[0] < 0.0);
        assert!((sideways[0].hypot(sideways[1]) - 1.0).abs() < 1e-9, "height counts: {sideways:?}");
        // From the side what is higher in the world is higher on the page.
        let side = TopView::of(&poses, &[]).unwrap().seen_from_the_side();
        let [low, high] = [[0.0, 0.0, 0.0], [0.0, 0.0, 3.0]].map(|place| side.seen(&Vector3::from(place)));
        assert!((low[1] - high[1] - 3.0).abs() < 1e-9 && (low[0] - high[0]).abs() < 1e-9, "{low:?} {high:?}");
        assert!(TopView::of(&[], &[]).is_none());
    }

    #[test]
    fn lines_go_across() {
        let poses = [level(0.0, 0.0, 0.0), level(5.0, 0.0, 0.0)];
        let lines = [
            [Vector3::zeros(), Vector3::new(0.0, 7.0, 0.0)],
            [Vector3::zeros(), Vector3::new(1.0, 0.0, 9.0)],
        ];
        let view = TopView::of(&poses, &lines).unwrap();
        assert!((view.seen(&lines[0][1])[0].abs() - 7.0).abs() < 1e-9);
    }

    #[test]
    fn a_few_far_landmarks_do_not_shrink_the_rest() {
        let path = vec![[0.0, 0.0], [10.0, 5.0]];
        let landmarks: Vec<[f64; 2]> = (0..400)
            .map(|i| if i < 3 { [1e6, f64::NAN] } else { [f64::from(i) * 0.05 - 5.0, 2.0] })
            .collect();
        let frame = Frame::around([&path, &Vec::new()], landmarks.iter());
        assert!(frame.min[0] < -4.5 && frame.min[0] + frame.size[0] < 20.0, "{frame:?}");
        assert!(frame.size[1] >= MIN_ASPECT * frame.size[0]);
        let still = vec![[3.0, 3.0]];
        assert_eq!(Frame::around([&still, &Vec::new()], [].iter()).size[1], 1.0);
    }
}
