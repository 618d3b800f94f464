//! A camera that reads its rows one after the other, told and untold, and across a restart.

use slam::{Map, ResumeState};
use std::sync::Arc;
use synthetic::{Preset, Sequence, SequenceConfig};
use testkit::{Session, evaluate, gray_image, inline};
use vision::GrayImage;

/// As a phone of the slow kind.
const READOUT_NS: i64 = 30_000_000;
const N_FRAMES: usize = 110;

fn rolling_room() -> Sequence {
    let mut config = SequenceConfig::preset(Preset::RoomRich, 6);
    config.render.readout_s = READOUT_NS as f64 / 1e9;
    Sequence::new(config).unwrap()
}

/// The map, the position error and the rotation error, degrees.
fn map_room(sequence: &Sequence, images: &[GrayImage], readout_ns: i64) -> (Arc<Map>, f64, f64) {
    let mut config = inline(3);
    config.rolling_shutter.readout_ns = Some(readout_ns);
    let mut session = Session::new(config, sequence.camera());
    for (index, image) in images.iter().enumerate() {
        session.show(index as u64, sequence.timestamp_ns(index), image.clone());
    }
    let map = session.finish();
    let truth = |number: u64| sequence.camera_from_world(number as usize).inverse();
    let error = evaluate(&session.trajectory(), truth).unwrap();
    (map, error.ate_rmse, error.rot_rmse_deg)
}

#[test]
fn a_readout_that_is_told_is_taken_out_of_the_map_and_stays_out() {
    let sequence = rolling_room();
    let images: Vec<GrayImage> = (0..N_FRAMES).map(|index| gray_image(sequence.frame(index).image)).collect();
    let (_, untold, untold_deg) = map_room(&sequence, &images, 0);
    let (map, told, told_deg) = map_room(&sequence, &images, READOUT_NS);
    assert!(
        told < 0.7 * untold && told_deg < 0.7 * untold_deg,
        "told {told} and {told_deg} degrees, untold {untold} and {untold_deg}"
    );

    // What is stored of a keyframe gives the places that the map was made with.
    for keyframe in map.keyframes() {
        let features = &keyframe.features;
        let stored = slam::features::FrameFeatures::from_parts(
            features.keypoints.clone(),
            features.descriptors.clone(),
            sequence.camera(),
            features.pyramid,
        )
        .unwrap();
        assert_eq!(stored.undistorted, features.undistorted, "keyframe {:?}", keyframe.id);
    }
    let state = ResumeState { map: map.to_parts(), last_frame: None, mask: None };
    let mut resumed = Session::resume(inline(3), sequence.camera(), state);
    resumed.show(
        N_FRAMES as u64,
        sequence.timestamp_ns(N_FRAMES),
        gray_image(sequence.frame(N_FRAMES).image),
    );
    resumed.finish();
}
