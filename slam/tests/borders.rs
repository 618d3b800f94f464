//! Images of which a border leaves a small part.

use geometry::{Camera, CameraModel, CameraParameters};
use slam::ResumeState;
use synthetic::{Preset, Sequence, SequenceConfig};
use testkit::{Session, evaluate, gray_image, inline};
use vision::GrayImage;

/// Pixels of the border on all sides.
const BORDER: u32 = 160;

/// A camera's image in the middle of a larger black one, and the camera of that.
fn framed(sequence: &Sequence) -> (Camera, impl Fn(usize) -> GrayImage) {
    let CameraParameters { width, height, fx, fy, cx, cy, .. } = sequence.camera().parameters().clone();
    let camera = Camera::new(CameraParameters {
        model: CameraModel::Pinhole,
        width: width + 2 * BORDER,
        height: height + 2 * BORDER,
        fx,
        fy,
        cx: cx + f64::from(BORDER),
        cy: cy + f64::from(BORDER),
        distortion: Vec::new(),
    });
    let image = move |index: usize| {
        let inner = gray_image(sequence.frame(index).image);
        GrayImage::from_fn(width + 2 * BORDER, height + 2 * BORDER, |x, y| {
            let inside = x.checked_sub(BORDER).zip(y.checked_sub(BORDER));
            inside.and_then(|(x, y)| inner.get(x, y)).unwrap_or(2)
        })
    };
    (camera.unwrap(), image)
}

#[test]
fn a_small_image_inside_a_black_border_is_worked_on_enlarged_and_comes_back_so() {
    let mut config = SequenceConfig::preset(Preset::RoomRich, 3);
    let CameraParameters { width, height, fx, fy, cx, cy, .. } = config.camera.clone();
    // Half the size: 320 by 240 of 640 by 560 pixels.
    let half = |at: f64| 0.5 * (at + 0.5) - 0.5;
    config.camera = CameraParameters {
        width: width / 2,
        height: height / 2,
        fx: fx / 2.0,
        fy: fy / 2.0,
        cx: half(cx),
        cy: half(cy),
        ..config.camera
    };
    let sequence = Sequence::new(config).unwrap();
    let (camera, image) = framed(&sequence);
    let mut session = Session::new(inline(3), &camera);
    for index in (0..240).step_by(2) {
        session.show(index as u64, index as i64 * testkit::FRAME_INTERVAL_NS, image(index));
    }
    let map = session.finish();
    let truth = |number: u64| sequence.camera_from_world(number as usize).inverse();
    let evaluation = evaluate(&session.trajectory(), truth).unwrap();
    let error = evaluation.ate_rmse / evaluation.path;
    println!("error {error:.5} of the path, {} keyframes", map.n_keyframes());
    assert!(session.is_enlarged_stored, "what is to be stored says so");
    assert!(error < 0.005, "{error}");
    let focal_px = |map: &slam::Map| map.keyframes().next().unwrap().features.nominal_pinhole.fx;
    assert_eq!(focal_px(&map), 2.0 * camera.parameters().fx);

    // After a restart as before it.
    let mut config = inline(3);
    config.enlarge_for_border = true;
    let state = ResumeState { map: map.to_parts(), last_frame: None, mask: None };
    let mut again = Session::resume(config, &camera, state);
    let reports: Vec<_> =
        (0..4).map(|index| again.show(index as u64, index as i64 * 33_333_333, image(index))).collect();
    assert!(reports.iter().any(|report| report.relocalized), "found again in its map");
}
