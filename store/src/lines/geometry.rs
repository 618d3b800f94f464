//! Where segments are, exactly: the R*Tree knows their boxes alone.

use crate::Bounds;
use nalgebra::Vector3;

/// Whether some point of the segment is in the box, faces included. Never with a number that is not a number.
pub(super) fn meets_box([start, end]: &[Vector3<f64>; 2], bounds: &Bounds) -> bool {
    // The part of the segment, as shares of the way from start to end, that is between each pair of faces.
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for axis in 0..3 {
        let (from, step) = (start[axis], end[axis] - start[axis]);
        let (low, high) = (bounds.min[axis], bounds.max[axis]);
        if low.is_nan() || high.is_nan() || low > high {
            return false;
        }
        if step == 0.0 {
            if from < low || from > high {
                return false;
            }
            continue;
        }
        let (a, b) = ((low - from) / step, (high - from) / step);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    enter <= leave
}

/// Whether some point of the segment is at most `radius` from `center`.
pub(super) fn meets_ball([start, end]: &[Vector3<f64>; 2], center: &Vector3<f64>, radius: f64) -> bool {
    let along = end - start;
    let length_squared = along.norm_squared();
    let share = if length_squared > 0.0 { (center - start).dot(&along) / length_squared } else { 0.0 };
    let nearest = start + along * share.clamp(0.0, 1.0);
    radius >= 0.0 && (nearest - center).norm_squared() <= radius * radius
}

#[cfg(test)]
mod tests {
    use super::*;

    const ENDS: [Vector3<f64>; 2] = [Vector3::new(0.0, 0.0, 0.0), Vector3::new(4.0, 4.0, 0.0)];

    fn bounds(min: [f64; 3], max: [f64; 3]) -> Bounds {
        Bounds { min: min.into(), max: max.into() }
    }

    #[test]
    fn a_slanting_segment_meets_the_boxes_on_its_way_and_not_those_beside_it() {
        assert!(meets_box(&ENDS, &bounds([1.0, 1.0, -1.0], [2.0, 2.0, 1.0])), "on the way");
        assert!(!meets_box(&ENDS, &bounds([2.5, 0.0, -1.0], [4.0, 1.0, 1.0])), "in its box but beside it");
        assert!(meets_box(&ENDS, &bounds([-1.0, -1.0, -1.0], [5.0, 5.0, 1.0])), "around it");
        assert!(meets_box(&ENDS, &bounds([4.0, 4.0, 0.0], [5.0, 5.0, 0.0])), "touching an end");
        assert!(!meets_box(&ENDS, &bounds([4.1, 4.1, 0.0], [5.0, 5.0, 0.0])), "beyond an end");
        assert!(!meets_box(&ENDS, &bounds([1.0, 1.0, 0.5], [2.0, 2.0, 1.0])), "above it");
        assert!(!meets_box(&ENDS, &bounds([2.0, 2.0, 0.0], [1.0, 1.0, 0.0])), "an empty box");
        assert!(!meets_box(&ENDS, &bounds([f64::NAN; 3], [5.0; 3])));
        let infinite = bounds([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
        assert!(meets_box(&ENDS, &infinite));
    }

    #[test]
    fn a_ball_is_met_beside_the_middle_and_beyond_an_end() {
        let beside = Vector3::new(3.0, 1.0, 0.0);
        assert!(meets_ball(&ENDS, &beside, 2f64.sqrt() + 1e-9));
        assert!(!meets_ball(&ENDS, &beside, 1.4));
        let beyond = Vector3::new(4.0, 7.0, 0.0);
        assert!(meets_ball(&ENDS, &beyond, 3.0) && !meets_ball(&ENDS, &beyond, 2.9));
        assert!(!meets_ball(&ENDS, &ENDS[0], -1.0) && meets_ball(&ENDS, &ENDS[0], 0.0));
        assert!(!meets_ball(&ENDS, &Vector3::repeat(f64::NAN), 1.0));
    }
}
