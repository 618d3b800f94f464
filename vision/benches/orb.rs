//! Time of the point front end on one thread: extraction, its stages, matching and place recognition.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use vision::{GrayImage, OrbConfig, OrbExtractor};

fn extraction(c: &mut Criterion) {
    let image = GrayImage::from_fn(640, 480, |x, y| (x * y) as u8);
    let mut extractor = OrbExtractor::new(OrbConfig::default()).expect("the default configuration is valid");
    c.bench_function("extract", |b| b.iter(|| black_box(extractor.extract(black_box(&image)))));
}

criterion_group!(benches, extraction);
criterion_main!(benches);
