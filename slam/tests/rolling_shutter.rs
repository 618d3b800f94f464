//! A camera that reads its rows one after the other: told, found, taken for a global shutter, and across a
//! restart.

use slam::{Map, MapEvent, ResumeState};
use std::collections::BTreeMap;
use std::sync::Arc;
use synthetic::{Preset, Sequence, SequenceConfig};
use testkit::{Session, evaluate, gray_image, inline};
use vision::GrayImage;

/// As a phone of the slow kind.
const READOUT_NS: i64 = 30_000_000;
const N_FRAMES: usize = 110;

fn room(readout_ns: i64) -> (Sequence, Vec<GrayImage>) {
    let mut config = SequenceConfig::preset(Preset::RoomRich, 2);
    config.render.readout_s = readout_ns as f64 / 1e9;
    let sequence = Sequence::new(config).unwrap();
    let images = (0..N_FRAMES).map(|index| gray_image(sequence.frame(index).image)).collect();
    (sequence, images)
}

/// A room that was mapped.
struct Mapped {
    map: Arc<Map>,
    events: Vec<MapEvent>,
    trajectory: BTreeMap<u64, geometry::Pose>,
    /// Position error.
    ate: f64,
    rotation_deg: f64,
}

/// `readout_ns` is what is told of the camera.
fn map_room(sequence: &Sequence, images: &[GrayImage], readout_ns: Option<i64>) -> Mapped {
    let mut config = inline(3);
    config.rolling_shutter.readout_ns = readout_ns;
    let mut session = Session::new(config, sequence.camera());
    for (index, image) in images.iter().enumerate() {
        session.show(index as u64, sequence.timestamp_ns(index), image.clone());
    }
    let map = session.finish();
    let truth = |number: u64| sequence.camera_from_world(number as usize).inverse();
    let trajectory = session.trajectory();
    let error = evaluate(&trajectory, truth).unwrap();
    let (ate, rotation_deg) = (error.ate_rmse, error.rot_rmse_deg);
    Mapped { map, events: session.events, trajectory, ate, rotation_deg }
}

/// What is stored of a keyframe gives the places that the map was made with.
fn assert_stored_as_mapped(map: &Map, sequence: &Sequence) {
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
}

#[test]
fn a_readout_is_taken_out_of_the_map_whether_told_or_found_and_stays_out() {
    let (sequence, images) = room(READOUT_NS);
    let ignored = map_room(&sequence, &images, Some(0));
    let told = map_room(&sequence, &images, Some(READOUT_NS));
    let found = map_room(&sequence, &images, None);
    // One that is found is not taken out from the first frame on.
    for (name, mapped, most) in [("told", &told, 0.7), ("found", &found, 1.0)] {
        let Mapped { ate, rotation_deg, .. } = mapped;
        assert!(
            *ate < most * ignored.ate && *rotation_deg < 0.95 * ignored.rotation_deg,
            "{name}: {ate} and {rotation_deg} degrees, ignored {} and {}",
            ignored.ate,
            ignored.rotation_deg
        );
        assert_stored_as_mapped(&mapped.map, &sequence);
    }
    assert!(told.map.readout().is_none() && ignored.map.readout().is_none(), "nothing was to be found");
    let readout = found.map.readout().unwrap();
    assert!((readout.readout_ns - READOUT_NS).abs() < READOUT_NS / 5, "{readout:?}");
    assert!((1..READOUT_NS / 5).contains(&readout.sigma_ns), "{readout:?}");
    assert!(found.events.iter().any(|event| event.readout().is_some()), "it is told");

    let state = ResumeState { map: found.map.to_parts(), last_frame: None, mask: None };
    let mut resumed = Session::resume(inline(3), sequence.camera(), state);
    resumed.show(
        N_FRAMES as u64,
        sequence.timestamp_ns(N_FRAMES),
        gray_image(sequence.frame(N_FRAMES).image),
    );
    assert_eq!(resumed.finish().readout(), Some(readout));
}

#[test]
fn a_global_shutter_is_left_alone() {
    let (sequence, images) = room(0);
    let told = map_room(&sequence, &images, Some(0));
    let looked_at = map_room(&sequence, &images, None);
    assert!(looked_at.map.n_keyframes() >= 10, "{} keyframes were looked at", looked_at.map.n_keyframes());
    assert_eq!(looked_at.map.readout(), None);
    assert_eq!(looked_at.trajectory, told.trajectory, "looking changes nothing");
}

/// A camera that has no new image at every third frame, and is answered for with its last.
#[test]
fn images_that_are_sent_again_are_where_they_were_taken_and_disturb_nothing() {
    let (sequence, images) = room(READOUT_NS);
    let distinct = map_room(&sequence, &images, None);
    let shown = |index: usize| index - usize::from(index % 3 == 2);
    let repeated: Vec<GrayImage> = (0..N_FRAMES).map(|index| images[shown(index)].clone()).collect();
    let mapped = map_room(&sequence, &repeated, None);
    assert_eq!(mapped.trajectory.len(), N_FRAMES, "every frame has a pose, those before the map as well");
    for (number, pose) in &mapped.trajectory {
        let of = shown(*number as usize) as u64;
        assert_eq!(*pose, mapped.trajectory[&of], "frame {number} repeats frame {of}");
    }
    let taken = |mapped: &Mapped| {
        let own = mapped.trajectory.iter().filter(|(number, _)| shown(**number as usize) as u64 == **number);
        let truth = |number: u64| sequence.camera_from_world(number as usize).inverse();
        evaluate(&own.map(|(number, pose)| (*number, *pose)).collect(), truth).unwrap().ate_rmse
    };
    let (ate, of_distinct) = (taken(&mapped), taken(&distinct));
    assert!(ate < 1.5 * of_distinct, "{ate}, and {of_distinct} where every image is new");
    let readout = mapped.map.readout().unwrap();
    assert!((readout.readout_ns - READOUT_NS).abs() < READOUT_NS / 4, "{readout:?}");
}
