//! Agreement with the outputs of the reference implementation, and the parts' own tests.

use std::path::Path;

use nalgebra::Vector2;

use super::*;
use crate::decode::{DecodeLimits, EncodedImage, decode_gray};

/// Segments shorter than this are left out of the comparison, pixels.
const MIN_LENGTH_PX: f32 = 20.0;

fn read_image(path: &Path) -> GrayImage {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    decode_gray(&EncodedImage::Auto(&bytes), &DecodeLimits::default()).unwrap()
}

/// A binary gray PGM file of 8 bits without comments.
fn read_pgm(path: &Path) -> GrayImage {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut fields = Vec::new();
    let mut rest = bytes.as_slice();
    while fields.len() < 4 {
        let end = rest.iter().position(u8::is_ascii_whitespace).expect("a head of four fields");
        fields.push(std::str::from_utf8(&rest[..end]).unwrap().to_owned());
        rest = &rest[end + 1..];
    }
    GrayImage::from_raw(fields[1].parse().unwrap(), fields[2].parse().unwrap(), rest.to_vec()).unwrap()
}

fn read_segments(path: &Path) -> Vec<Ends> {
    let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let parse = |line: &str| {
        let v: Vec<f32> = line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        Ends { start: Vector2::new(v[0], v[1]), end: Vector2::new(v[2], v[3]) }
    };
    text.lines().map(parse).collect()
}

/// Whether `other` is the same segment: its midpoint within 2 px across, 2 degrees of direction, and half of
/// the shorter one's length in common.
fn same(segment: &Ends, other: &Ends) -> bool {
    let (length, other_length) = (segment.length(), other.length());
    let (d, e) = ((segment.end - segment.start) / length, (other.end - other.start) / other_length);
    let across = d.perp(&((other.start + other.end) * 0.5 - segment.start)).abs();
    let mut along = [other.start, other.end].map(|end| d.dot(&(end - segment.start)));
    along.sort_by(f32::total_cmp);
    let overlap = along[1].min(length) - along[0].max(0.0);
    across <= 2.0 && d.perp(&e).abs() <= 2f32.to_radians().sin() && overlap >= 0.5 * length.min(other_length)
}

/// The share of the long ones of `segments` that are among `others`.
fn share_found(segments: &[Ends], others: &[Ends]) -> f64 {
    let long = || segments.iter().filter(|segment| segment.length() > MIN_LENGTH_PX);
    let n_found = long().filter(|segment| others.iter().any(|other| same(segment, other))).count();
    n_found as f64 / long().count() as f64
}

/// Holds our segments of an image against those of the reference, each way.
fn assert_agreement(name: &str, image: &GrayImage, expected: &[Ends]) {
    let mut found = Vec::new();
    Lsd::new(0.8).detect(image, &Gradients::default(), &mut found);
    let (recall, precision) = (share_found(expected, &found), share_found(&found, expected));
    println!(
        "{name}: {} segments, {} in the reference; {recall:.3} of those found, {precision:.3} of ours there",
        found.len(),
        expected.len()
    );
    assert!(recall >= 0.9 && precision >= 0.9, "{name}: {recall:.3}, {precision:.3}");
}

#[test]
fn segments_agree_with_the_reference() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/lsd"));
    for name in ["icl_of_kt0_0001", "icl_of_kt3_0001", "tartanair_100", "tum_fr3_sntf_000"] {
        let image = read_image(&folder.join(format!("{name}.png")));
        assert_agreement(name, &image, &read_segments(&folder.join(format!("{name}.lsd.txt"))));
    }
}

/// Images whose terms do not let them be in the tree.
#[test]
#[ignore = "needs recordings: set MONOSLAM_DATA"]
fn segments_of_recordings_agree_with_the_reference() {
    let folder = recordings::find_folder("components/lsd_1.6_reference").unwrap_or_else(|e| panic!("{e}"));
    for name in ["euroc_v1_01_b_000", "kitti_snippet_1_000", "redkitchen_285"] {
        let image = read_pgm(&folder.join(format!("{name}.pgm")));
        assert_agreement(name, &image, &read_segments(&folder.join(format!("{name}.lsd.txt"))));
    }
}
