//! Scale from positions of the camera by another measurement, such as GPS or motion capture: the similarity
//! that brings the trajectory closest to them [Umeyama 1991], without the rows that disagree with the others.

use super::{Measurement, Residual, undetermined};
use crate::error::ApiError;
use crate::session::SessionId;
use futures_util::TryStreamExt;
use geometry::nalgebra::Vector3;
use geometry::{Pose, Similarity};
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand::seq::index::sample;
use store::{Store, SubmapChoice, TrajectoryFilter, TrajectoryKind};

/// Rows taken at most.
pub const MAX_ROWS: usize = 100_000;
/// Between poses farther apart than this in time nobody knows where the camera was, nanoseconds.
const MAX_GAP_NS: i64 = 500_000_000;
/// Triples of rows that are tried: with half of the rows wrong, one is right of 1 - 1e-11 of the searches.
const N_TRIPLES: usize = 200;
/// Rows whose error is this many times the typical one are left out.
const MAX_SIGMAS: f64 = 2.5;
/// Rounds of fitting and leaving out.
const N_ROUNDS: usize = 5;
/// Standard deviation of normally distributed numbers, over the median of their magnitudes.
const SIGMA_PER_MEDIAN: f64 = 1.4826;

/// Where the camera was.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReferencePositions {
    /// The rows.
    pub rows: Vec<ReferenceRow>,
    /// Rows this far off or farther are left out, metres; `None` leaves out what the others contradict.
    pub max_error_m: Option<f64>,
}

/// One position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceRow {
    /// When.
    pub when: When,
    /// Where, metres.
    pub position: [f64; 3],
}

/// When a position was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum When {
    /// With the frame of this number.
    Sequence(u64),
    /// At this time of the frames' clock, nanoseconds.
    Timestamp(i64),
}

/// One pose of the trajectory.
struct Known {
    sequence: u64,
    timestamp_ns: i64,
    center: Vector3<f64>,
}

pub(super) async fn measure(
    store: &Store,
    id: &SessionId,
    positions: &ReferencePositions,
) -> Result<Measurement, ApiError> {
    check(positions)?;
    let filter = TrajectoryFilter { submaps: SubmapChoice::Largest, ..TrajectoryFilter::default() };
    let mut poses = store.trajectory(id.as_str(), TrajectoryKind::Frames, filter).await?;
    let (mut trajectory, mut submap) = (Vec::new(), 0);
    while let Some(pose) = poses.try_next().await? {
        submap = pose.submap.0;
        let center = pose.world_from_camera.translation;
        trajectory.push(Known { sequence: pose.sequence, timestamp_ns: pose.timestamp_ns, center });
    }
    let rows = positions.clone();
    let fit = tokio::task::spawn_blocking(move || fit(&trajectory, &rows));
    let measured = fit.await.map_err(ApiError::internal)??;
    Ok(Measurement { submap, ..measured })
}

fn check(positions: &ReferencePositions) -> Result<(), ApiError> {
    let n = positions.rows.len();
    if n > MAX_ROWS {
        let sentence = format!("are {n}, and at most {MAX_ROWS} are taken");
        return Err(ApiError::invalid("positions.rows", sentence));
    }
    let is_finite = |row: &ReferenceRow| row.position.iter().all(|value| value.is_finite());
    if let Some(wrong) = positions.rows.iter().position(|row| !is_finite(row)) {
        let field = format!("positions.rows[{wrong}].position");
        return Err(ApiError::invalid(field, "must be three finite numbers"));
    }
    if positions.max_error_m.is_some_and(|most| !(most.is_finite() && most > 0.0)) {
        return Err(ApiError::invalid("positions.max_error_m", "must be a number above 0"));
    }
    Ok(())
}

fn fit(trajectory: &[Known], positions: &ReferencePositions) -> Result<Measurement, ApiError> {
    let centers: Vec<Option<Vector3<f64>>> =
        positions.rows.iter().map(|row| center_at(trajectory, row.when)).collect();
    let pairs: Vec<Pair> = positions
        .rows
        .iter()
        .zip(&centers)
        .enumerate()
        .filter_map(|(idx, (row, center))| Some((idx, (*center)?, Vector3::from(row.position))))
        .collect();
    if pairs.len() < 3 {
        return Err(undetermined(format!(
            "{} of {} rows are of frames with a pose in the largest submap, and three are needed; rows name frames by \
             their sequence, or by a time of the frames' own clock",
            pairs.len(),
            positions.rows.len()
        )));
    }
    let found = robust(&pairs, positions.max_error_m).ok_or_else(|| {
        undetermined(
            "the positions lie on one line or in one place, or agree with the trajectory nowhere; take more, in a wider \
             loop",
        )
    })?;
    let mut residuals: Vec<Residual> = centers
        .iter()
        .map(|_| Residual {
            reason: "its frame has no pose in the largest submap".into(),
            ..Residual::default()
        })
        .collect();
    for ((idx, ..), (error, used)) in pairs.iter().zip(found.errors.iter().zip(&found.used)) {
        let reason = if *used { String::new() } else { "it disagrees with the others".to_owned() };
        residuals[*idx] = Residual { error_m: Some(*error), used: *used, reason };
    }
    let used = || found.errors.iter().zip(&found.used).filter(|(_, used)| **used).map(|(error, _)| error);
    let n_used = used().count();
    let rms = (used().map(|error| error * error).sum::<f64>() / n_used as f64).sqrt();
    let Similarity { rotation, translation, scale } = found.reference_from_map;
    Ok(Measurement {
        metres_per_unit: scale,
        map_distance: None,
        places: Vec::new(),
        residuals,
        rms_m: Some(rms),
        n_used: n_used as u32,
        reference_from_map: Some(Pose::new(rotation, translation)),
        submap: 0,
    })
}

/// Where the camera was: between the poses before and after, if these are near enough in time.
fn center_at(trajectory: &[Known], when: When) -> Option<Vector3<f64>> {
    match when {
        When::Sequence(sequence) => {
            let found = trajectory.binary_search_by_key(&sequence, |pose| pose.sequence).ok()?;
            Some(trajectory[found].center)
        }
        When::Timestamp(time) => {
            let after = trajectory.partition_point(|pose| pose.timestamp_ns < time);
            let next = trajectory.get(after)?;
            if next.timestamp_ns == time {
                return Some(next.center);
            }
            let before = trajectory.get(after.checked_sub(1)?)?;
            let gap_ns = next.timestamp_ns.checked_sub(before.timestamp_ns)?;
            let share = (time - before.timestamp_ns) as f64 / gap_ns as f64;
            (gap_ns <= MAX_GAP_NS).then(|| before.center + (next.center - before.center) * share)
        }
    }
}

/// A row, and where it is in the map and in the reference.
type Pair = (usize, Vector3<f64>, Vector3<f64>);

struct Fit {
    reference_from_map: Similarity,
    /// Of each pair, metres.
    errors: Vec<f64>,
    used: Vec<bool>,
}

/// The similarity that most pairs agree with.
fn robust(pairs: &[Pair], max_error_m: Option<f64>) -> Option<Fit> {
    let errors_of = |similarity: &Similarity| -> Vec<f64> {
        pairs.iter().map(|(_, map, reference)| (similarity.transform(map) - reference).norm()).collect()
    };
    let fit_to = |chosen: &[usize]| {
        let side =
            |of: fn(&Pair) -> Vector3<f64>| chosen.iter().map(|idx| of(&pairs[*idx])).collect::<Vec<_>>();
        let found = Similarity::from_correspondences(&side(|pair| pair.1), &side(|pair| pair.2), true)?;
        (found.is_finite() && found.scale > 0.0).then_some(found)
    };
    let all: Vec<usize> = (0..pairs.len()).collect();
    // The least median of the errors, which half of the rows cannot spoil.
    let mut rng = StdRng::seed_from_u64(0);
    let triples = (0..N_TRIPLES).map(|_| sample(&mut rng, pairs.len(), 3).into_vec());
    let fits = std::iter::once(all.clone()).chain(triples).filter_map(|chosen| fit_to(&chosen));
    let scored = fits.map(|found| (median(&errors_of(&found)), found));
    let (mut typical, mut best) = scored.min_by(|(a, _), (b, _)| a.total_cmp(b))?;
    let span = span_of(pairs);
    for _ in 0..N_ROUNDS {
        let errors = errors_of(&best);
        // Small samples make the median too small [Rousseeuw & Leroy 1987].
        let correction = 1.0 + 5.0 / (pairs.len() as f64 - 2.0);
        let sigma = (SIGMA_PER_MEDIAN * correction * typical).max(1e-9 * span);
        let most = max_error_m.unwrap_or(MAX_SIGMAS * sigma);
        let used: Vec<usize> = all.iter().copied().filter(|idx| errors[*idx] < most).collect();
        best = fit_to(&used)?;
        let errors = errors_of(&best);
        typical = median(&used.iter().map(|idx| errors[*idx]).collect::<Vec<_>>());
    }
    let errors = errors_of(&best);
    let correction = 1.0 + 5.0 / (pairs.len() as f64 - 2.0);
    let most =
        max_error_m.unwrap_or(2.0 * MAX_SIGMAS * (SIGMA_PER_MEDIAN * correction * typical).max(1e-9 * span));
    let used: Vec<bool> = errors.iter().map(|error| *error < most).collect();
    let chosen: Vec<usize> = all.into_iter().filter(|idx| used[*idx]).collect();
    let reference_from_map = fit_to(&chosen)?;
    Some(Fit { errors: errors_of(&reference_from_map), reference_from_map, used })
}

fn median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    if values.is_empty() {
        return f64::INFINITY;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// How far the references reach, metres.
fn span_of(pairs: &[Pair]) -> f64 {
    let first = pairs[0].2;
    pairs.iter().map(|(_, _, reference)| (reference - first).norm()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::ErrorCode;
    use geometry::nalgebra::UnitQuaternion;

    const FRAME_NS: i64 = 100_000_000;

    fn trajectory() -> Vec<Known> {
        let center = |i: u64| {
            let t = i as f64 * 0.1;
            Vector3::new(t.cos(), 0.2 * (3.0 * t).sin(), t.sin())
        };
        (0..60).map(|i| Known { sequence: i, timestamp_ns: i as i64 * FRAME_NS, center: center(i) }).collect()
    }

    fn truth() -> Similarity {
        let rotation = UnitQuaternion::from_euler_angles(0.3, 1.0, -0.4);
        Similarity::new(rotation, Vector3::new(10.0, -3.0, 2.0), 2.5)
    }

    fn rows(noise_m: f64) -> Vec<ReferenceRow> {
        let noisy = |(i, pose): (usize, Known)| {
            let shift = Vector3::new((i as f64 * 1.7).sin(), (i as f64 * 2.9).cos(), (i as f64 * 0.7).sin());
            let position = truth().transform(&pose.center) + shift * noise_m;
            ReferenceRow { when: When::Sequence(pose.sequence), position: position.into() }
        };
        trajectory().into_iter().enumerate().map(noisy).collect()
    }

    #[test]
    fn a_third_of_wrong_rows_are_named_and_change_nothing() {
        let mut rows = rows(0.01);
        for idx in (0..rows.len()).step_by(3) {
            rows[idx].position[0] += 1.0 + idx as f64 * 0.1;
        }
        let found = fit(&trajectory(), &ReferencePositions { rows, max_error_m: None }).unwrap();
        assert!((found.metres_per_unit / 2.5 - 1.0).abs() < 0.01, "{}", found.metres_per_unit);
        for (idx, residual) in found.residuals.iter().enumerate() {
            assert_eq!(residual.used, idx % 3 != 0, "row {idx}: {residual:?}");
        }
        assert_eq!(found.n_used, 40);
        assert!(found.rms_m.unwrap() < 0.03);
        let moved = found.reference_from_map.unwrap();
        let place = trajectory()[7].center;
        let error = moved.transform(&(place * found.metres_per_unit)) - truth().transform(&place);
        assert!(error.norm() < 0.03, "{error}");
    }

    #[test]
    fn positions_between_frames_are_interpolated_and_gaps_are_not() {
        let known = trajectory();
        let half = center_at(&known, When::Timestamp(FRAME_NS * 5 / 2)).unwrap();
        assert!((half - (known[2].center + known[3].center) / 2.0).norm() < 1e-12);
        assert!(center_at(&known, When::Timestamp(-1)).is_none());
        assert!(center_at(&known, When::Timestamp(60 * FRAME_NS)).is_none());
        let sparse: Vec<Known> = known.into_iter().step_by(10).collect();
        assert!(center_at(&sparse, When::Timestamp(FRAME_NS / 2)).is_none());
    }

    #[test]
    fn exact_rows_are_all_used_and_too_few_or_straight_ones_refused() {
        let exact = fit(&trajectory(), &ReferencePositions { rows: rows(0.0), max_error_m: None }).unwrap();
        assert_eq!(exact.n_used, 60);
        assert!((exact.metres_per_unit - 2.5).abs() < 1e-9);
        let few = ReferencePositions { rows: rows(0.0)[..2].to_vec(), max_error_m: None };
        assert_eq!(fit(&trajectory(), &few).unwrap_err().code, ErrorCode::ScaleUndetermined);
        let straight: Vec<Known> = (0..20)
            .map(|i| Known { sequence: i, timestamp_ns: i as i64, center: Vector3::new(i as f64, 0.0, 0.0) })
            .collect();
        let on_line = straight
            .iter()
            .map(|pose| ReferenceRow {
                when: When::Sequence(pose.sequence),
                position: (pose.center * 3.0).into(),
            })
            .collect();
        let on_line = ReferencePositions { rows: on_line, max_error_m: None };
        assert_eq!(fit(&straight, &on_line).unwrap_err().code, ErrorCode::ScaleUndetermined);
    }
}
