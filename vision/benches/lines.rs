//! Time of line segment detection on one thread.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use vision::GrayImage;
use vision::decode::{DecodeLimits, EncodedImage, decode_gray};
use vision::lines::{DetectorKind, LineDetectorConfig, detector};

/// Recorded images, if the recordings are there: a usual one and two that take long.
fn recorded() -> Vec<(&'static str, GrayImage)> {
    let Ok(folder) = recordings::find_folder("7scenes_redkitchen") else { return Vec::new() };
    let read = |number: u32| {
        let bytes = std::fs::read(folder.join(format!("images/frame-{number:06}.color.jpg"))).ok()?;
        decode_gray(&EncodedImage::Auto(&bytes), &DecodeLimits::default()).ok()
    };
    let names = [("recorded", 100), ("recorded, cluttered", 200), ("recorded, blurred", 800)];
    names.into_iter().filter_map(|(name, number)| Some((name, read(number)?))).collect()
}

/// Half planes of random brightness, each over a part of the image: edges in all directions, under a little
/// noise.
fn synthesized(n_edges: u32) -> GrayImage {
    let mut state = 1u64;
    let mut below = |n: u32| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (((state >> 32) * u64::from(n)) >> 32) as u32
    };
    let mut image = GrayImage::from_fn(640, 480, |_, _| 120);
    for _ in 0..n_edges {
        let (left, top) = (below(560), below(400));
        let (width, height) = (40 + below(120), 40 + below(120));
        let (sin, cos) = (below(628) as f32 / 100.0).sin_cos();
        let value = 20 + below(200) as u8;
        for y in top..(top + height).min(480) {
            for x in left..(left + width).min(640) {
                let (dx, dy) = (x as f32 - (left + width / 2) as f32, y as f32 - (top + height / 2) as f32);
                if dx * cos + dy * sin > 0.0 {
                    image.set(x, y, value);
                }
            }
        }
    }
    for pixel in image.as_raw_mut() {
        *pixel += below(8) as u8;
    }
    image
}

fn detection(c: &mut Criterion) {
    let mut images = vec![
        ("few edges", synthesized(20)),
        ("many edges", synthesized(300)),
        ("plain", GrayImage::from_fn(640, 480, |_, _| 120)),
    ];
    images.extend(recorded());
    if images.len() == 3 {
        println!("no recorded images (MONOSLAM_DATA): that part is skipped");
    }
    for kind in [DetectorKind::EdgeDrawing, DetectorKind::Lsd] {
        let mut detector = detector(LineDetectorConfig { kind, ..Default::default() })
            .expect("the default configuration is valid");
        for (name, image) in &images {
            let n_segments = detector.detect(image).len();
            c.bench_function(&format!("{kind:?} in 640x480, {name}: {n_segments} segments"), |b| {
                b.iter(|| black_box(detector.detect(black_box(image))));
            });
        }
    }
}

criterion_group!(benches, detection);
criterion_main!(benches);
