//! The detectors as a whole: what they find where the truth is known, and that nothing breaks them.

use std::time::Instant;

use nalgebra::Vector2;

use super::*;
use crate::GrayImage;
use crate::test_images::{self, Random};

const KINDS: [DetectorKind; 2] = [DetectorKind::EdgeDrawing, DetectorKind::Lsd];

fn detect(kind: DetectorKind, image: &GrayImage) -> Vec<Segment> {
    detector(LineDetectorConfig { kind, ..Default::default() }).unwrap().detect(image)
}

/// A bright rectangle with the given center, half sides and rotation, each pixel the mean of 8 x 8 places in
/// it.
struct Rectangle {
    center: Vector2<f32>,
    half: Vector2<f32>,
    angle: f32,
}

impl Rectangle {
    fn axes(&self) -> [Vector2<f32>; 2] {
        let (sin, cos) = self.angle.sin_cos();
        [Vector2::new(cos, sin), Vector2::new(-sin, cos)]
    }

    fn draw(&self, width: u32, height: u32, noise: f32, seed: u64) -> GrayImage {
        let [u, v] = self.axes();
        let mut random = Random::new(seed);
        GrayImage::from_fn(width, height, |x, y| {
            let mut inside = 0;
            for i in 0..256 {
                let place =
                    Vector2::new((i % 16) as f32, (i / 16) as f32) / 16.0 - Vector2::repeat(15.0 / 32.0);
                let offset = Vector2::new(x as f32, y as f32) + place - self.center;
                inside +=
                    u32::from(offset.dot(&u).abs() <= self.half.x && offset.dot(&v).abs() <= self.half.y);
            }
            // Twelve uniform numbers add up to nearly a Gaussian of variance 1.
            let gaussian = (0..12).map(|_| random.unit()).sum::<f32>() - 6.0;
            (60.0 + 100.0 * inside as f32 / 256.0 + noise * gaussian).round().clamp(0.0, 255.0) as u8
        })
    }

    /// Its sides, each directed with the inside to the right.
    fn sides(&self) -> [(Vector2<f32>, Vector2<f32>); 4] {
        let [u, v] = self.axes().map(|axis| axis);
        let corner = |x: f32, y: f32| self.center + u * (x * self.half.x) + v * (y * self.half.y);
        let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        std::array::from_fn(|i| (corners[i], corners[(i + 1) % 4]))
    }
}

#[test]
fn the_sides_of_a_rectangle_are_found_to_a_fraction_of_a_pixel() {
    for kind in KINDS {
        for (degrees, noise) in (0..90).step_by(9).flat_map(|degrees| [(degrees, 0.0), (degrees, 4.0)]) {
            let rectangle = Rectangle {
                center: Vector2::new(100.3, 90.6),
                half: Vector2::new(60.2, 40.4),
                angle: (degrees as f32).to_radians(),
            };
            let segments = detect(kind, &rectangle.draw(200, 180, noise, 1 + degrees as u64));
            assert_eq!(segments.len(), 4, "{kind:?}, {degrees} degrees, noise {noise}: {segments:?}");
            for (start, end) in rectangle.sides() {
                let nearest = |a: &&Segment, b: &&Segment| {
                    let apart = |s: &Segment| (s.start - start).norm() + (s.end - end).norm();
                    apart(a).total_cmp(&apart(b))
                };
                let found = segments.iter().min_by(nearest).unwrap();
                let context = format!("{kind:?}, {degrees} degrees, noise {noise}: {found:?}");
                // Along the rows of a sharp image edges seem up to 0.1 pixels nearer to where pixels meet.
                let tolerance_px = if noise > 0.0 { 0.25 } else { 0.12 };
                assert!(found.distance(&start).abs() < tolerance_px, "{context} misses {start}");
                assert!(found.distance(&end).abs() < tolerance_px, "{context} misses {end}");
                assert!((found.start - start).norm() < 6.0 && (found.end - end).norm() < 6.0, "{context}");
                assert_eq!(found.sigma_px, 0.3, "{context}");
                assert!((15.0..60.0).contains(&found.gradient), "{context}");
            }
        }
    }
}

#[test]
fn segments_that_leave_the_image_end_at_the_border() {
    for kind in KINDS {
        let image = GrayImage::from_fn(200, 150, |x, y| if 2 * y > x { 180 } else { 60 });
        let segments = detect(kind, &image);
        assert_eq!(segments.len(), 1, "{kind:?}");
        let border = LineDetectorConfig::default().border_px;
        for end in [segments[0].start, segments[0].end] {
            assert!(end.x >= border - 0.01 && end.y >= border - 0.01, "{kind:?}: {end}");
            assert!(end.x <= 199.01 - border, "{kind:?}: {end}");
        }
        assert!(segments[0].length() > 200.0, "{kind:?}");
    }
}

#[test]
fn a_gap_does_not_cut_a_line() {
    // An edge, crossed by a dark bar of 5 pixels.
    let image = GrayImage::from_fn(200, 120, |x, y| match (x, y) {
        (98..=102, _) => 20,
        (_, 0..60) => 60,
        _ => 160,
    });
    let segments = detect(DetectorKind::EdgeDrawing, &image);
    assert!((segments[0].vector() - Vector2::new(191.0, 0.0)).norm() < 3.0, "{:?}", segments[0]);
}

#[test]
fn noise_and_curves_are_not_lines() {
    for kind in KINDS {
        for amplitude in [20, 60, 255] {
            let n = (0..3)
                .map(|seed| detect(kind, &test_images::noise(640, 480, amplitude, seed)).len())
                .sum::<usize>();
            assert!(n <= 2, "{kind:?}: {n} in three images of noise {amplitude}");
        }
        let disc = GrayImage::from_fn(200, 200, |x, y| {
            let radius = (x as f32 - 100.0).hypot(y as f32 - 100.0);
            (60.0 + 100.0 * (40.5 - radius).clamp(0.0, 1.0)) as u8
        });
        let segments = detect(kind, &disc);
        assert!(segments.iter().all(|segment| segment.length() < 30.0), "{kind:?}: {segments:?}");
    }
}

/// Images that are hard on a detector: of no or odd size, without edges, or with nothing but edges.
fn hard_images() -> Vec<(String, GrayImage)> {
    let mut images = Vec::new();
    for (width, height) in
        [(0, 0), (0, 9), (1, 1), (2, 2), (3, 3), (7, 4), (33, 33), (5, 400), (400, 5), (1, 500)]
    {
        images.push((format!("noise {width}x{height}"), test_images::noise(width, height, 255, 5)));
        images.push((
            format!("step {width}x{height}"),
            GrayImage::from_fn(width, height, |x, y| if x > y { 200 } else { 20 }),
        ));
    }
    let large = |name: &str, f: fn(u32, u32) -> u8| (name.to_string(), GrayImage::from_fn(640, 480, f));
    images.extend([
        large("plain", |_, _| 128),
        large("fine grid", |x, y| if x % 6 < 3 || y % 6 < 3 { 220 } else { 30 }),
        large("checkers", |x, y| if (x / 4 + y / 4) % 2 == 0 { 220 } else { 30 }),
        large("halftone", |x, y| if (x % 4) + (y % 4) < 2 { 0 } else { 255 }),
        large("stripes", |x, _| if x % 8 < 4 { 0 } else { 255 }),
        large("diagonal stripes", |x, y| if (x + y) % 10 < 5 { 0 } else { 255 }),
        large("slope", |x, y| ((x + y) / 5) as u8),
        large("sawtooth", |x, y| (7 * x + 3 * y) as u8),
    ]);
    images.push(("noise".to_string(), test_images::noise(640, 480, 255, 9)));
    images.push(("blobs".to_string(), test_images::blobs(640, 480, 9)));
    images
}

#[test]
fn hard_images_give_sound_segments_in_bounded_time() {
    for kind in KINDS {
        let config = LineDetectorConfig { kind, ..Default::default() };
        // One detector for all: what one image leaves behind must not show in the next.
        let mut kept = detector(config).unwrap();
        for (name, image) in hard_images() {
            let begun = Instant::now();
            let segments = kept.detect(&image);
            let elapsed = begun.elapsed();
            assert!(elapsed.as_secs_f32() < 2.0, "{kind:?}, {name}: {elapsed:?}");
            assert!(segments.len() <= config.max_segments, "{kind:?}, {name}");
            assert!(segments.is_sorted_by(|a, b| a.length() >= b.length()), "{kind:?}, {name}");
            for segment in &segments {
                assert!(segment.is_finite(), "{kind:?}, {name}: {segment:?}");
                assert!(
                    segment.length() >= config.min_length_px(image.width()),
                    "{kind:?}, {name}: {segment:?}"
                );
                assert!(segment.gradient > 0.0, "{kind:?}, {name}: {segment:?}");
                assert!(
                    (0.3..=config.max_sigma_px).contains(&segment.sigma_px),
                    "{kind:?}, {name}: {segment:?}"
                );
                for end in [segment.start, segment.end] {
                    let inside = end.x >= 2.0 && end.y >= 2.0;
                    let inside =
                        inside && end.x <= image.width() as f32 - 3.0 && end.y <= image.height() as f32 - 3.0;
                    assert!(inside, "{kind:?}, {name}: {segment:?}");
                }
            }
            assert_eq!(segments, detect(kind, &image), "{kind:?}, {name}");
        }
    }
}

#[test]
fn stripes_are_all_found_until_there_are_enough() {
    for kind in KINDS {
        let image = GrayImage::from_fn(640, 480, |x, _| if x % 20 < 10 { 40 } else { 200 });
        let all = detect(kind, &image);
        assert_eq!(all.len(), 63, "{kind:?}");
        assert!(all.iter().all(|segment| segment.length() > 460.0), "{kind:?}");
        let config = LineDetectorConfig { kind, max_segments: 10, ..Default::default() };
        assert_eq!(detector(config).unwrap().detect(&image).len(), 10, "{kind:?}");
    }
}

#[test]
fn settings_out_of_range_are_refused() {
    use LineDetectorConfigError as Error;
    let default = LineDetectorConfig::default();
    assert_eq!(default.validate(), Ok(()));
    for (config, expected) in [
        (LineDetectorConfig { min_length_px: 3.0, ..default }, Error::MinLength(3.0)),
        (LineDetectorConfig { min_length_share: -0.1, ..default }, Error::MinLengthShare(-0.1)),
        (LineDetectorConfig { border_px: 0.0, ..default }, Error::Border(0.0)),
        (LineDetectorConfig { max_segments: 0, ..default }, Error::MaxSegments),
        (LineDetectorConfig { max_sigma_px: 0.3, ..default }, Error::MaxSigma(0.3)),
        (LineDetectorConfig { min_gradient: 0.0, ..default }, Error::MinGradient(0.0)),
        (LineDetectorConfig { lsd_scale: 0.2, ..default }, Error::LsdScale(0.2)),
    ] {
        assert_eq!(config.validate(), Err(expected));
        assert_eq!(detector(config).err(), Some(expected));
    }
    assert!(LineDetectorConfig { min_length_px: f32::NAN, ..default }.validate().is_err());
    assert!(LineDetectorConfig { border_px: f32::NAN, ..default }.validate().is_err());
}
