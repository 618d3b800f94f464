use nalgebra::Matrix3;

use super::*;
use crate::GrayImage;
use crate::lines::test_scenes::{Scene, apply, similarity};
use crate::test_images::noise;

const SIZE: (u32, u32) = (400, 320);
const CENTER: Vector2<f32> = Vector2::new(200.0, 160.0);

fn pyramid(image: &GrayImage) -> FlowPyramid {
    let mut pyramid = FlowPyramid::default();
    pyramid.build(image);
    pyramid
}

/// Follows all edges longer than 30 px through a motion; gives the share found, and of those the root mean
/// square and the largest distance of their middle thirds' ends from the true edges.
fn followed(motion: &Matrix3<f32>, gain: f32, offset: f32, prior: Option<&MotionPrior>) -> (f32, f32, f32) {
    let scene = Scene::new(SIZE.0, SIZE.1, 8);
    let still = Matrix3::identity();
    let last = pyramid(&scene.render(SIZE, &still, 1.0, 0.0));
    let next = pyramid(&scene.render(SIZE, motion, gain, offset));
    let after = scene.segments(SIZE, motion);
    let mut flow = LineFlow::new(LineFlowConfig::default());
    let (mut n, mut errors) = (0, Vec::new());
    let inner = Frame::of_image(SIZE.0, SIZE.1).grown(-12.0);
    for (number, segment) in scene.segments(SIZE, &still) {
        let Some((_, truth)) = after.iter().find(|(again, _)| *again == number) else { continue };
        let ends = [segment.start, segment.end, truth.start, truth.end];
        if segment.length() < 30.0 || !ends.iter().all(|end| inner.contains(end)) {
            continue;
        }
        n += 1;
        if let Ok(found) = flow.follow(&last, &next, &segment, prior) {
            assert!(found.n_inliers >= 4 && found.n_inliers <= found.n_samples);
            assert!(found.segment.gradient > 3.0 && found.segment.sigma_px >= 0.3);
            errors.push(truth.distance(&found.segment.midpoint()).abs());
            errors.push(truth.distance(&found.segment.start).abs());
        }
    }
    assert!(n >= 25, "only {n} edges");
    let rms = (errors.iter().map(|error| error * error).sum::<f32>() / errors.len() as f32).sqrt();
    let worst = errors.iter().copied().fold(0.0, f32::max);
    (errors.len() as f32 / (2 * n) as f32, rms, worst)
}

#[test]
fn known_motions_are_followed_to_a_fraction_of_a_pixel() {
    let by = |x, y| Vector2::new(x, y);
    for (name, motion, gain, offset) in [
        ("none", Matrix3::identity(), 1.0, 0.0),
        ("small", similarity(CENTER, 1.0, 0.0, by(0.4, -0.7)), 1.0, 0.0),
        ("shift", similarity(CENTER, 1.0, 0.0, by(5.3, 3.8)), 1.0, 0.0),
        ("turn", similarity(CENTER, 1.0, 2.0, by(0.0, 0.0)), 1.0, 0.0),
        ("nearer", similarity(CENTER, 1.03, 1.0, by(2.0, -3.0)), 1.0, 0.0),
        ("relit", similarity(CENTER, 1.0, 0.5, by(-3.0, 2.0)), 0.85, 25.0),
    ] {
        let (share, rms, worst) = followed(&motion, gain, offset, None);
        println!("{name}: {share:.2} found, rms {rms:.3} px, worst {worst:.3} px");
        assert!(share >= 0.9, "{name}: {share} found");
        assert!(rms < 0.15 && worst < 0.7, "{name}: rms {rms} px, worst {worst} px");
    }
}

#[test]
fn a_prior_makes_large_motions_small() {
    let motion = similarity(CENTER, 1.02, 8.0, Vector2::new(31.0, -17.0));
    // The prior is wrong by 2 px and a third of a degree.
    let expected = similarity(CENTER, 1.02, 8.3, Vector2::new(32.4, -18.4));
    let prior = |pixel: Vector2<f32>| apply(&expected, pixel);
    let (share, rms, worst) = followed(&motion, 1.0, 0.0, Some(&prior));
    println!("{share:.2} found, rms {rms:.3} px, worst {worst:.3} px");
    assert!(share >= 0.9 && rms < 0.15 && worst < 0.7);
}

#[test]
fn what_is_not_there_is_not_found() {
    let scene = Scene::new(SIZE.0, SIZE.1, 8);
    let last = pyramid(&scene.render(SIZE, &Matrix3::identity(), 1.0, 0.0));
    let mut flow = LineFlow::new(LineFlowConfig::default());
    for next in [GrayImage::new(SIZE.0, SIZE.1), noise(SIZE.0, SIZE.1, 255, 4)] {
        let next = pyramid(&next);
        for (_, segment) in scene.segments(SIZE, &Matrix3::identity()) {
            assert!(flow.follow(&last, &next, &segment, None).is_err());
        }
    }
}

#[test]
fn nothing_sensible_gives_a_reason() {
    let image = pyramid(&noise(64, 48, 255, 1));
    let tiny = pyramid(&noise(3, 2, 255, 1));
    let mut flow = LineFlow::new(LineFlowConfig::default());
    let segment = |x: f32, y: f32| Segment {
        start: Vector2::new(20.0, 20.0),
        end: Vector2::new(x, y),
        sigma_px: 0.3,
        gradient: 9.0,
    };
    for nonsense in [segment(20.0, 20.0), segment(f32::NAN, 3.0), segment(f32::MAX, f32::MAX)] {
        assert_eq!(flow.follow(&image, &image, &nonsense, None), Err(FlowFailure::NotASegment));
    }
    let outside = Segment { start: Vector2::new(-50.0, -50.0), ..segment(-9.0, -9.0) };
    let reason = FlowFailure::OutsideImage { n_samples: 0 };
    assert_eq!(flow.follow(&image, &image, &outside, None), Err(reason));
    assert_eq!(flow.follow(&tiny, &image, &segment(50.0, 20.0), None), Err(reason));
    assert_eq!(flow.follow(&image, &tiny, &segment(50.0, 20.0), None), Err(reason));
    assert_eq!(flow.follow(&FlowPyramid::default(), &image, &segment(50.0, 20.0), None), Err(reason));
}
