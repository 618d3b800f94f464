//! Where an edge lies, by the image's own sharpness: smoothing blends edges that run close beside each other, so that
//! those of a thin frame push each other apart.

use nalgebra::Vector2;

use crate::lines::Segment;
use crate::lines::sampling::Sampler;

/// Distance of a profile's places, pixels.
const STEP_PX: f32 = 0.5;
/// Places of a profile to either side of the segment.
const REACH: usize = 5;
const N_PLACES: usize = 2 * REACH + 1;
/// Most samples along the edge at each place of a profile.
const MAX_SAMPLES: usize = 32;
/// An edge is moved by this at most, in places: what is found farther is another one.
const MAX_MOVE: usize = 2;
/// A maximum weaker than this is noise, grey levels per pixel.
const MIN_GRADIENT: f32 = 1.5;

/// The segment, moved and turned to the maxima of the gradient of the unsmoothed image, averaged along each half of it.
/// As it was where there is none near, or part of it is outside of the image.
pub(super) fn sharpen(image: &Sampler, segment: &Segment) -> Segment {
    let quarter = segment.vector() * 0.25;
    let normal = segment.normal();
    let offset = |centre: Vector2<f32>| offset(image, centre, quarter, normal);
    let middle = segment.midpoint();
    let Some((first, second)) = offset(middle - quarter).zip(offset(middle + quarter)) else {
        return *segment;
    };
    // The halves' centres lie a quarter from the middle: the ends move by as much again as those differ.
    let (mean, slope) = ((first + second) / 2.0, second - first);
    Segment {
        start: segment.start + normal * (mean - slope),
        end: segment.end + normal * (mean + slope),
        ..*segment
    }
}

/// How far the edge lies from the line through `centre`, towards `normal`, pixels; `half` is half the vector along it.
fn offset(image: &Sampler, centre: Vector2<f32>, half: Vector2<f32>, normal: Vector2<f32>) -> Option<f32> {
    let n = (2.0 * half.norm()).ceil().clamp(4.0, MAX_SAMPLES as f32) as usize;
    let step = half * (2.0 / n as f32);
    let first = centre - half + step * 0.5;
    let mut profile = [0.0; N_PLACES];
    let mut samples = [0.0; MAX_SAMPLES];
    for (place, level) in profile.iter_mut().enumerate() {
        let across = normal * (STEP_PX * (place as f32 - REACH as f32));
        if !image.path(first + across, step, &mut samples[..n]) {
            return None;
        }
        *level = samples[..n].iter().sum::<f32>() / n as f32;
    }
    let gradient = |place: usize| (profile[place + 1] - profile[place - 1]) / (2.0 * STEP_PX);
    let mut at = REACH;
    while at < REACH + MAX_MOVE && gradient(at + 1) > gradient(at) {
        at += 1;
    }
    while at > REACH - MAX_MOVE && gradient(at - 1) > gradient(at) {
        at -= 1;
    }
    let [before, peak, after] = [gradient(at - 1), gradient(at), gradient(at + 1)];
    if peak < MIN_GRADIENT || before > peak || after > peak {
        return None;
    }
    let curvature = before - 2.0 * peak + after;
    let fraction = if curvature < -1e-6 { 0.5 * (before - after) / curvature } else { 0.0 };
    Some(STEP_PX * (at as f32 - REACH as f32 + fraction))
}
