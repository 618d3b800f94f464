//! Two clients that stream overlapping halves of a real recording into one map at the same time, with a
//! restart in the middle.
//!
//! Needs the recording 7scenes_redkitchen in the folder that `MONOSLAM_DATA` names.

use crate::kidnap::{INTERVAL_NS, Recording, camera, is_placed};
use geometry::Pose;
use geometry::nalgebra::{UnitQuaternion, Vector3};
use proto::v1;
use recordings::{EvaluationOptions, StampedPose, Trajectory, evaluate};
use std::ops::Range;
use std::sync::Arc;
use tests::{FrameStream, TestServer, create_session, open_message};

/// What each of the two shows, in the recording's numbering: a fifth of it they both do.
const HALVES: [(&str, Range<usize>); 2] = [("first", 0..600), ("second", 400..1000)];
/// Root mean square error of both trajectories together, aligned to the truth by one similarity, metres.
const MAX_ERROR_M: f64 = 0.05;

/// Streams these frames of the recording, numbered from the first of the half on; how many were placed.
async fn stream(
    server: &TestServer,
    recording: &Recording,
    id: &str,
    frames: Range<usize>,
    begin: usize,
) -> usize {
    let mut client = server.client().await;
    let mut stream = FrameStream::open(&mut client, open_message(id)).await.unwrap();
    assert_eq!(stream.opened.next_sequence, (frames.start - begin) as u64, "it goes on where it was");
    let mut n_placed = 0;
    for index in frames {
        let frame = recording.frame((index - begin) as u64, index);
        n_placed += usize::from(is_placed(&stream.track(frame).await.unwrap()));
    }
    stream.finish().await.unwrap();
    n_placed
}

/// Streams the first or the second part of both halves at once; how many frames of each were placed.
async fn stream_both(server: &Arc<TestServer>, recording: &Arc<Recording>, is_second: bool) -> [usize; 2] {
    let streams = HALVES.map(|(id, half)| {
        let middle = half.start + half.len() / 2;
        let frames = if is_second { middle..half.end } else { half.start..middle };
        let (server, recording) = (server.clone(), recording.clone());
        tokio::spawn(async move { stream(&server, &recording, id, frames, half.start).await })
    });
    let [first, second] = streams;
    [first.await.unwrap(), second.await.unwrap()]
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs recordings: set MONOSLAM_DATA"]
async fn overlapping_halves_streamed_at_once_become_one_map() {
    let recording = Arc::new(Recording::open());
    let server = Arc::new(TestServer::start().await);
    let mut client = server.client().await;
    create_session(&mut client, "first", camera()).await.unwrap();
    let added = v1::CreateSessionRequest {
        session_id: "second".into(),
        map: "first".into(),
        ..v1::CreateSessionRequest::default()
    };
    client.create_session(added).await.unwrap();
    stream_both(&server, &recording, false).await;
    let server = Arc::into_inner(server).expect("the streams have ended").restart().await;
    let server = Arc::new(server);
    let n_placed = stream_both(&server, &recording, true).await;
    assert!(n_placed.iter().all(|n| *n >= 300 * 95 / 100), "{n_placed:?} of 300 frames after the restart");

    let (mut truth, mut estimate) = (Vec::new(), Vec::new());
    let mut submaps = std::collections::BTreeSet::new();
    for (number, (id, half)) in (0_i64..).zip(HALVES) {
        let trajectory = server.get_json(&format!("/v1/sessions/{id}/trajectory?format=json")).await;
        for pose in trajectory["poses"].as_array().expect("poses") {
            let [x, y, z] = ["tx", "ty", "tz"].map(|axis| pose["world_from_camera"][axis].as_f64().unwrap());
            let sequence = pose["sequence"].as_u64().unwrap();
            // Both are compared at once, the one behind the other.
            let timestamp_ns = number * 1_000_000_000_000 + sequence as i64 * INTERVAL_NS;
            let at = |position| StampedPose {
                timestamp_ns,
                world_from_camera: Pose::new(UnitQuaternion::identity(), position),
            };
            estimate.push(at(Vector3::new(x, y, z)));
            truth.push(at(recording.positions[half.start + sequence as usize]));
            submaps.insert(pose["submap_id"].as_u64());
        }
    }
    let n_frames: usize = HALVES.iter().map(|(_, half)| half.len()).sum();
    let errors = evaluate(&Trajectory::new(truth), &Trajectory::new(estimate), &EvaluationOptions::default());
    let errors = errors.unwrap();
    println!(
        "{} of {n_frames} frames, error {:.4} m, worst {:.4} m",
        errors.matched, errors.ate_rmse, errors.ate_max
    );
    assert_eq!(submaps.len(), 1, "one frame of reference");
    assert!(errors.matched * 100 >= n_frames * 97, "{} of {n_frames} frames", errors.matched);
    assert!(errors.ate_rmse <= MAX_ERROR_M, "error {:.4} m", errors.ate_rmse);
}
