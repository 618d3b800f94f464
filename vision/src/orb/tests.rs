//! The whole extractor: what it finds is found again, and it minds no image.

use super::*;
use crate::matching::{MatchConfig, match_brute_force};
use crate::scale::resize_area;
use crate::test_images;

fn extractor() -> OrbExtractor {
    OrbExtractor::new(OrbConfig::default()).expect("the default configuration is valid")
}

/// `image` turned about its center, clockwise on the screen; bilinear, mid-gray outside.
fn turned(image: &GrayImage, degrees: f32) -> GrayImage {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let (cx, cy) = ((image.width() - 1) as f32 / 2.0, (image.height() - 1) as f32 / 2.0);
    GrayImage::from_fn(image.width(), image.height(), |x, y| {
        let (dx, dy) = (x as f32 - cx, y as f32 - cy);
        let (u, v) = (cx + cos * dx + sin * dy, cy - sin * dx + cos * dy);
        let (left, top) = (u.floor(), v.floor());
        let pixel = |x: f32, y: f32| {
            let inside = x >= 0.0 && y >= 0.0;
            inside.then(|| image.get(x as u32, y as u32)).flatten().map_or(128.0, f32::from)
        };
        let (a, b) = (u - left, v - top);
        let upper = pixel(left, top) * (1.0 - a) + pixel(left + 1.0, top) * a;
        let lower = pixel(left, top + 1.0) * (1.0 - a) + pixel(left + 1.0, top + 1.0) * a;
        (upper * (1.0 - b) + lower * b + 0.5) as u8
    })
}

/// Number of matches, and of those that `moved` puts within 3 pixels of the coarser keypoint's level of where
/// they should be.
fn matches(a: &Features, b: &Features, moved: impl Fn(f32, f32) -> (f32, f32)) -> (usize, usize) {
    let found = match_brute_force(a, b, &MatchConfig::default());
    let is_right = |m: &&crate::matching::DescriptorMatch| {
        let (p, q) = (a.keypoints[m.first_idx as usize], b.keypoints[m.second_idx as usize]);
        let (x, y) = moved(p.x, p.y);
        let level = OrbConfig::default().level_sigma_px(p.octave.max(q.octave));
        (x - q.x).hypot(y - q.y) < 3.0 * level
    };
    (found.len(), found.iter().filter(is_right).count())
}

#[test]
fn a_turned_image_is_recognized_and_its_angles_turn_along() {
    let image = test_images::blobs(321, 321, 1);
    let original = extractor().extract(&image);
    for degrees in [90.0f32, 30.0, 197.0] {
        let features = extractor().extract(&turned(&image, degrees));
        let (sin, cos) = degrees.to_radians().sin_cos();
        let moved = |x: f32, y: f32| {
            let (dx, dy) = (x - 160.0, y - 160.0);
            (160.0 + cos * dx - sin * dy, 160.0 + sin * dx + cos * dy)
        };
        let (n, n_right) = matches(&original, &features, moved);
        assert!(n_right >= 150 && n_right * 10 >= n * 9, "{degrees} degrees: {n_right} of {n} are right");
        let turn = |m: &crate::matching::DescriptorMatch| {
            let change = features.keypoints[m.second_idx as usize].angle
                - original.keypoints[m.first_idx as usize].angle
                - degrees.to_radians();
            (change + 9.0 * std::f32::consts::PI).rem_euclid(std::f32::consts::TAU) - std::f32::consts::PI
        };
        let mut errors: Vec<f32> = match_brute_force(&original, &features, &MatchConfig::default())
            .iter()
            .map(|m| turn(m).abs().to_degrees())
            .collect();
        errors.sort_by(f32::total_cmp);
        assert!(errors[errors.len() / 2] < 6.0, "median error of the angle {}", errors[errors.len() / 2]);
    }
}

#[test]
fn a_shrunk_image_is_recognized_at_other_octaves() {
    let image = test_images::blobs(640, 480, 2);
    let shrunk = resize_area(&image, 400, 300);
    let (a, b) = (extractor().extract(&image), extractor().extract(&shrunk));
    let (n, n_right) = matches(&a, &b, |x, y| ((x + 0.5) / 1.6 - 0.5, (y + 0.5) / 1.6 - 0.5));
    assert!(n_right >= 100 && n_right * 10 >= n * 8, "{n_right} of {n} are right");
}

#[test]
fn images_without_texture_give_nothing_and_do_no_harm() {
    let mut extractor = extractor();
    for level in [0, 128, 255] {
        assert!(extractor.extract(&GrayImage::from_fn(640, 480, |_, _| level)).is_empty());
    }
    for (width, height) in [(0, 0), (1, 1), (33, 33), (40, 5), (2000, 34)] {
        let features = extractor.extract(&test_images::noise(width, height, 255, 1));
        assert_eq!(features.keypoints.len(), features.descriptors.len());
    }
}

#[test]
fn features_lie_inside_and_number_what_was_asked() {
    let mut extractor = extractor();
    for (width, height) in [(640, 480), (160, 120), (752, 480), (120, 400)] {
        for image in [test_images::noise(width, height, 255, 5), test_images::blobs(width, height, 6)] {
            for n_features in [300, 2000, 50] {
                extractor.set_n_features(n_features);
                let features = extractor.extract(&image);
                assert_eq!(features.keypoints.len(), features.descriptors.len());
                let enough = width * height > 100_000;
                assert!(features.len() <= n_features && (!enough || features.len() == n_features));
                assert!(features.keypoints.windows(2).all(|k| k[0].octave <= k[1].octave));
                for k in &features.keypoints {
                    // Detected 16 pixels from the border or more, then refined by up to 1.5 either way.
                    let margin = 14.4 * extractor.level_sigma_px(k.octave);
                    assert!(k.x >= margin * 0.95 && k.x <= width as f32 - margin * 0.95, "{k:?}");
                    assert!(k.y >= margin * 0.95 && k.y <= height as f32 - margin * 0.95, "{k:?}");
                    assert!((0.0..std::f32::consts::TAU).contains(&k.angle) && k.response > 0.0);
                }
            }
        }
    }
}

#[test]
fn the_same_image_gives_the_same_features_whatever_came_before() {
    let image = test_images::blobs(320, 240, 7);
    let expected = extractor().extract(&image);
    let mut used = extractor();
    used.extract(&test_images::noise(640, 480, 255, 8));
    assert_eq!(used.extract(&image), expected);
    assert_eq!(used.extract(&image), expected);
}

#[test]
fn configurations_out_of_range_are_refused() {
    let base = OrbConfig::default();
    assert!(base.validate().is_ok());
    for bad in [
        OrbConfig { n_levels: 0, ..base },
        OrbConfig { n_levels: 17, ..base },
        OrbConfig { scale_factor: 1.0, ..base },
        OrbConfig { scale_factor: f32::NAN, ..base },
        OrbConfig { min_fast_threshold: 0, ..base },
        OrbConfig { min_fast_threshold: 21, ..base },
        OrbConfig { cell_size_px: 7, ..base },
        OrbConfig { edge_margin_px: 15, ..base },
        OrbConfig { spread_share: -0.1, ..base },
        OrbConfig { spread_share: f32::NAN, ..base },
    ] {
        assert!(OrbExtractor::new(bad).is_err(), "{bad:?}");
    }
}

#[test]
fn descriptors_survive_bytes_and_measure_bits() {
    let a = Descriptor([1, 2, 3, u64::MAX]);
    assert_eq!(Descriptor::from_bytes(&a.to_bytes()), a);
    assert_eq!(a.to_bytes()[..2], [1, 0]);
    assert_eq!(a.distance(&a), 0);
    assert_eq!(a.distance(&Descriptor([0, 2, 1, 0])), 1 + 1 + 64);
    assert_eq!(Descriptor([0; 4]).distance(&Descriptor([u64::MAX; 4])), 256);
    assert!(a.bit(0) && !a.bit(1) && a.bit(65) && a.bit(255));
}

#[test]
fn keypoints_keep_clear_of_what_is_left_out() {
    use crate::mask::{Clearance, Mask};
    let hash = |x: u32, y: u32| (x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77)) >> 13;
    let image =
        GrayImage::from_fn(320, 240, |x, y| if x < 100 { 0 } else { (40 + hash(x / 8, y / 8) % 160) as u8 });
    let mut extractor = OrbExtractor::new(OrbConfig::default()).unwrap();
    let leftmost = |features: &Features| {
        let places = features.keypoints.iter().map(|keypoint| keypoint.x);
        places.fold(f32::INFINITY, f32::min)
    };
    assert!(leftmost(&extractor.extract(&image)) < 105.0, "the frame's own edge has corners");
    let mask = Mask::from_fn(320, 240, |x, _| x < 100);
    extractor.set_clearance(Some(std::sync::Arc::new(Clearance::of(&mask))));
    let features = extractor.extract(&image);
    assert!(features.len() > 200 && leftmost(&features) > 113.0, "{}", leftmost(&features));
    let small = Clearance::of(&mask.resized(160, 120));
    extractor.set_clearance(Some(std::sync::Arc::new(small)));
    assert!(leftmost(&extractor.extract(&image)) < 105.0, "a mask of other images is not heeded");
}
