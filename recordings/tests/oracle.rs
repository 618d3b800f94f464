//! The figures of `evaluate` against those of `evo`, an independent implementation, on its own test data.
//!
//! Expected values were printed by `evo_ape tum TRUTH ESTIMATE -as` and `evo_rpe tum TRUTH ESTIMATE -as`
//! (1.38.1).

use std::path::Path;

use recordings::{Evaluation, EvaluationOptions, Trajectory, evaluate};

const EVO_DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/evo");

const FR2_TRUTH: &str = "fr2_desk_groundtruth.txt";
const FR2_ESTIMATE: &str = "fr2_desk_ORB_kf_mono.txt";

/// Compares two of evo's files, the estimate cut down to the times to `keep`.
fn evaluated(truth: &str, estimate: &str, keep: impl Fn(i64) -> bool) -> Evaluation {
    let [truth, estimate] =
        [truth, estimate].map(|name| Trajectory::read(&Path::new(EVO_DATA).join(name)).unwrap());
    let kept = estimate.poses().iter().filter(|pose| keep(pose.timestamp_ns)).copied().collect();
    let estimate = Trajectory::new(kept);
    evaluate(&truth, &estimate, &EvaluationOptions::default()).unwrap()
}

#[track_caller]
fn assert_near(value: f64, expected: f64, tolerance: f64) {
    assert!((value - expected).abs() <= tolerance, "{value} is not {expected} ± {tolerance}");
}

#[test]
fn freiburg1_xyz_agrees_with_evo() {
    let evaluation = evaluated("freiburg1_xyz-groundtruth.txt", "freiburg1_xyz-ORB_kf_mono.txt", |_| true);
    assert_near(evaluation.ate_rmse, 0.009755, 1e-6);
    assert_near(evaluation.ate_mean, 0.008219, 1e-6);
    assert_near(evaluation.ate_median, 0.007909, 1e-6);
    assert_near(evaluation.ate_max, 0.027924, 1e-6);
    assert_near(evaluation.rpe_trans_rmse, 0.013835, 1e-6);
    assert_near(evaluation.rpe_rot_rmse_deg, 0.884849, 1e-6);
    assert_eq!((evaluation.poses, evaluation.matched), (32, 32));
}

/// One estimate, at this time, lies exactly halfway between two true poses. We compare integers and take the
/// earlier; evo compares doubles, whose rounding makes the later one nearer.
const TIED_NS: i64 = 1_311_868_226_310_950_000;

#[test]
fn freiburg2_desk_agrees_with_evo() {
    let evaluation = evaluated(FR2_TRUTH, FR2_ESTIMATE, |_| true);
    assert_near(evaluation.ate_rmse, 0.007729, 1e-6);
    assert_eq!((evaluation.poses, evaluation.matched), (157, 118));
}

/// Without the tied estimate, for evo as for us, every figure is the same.
#[test]
fn freiburg2_desk_agrees_with_evo_in_every_figure_without_the_tie() {
    let keep = |timestamp_ns| timestamp_ns != TIED_NS;
    let evaluation = evaluated(FR2_TRUTH, FR2_ESTIMATE, keep);
    assert_eq!((evaluation.poses, evaluation.matched), (156, 117));
    assert_near(evaluation.ate_rmse, 0.007752, 1e-6);
    assert_near(evaluation.ate_median, 0.007107, 1e-6);
    assert_near(evaluation.ate_max, 0.015646, 1e-6);
    assert_near(evaluation.rpe_trans_rmse, 0.007119, 1e-6);
    assert_near(evaluation.rpe_rot_rmse_deg, 0.388186, 1e-6);
}
