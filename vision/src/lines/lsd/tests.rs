//! Agreement with the outputs of the reference implementation, and the parts' own tests.

use std::path::Path;

use nalgebra::Vector2;

use super::*;

/// Segments shorter than this are left out of the comparison, pixels.
const MIN_LENGTH_PX: f32 = 20.0;

fn read_pgm(path: &Path) -> Option<GrayImage> {
    let bytes = std::fs::read(path).ok()?;
    let mut fields = Vec::new();
    let mut rest = bytes.as_slice();
    while fields.len() < 4 {
        let end = rest.iter().position(u8::is_ascii_whitespace)?;
        fields.push(std::str::from_utf8(&rest[..end]).ok()?.to_owned());
        rest = &rest[end + 1..];
    }
    GrayImage::from_raw(fields[1].parse().ok()?, fields[2].parse().ok()?, rest.to_vec()).ok()
}

fn read_segments(path: &Path) -> Option<Vec<Ends>> {
    let text = std::fs::read_to_string(path).ok()?;
    let parse = |line: &str| {
        let v: Vec<f32> = line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        Ends { start: Vector2::new(v[0], v[1]), end: Vector2::new(v[2], v[3]) }
    };
    Some(text.lines().map(parse).collect())
}

/// Whether `other` is the same segment: its midpoint within 2 px across, 2 degrees of direction, and half of the shorter
/// one's length in common.
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

#[test]
fn segments_agree_with_the_reference() {
    let folder =
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data/components/lsd_1.6_reference"));
    let names = [
        "euroc_v1_01_b_000",
        "icl_of_kt0_0001",
        "icl_of_kt3_0001",
        "kitti_snippet_1_000",
        "redkitchen_285",
        "tartanair_100",
        "tum_fr3_sntf_000",
    ];
    let mut detector = Lsd::new(0.8);
    for name in names {
        let image = read_pgm(&folder.join(format!("{name}.pgm")));
        let expected = read_segments(&folder.join(format!("{name}.lsd.txt")));
        let (Some(image), Some(expected)) = (image, expected) else {
            println!("no reference outputs for {name}: not compared");
            continue;
        };
        let mut found = Vec::new();
        detector.detect(&image, &Gradients::default(), &mut found);
        let (recall, precision) = (share_found(&expected, &found), share_found(&found, &expected));
        println!(
            "{name}: {} segments, {} in the reference; {recall:.3} of those found, {precision:.3} of ours there",
            found.len(),
            expected.len()
        );
        assert!(recall >= 0.9 && precision >= 0.9, "{name}: {recall:.3}, {precision:.3}");
    }
}
