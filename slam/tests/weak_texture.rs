//! A room whose texture is a few gray levels, across a restart.

use slam::{FrameReport, ResumeState};
use synthetic::{Preset, Sequence};
use testkit::{FRAME_INTERVAL_NS, Session, gray_image, inline};
use vision::GrayImage;

/// What is left of every difference from middle gray.
const CONTRAST: f32 = 0.03;
/// Views of the first run.
const N_FIRST: usize = 90;
/// Views of the second.
const N_SECOND: usize = 40;

fn faint(image: &GrayImage) -> GrayImage {
    GrayImage::from_fn(image.width(), image.height(), |x, y| {
        (128.0 + CONTRAST * (f32::from(image.row(y)[x as usize]) - 128.0)).round() as u8
    })
}

fn show(session: &mut Session, sequence: &Sequence, index: usize) -> FrameReport {
    let image = faint(&gray_image(sequence.frame(index).image));
    session.show(index as u64, index as i64 * FRAME_INTERVAL_NS, image)
}

#[test]
fn a_resumed_session_of_weak_texture_finds_its_place_before_it_begins_a_submap() {
    let sequence = Sequence::preset(Preset::RoomRich, 3);
    let mut session = Session::new(inline(7), sequence.camera());
    let first: Vec<FrameReport> = (0..N_FIRST).map(|index| show(&mut session, &sequence, index)).collect();
    assert!(first[0].n_keypoints < 100, "{} keypoints are ordinary texture", first[0].n_keypoints);
    let map = session.finish();
    assert!(session.trajectory().len() >= N_FIRST / 2, "amplified, the room has a map");

    let last = N_FIRST - 1;
    let last_frame = Some((last as u64, last as i64 * FRAME_INTERVAL_NS));
    let state = ResumeState { map: map.to_parts(), last_frame, mask: None };
    let mut resumed = Session::resume(inline(7), sequence.camera(), state);
    let reports: Vec<FrameReport> =
        (N_FIRST..N_FIRST + N_SECOND).map(|index| show(&mut resumed, &sequence, index)).collect();
    let found = reports.iter().position(|report| report.relocalized);
    assert!(found.is_some_and(|found| found < 10), "found after {found:?} frames");
    assert_eq!(resumed.finish().submaps().len(), 1, "no submap was begun beside it");
}
