//! Where an edge lies, by the image's own sharpness: smoothing blends edges that run close beside each other,
//! so that those of a thin frame push each other apart.

use nalgebra::Vector2;

use crate::lines::Segment;
use crate::lines::sampling::Sampler;

/// Distance of a profile's places, pixels.
const STEP_PX: f32 = 0.5;
/// The gradient is taken over so many of them: over less, edges along the pixels' rows seem to lie where
/// pixels meet (to 0.3 pixels); over more, edges that are near blend.
const GRADIENT_STEPS: usize = 3;
/// An edge is moved by so many places at most: what is found farther is another one.
const MAX_MOVE: usize = 2;
/// Places of a profile, as many on either side of the segment.
const N_PLACES: usize = 2 * (MAX_MOVE + 1) + GRADIENT_STEPS + 1;
/// Most samples along the edge at each place of a profile.
const MAX_SAMPLES: usize = 32;
/// A maximum weaker than this is noise, gray levels per pixel.
const MIN_GRADIENT: f32 = 1.5;

/// The segment, moved and turned to the maxima of the gradient of the unsmoothed image, averaged along each
/// half of it. As it was where there is none near, or part of it is outside of the image.
pub(super) fn sharpen(image: &Sampler, segment: &Segment) -> Segment {
    let quarter = segment.vector() * 0.25;
    let normal = segment.normal();
    let offset = |center: Vector2<f32>| offset(image, center, quarter, normal);
    let middle = segment.midpoint();
    let Some((first, second)) = offset(middle - quarter).zip(offset(middle + quarter)) else {
        return *segment;
    };
    // The halves' centers lie a quarter from the middle: the ends move by as much again as those differ.
    let (mean, slope) = ((first + second) / 2.0, second - first);
    Segment {
        start: segment.start + normal * (mean - slope),
        end: segment.end + normal * (mean + slope),
        ..*segment
    }
}

/// How far the edge lies from the line through `center`, towards `normal`, pixels; `half` is half the vector
/// along it.
fn offset(image: &Sampler, center: Vector2<f32>, half: Vector2<f32>, normal: Vector2<f32>) -> Option<f32> {
    let n = (2.0 * half.norm()).ceil().clamp(4.0, MAX_SAMPLES as f32) as usize;
    let step = half * (2.0 / n as f32);
    let first = center - half + step * 0.5;
    let mut profile = [0.0; N_PLACES];
    let mut samples = [0.0; MAX_SAMPLES];
    for (place, level) in profile.iter_mut().enumerate() {
        let across = normal * (STEP_PX * (place as f32 - 0.5 * (N_PLACES - 1) as f32));
        if !image.path(first + across, step, &mut samples[..n]) {
            return None;
        }
        *level = samples[..n].iter().sum::<f32>() / n as f32;
    }
    peak_offset(&profile)
}

/// Where the gradient of a profile has the maximum nearest to its middle, pixels from there.
fn peak_offset(profile: &[f32; N_PLACES]) -> Option<f32> {
    const MIDDLE: usize = MAX_MOVE + 1;
    let gradient =
        |at: usize| (profile[at + GRADIENT_STEPS] - profile[at]) / (STEP_PX * GRADIENT_STEPS as f32);
    let mut at = MIDDLE;
    while at < MIDDLE + MAX_MOVE && gradient(at + 1) > gradient(at) {
        at += 1;
    }
    while at > MIDDLE - MAX_MOVE && gradient(at - 1) > gradient(at) {
        at -= 1;
    }
    let [before, peak, after] = [gradient(at - 1), gradient(at), gradient(at + 1)];
    if peak < MIN_GRADIENT || before > peak || after > peak {
        return None;
    }
    let curvature = before - 2.0 * peak + after;
    let fraction = if curvature < -1e-6 { 0.5 * (before - after) / curvature } else { 0.0 };
    Some(STEP_PX * (at as f32 - MIDDLE as f32 + fraction))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GrayImage;
    use crate::test_images::Random;

    /// A dark bar of this width on a bright ground, its left edge through the image's center, with noise.
    fn bar(width_px: f32, degrees: f32, noise: f32) -> (GrayImage, Segment) {
        const SUBPIXELS: u32 = 16;
        let normal = Vector2::new(degrees.to_radians().cos(), degrees.to_radians().sin());
        let center = Vector2::new(40.2, 39.7);
        let mut random = Random::new(5);
        let image = GrayImage::from_fn(80, 80, |x, y| {
            let subpixels = (0..SUBPIXELS * SUBPIXELS).map(|i| Vector2::new(i % SUBPIXELS, i / SUBPIXELS));
            let n_dark = subpixels
                .map(|at| at.cast::<f32>().add_scalar(0.5) / SUBPIXELS as f32)
                .map(|at| Vector2::new(x as f32, y as f32) + at.add_scalar(-0.5))
                .filter(|at| (0.0..width_px).contains(&normal.dot(&(at - center))))
                .count();
            let level = 150.0 - 60.0 * n_dark as f32 / (SUBPIXELS * SUBPIXELS) as f32;
            (level + noise * (random.unit() - 0.5)) as u8
        });
        // The brighter side, against `normal`, is to the right.
        let along = Vector2::new(-normal.y, normal.x) * 25.0;
        let edge = Segment { start: center - along, end: center + along, sigma_px: 0.3, gradient: 20.0 };
        (image, edge)
    }

    fn moved(segment: &Segment, ends: [f32; 2]) -> Segment {
        let normal = segment.normal();
        Segment { start: segment.start + normal * ends[0], end: segment.end + normal * ends[1], ..*segment }
    }

    #[test]
    fn the_edges_of_thin_bars_are_where_they_are() {
        for width_px in [2.0, 2.5, 4.0, 20.0] {
            for degrees in [0.0, 7.0, 30.0, 45.0, 78.0, 90.0, 163.0, 251.0] {
                let (image, edge) = bar(width_px, degrees, 6.0);
                for ends in [[0.3, 0.3], [0.4, -0.2], [-0.1, 0.5]] {
                    let found = sharpen(&Sampler::new(&image), &moved(&edge, ends));
                    let off = edge.distance(&found.start).abs().max(edge.distance(&found.end).abs());
                    assert!(off < 0.15, "{width_px} px wide at {degrees} degrees: {off} px off");
                }
            }
        }
    }

    #[test]
    fn where_there_is_nothing_to_go_by_a_segment_stays() {
        let (image, edge) = bar(20.0, 30.0, 0.0);
        let plain = GrayImage::from_fn(80, 80, |_, _| 90);
        assert_eq!(sharpen(&Sampler::new(&plain), &edge), edge);
        let outside = Segment { start: edge.start, end: edge.end * 4.0, ..edge };
        assert_eq!(sharpen(&Sampler::new(&image), &outside), outside);
        let of_no_length = Segment { end: edge.start, ..edge };
        assert!(sharpen(&Sampler::new(&image), &of_no_length).is_finite());
        assert_eq!(sharpen(&Sampler::new(&GrayImage::default()), &edge), edge);
    }
}
