//! The figures of `evaluate` against those of `evo`, an independent implementation, on its own test data.
//!
//! Expected values were printed by `evo_ape tum TRUTH ESTIMATE -as` and `evo_rpe tum TRUTH ESTIMATE -as` (1.38.1).

use std::path::Path;

use client::Trajectory;
use client::evaluation::{Evaluation, EvaluationOptions, evaluate};

const EVO_DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data/components/evo");

fn evaluated(truth: &str, estimate: &str) -> Option<Evaluation> {
    let [truth, estimate] = [truth, estimate].map(|name| Path::new(EVO_DATA).join(name));
    if !truth.is_file() || !estimate.is_file() {
        eprintln!("skipped: {} is not there", truth.display());
        return None;
    }
    let [truth, estimate] = [truth, estimate].map(|path| Trajectory::read(&path).unwrap());
    Some(evaluate(&truth, &estimate, &EvaluationOptions::default()).unwrap())
}

#[track_caller]
fn assert_near(value: f64, expected: f64, tolerance: f64) {
    assert!((value - expected).abs() <= tolerance, "{value} is not {expected} ± {tolerance}");
}

#[test]
fn freiburg1_xyz_agrees_with_evo() {
    let Some(evaluation) = evaluated("freiburg1_xyz-groundtruth.txt", "freiburg1_xyz-ORB_kf_mono.txt") else {
        return;
    };
    assert_near(evaluation.ate_rmse, 0.009755, 1e-6);
    assert_near(evaluation.ate_mean, 0.008219, 1e-6);
    assert_near(evaluation.ate_median, 0.007909, 1e-6);
    assert_near(evaluation.ate_max, 0.027924, 1e-6);
    assert_near(evaluation.rpe_trans_rmse, 0.013835, 1e-6);
    assert_near(evaluation.rpe_rot_rmse_deg, 0.884849, 1e-5);
    assert_eq!((evaluation.poses, evaluation.matched), (32, 32));
}

#[test]
fn freiburg2_desk_agrees_with_evo() {
    let Some(evaluation) = evaluated("fr2_desk_groundtruth.txt", "fr2_desk_ORB_kf_mono.txt") else { return };
    assert_near(evaluation.ate_rmse, 0.007729, 1e-6);
    // One estimate lies exactly between two true poses, and evo takes the other one.
    assert_near(evaluation.ate_max, 0.015689, 1e-5);
    assert_near(evaluation.rpe_trans_rmse, 0.007069, 1e-6);
    assert_near(evaluation.rpe_rot_rmse_deg, 0.387091, 1e-5);
    assert_eq!((evaluation.poses, evaluation.matched), (157, 118));
}
