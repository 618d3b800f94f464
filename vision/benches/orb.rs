//! Time of the point front end on one thread: extraction, matching and place recognition.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use vision::decode::{DecodeLimits, EncodedImage, decode_gray};
use vision::matching::{MatchConfig, match_brute_force};
use vision::place::PlaceIndex;
use vision::{Features, GrayImage, OrbConfig, OrbExtractor, Pyramid};

/// A recorded image, if the recordings are there.
fn recorded() -> Option<GrayImage> {
    let folder = recordings::find_folder("7scenes_redkitchen").ok()?;
    let bytes = std::fs::read(folder.join("images/frame-000100.color.jpg")).ok()?;
    decode_gray(&EncodedImage::Auto(&bytes), &DecodeLimits::default()).ok()
}

/// Overlapping rectangles under a little noise, 640 x 480, drawn from a seed.
fn synthesized(seed: u64) -> GrayImage {
    let mut state = seed;
    let mut below = |n: u32| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (((state >> 32) * u64::from(n)) >> 32) as u32
    };
    let mut image = GrayImage::from_fn(640, 480, |_, _| 120);
    for _ in 0..400 {
        let (left, top, value) = (below(640), below(480), 20 + below(200) as u8);
        let (right, bottom) = ((left + 8 + below(60)).min(640), (top + 8 + below(60)).min(480));
        for y in top..bottom {
            image.row_mut(y)[left as usize..right as usize].fill(value);
        }
    }
    for pixel in image.as_raw_mut() {
        *pixel += below(8) as u8;
    }
    image
}

fn extractor() -> OrbExtractor {
    OrbExtractor::new(OrbConfig::default()).expect("the default configuration is valid")
}

fn extraction(c: &mut Criterion) {
    let mut extractor = extractor();
    let mut pyramid = Pyramid::new(8, 1.2);
    let synthesized = synthesized(1);
    c.bench_function("extract 1000 of 640x480, synthesised", |b| {
        b.iter(|| black_box(extractor.extract(black_box(&synthesized))));
    });
    c.bench_function("pyramid of 640x480, 8 levels", |b| b.iter(|| pyramid.build(black_box(&synthesized))));
    match recorded() {
        Some(image) => {
            c.bench_function("extract 1000 of 640x480, recorded", |b| {
                b.iter(|| black_box(extractor.extract(black_box(&image))));
            });
        }
        None => println!("no recorded image (MONOSLAM_DATA): that part is skipped"),
    }
}

fn matching(c: &mut Criterion) {
    let mut extractor = extractor();
    let features: Vec<Features> = (1..=100).map(|seed| extractor.extract(&synthesized(seed))).collect();
    let config = MatchConfig::default();
    c.bench_function("match 1000 with 1000, all against all", |b| {
        b.iter(|| black_box(match_brute_force(&features[0], &features[1], &config)));
    });
    let mut index = PlaceIndex::new();
    for (id, image) in (0..).zip(&features) {
        index.insert(id, &image.descriptors);
    }
    c.bench_function("place query of 1000 among 100 images", |b| {
        b.iter(|| black_box(index.query(&features[50].descriptors, 5)));
    });
}

criterion_group!(benches, extraction, matching);
criterion_main!(benches);
