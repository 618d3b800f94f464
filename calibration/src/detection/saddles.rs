//! Saddles of the gray levels: places where two dark and two bright squares meet.

use super::DetectionConfig;
use geometry::nalgebra::Vector2;
use vision::GrayImage;

/// Standard deviation of the blur before second derivatives, pixels.
const BLUR_PX: f32 = 1.2;
/// Radius of the circle on which the squares around a saddle are told apart, pixels.
const RING_PX: f32 = 3.5;
/// Places on it.
const N_RING: usize = 24;
/// Candidates for each corner of the board: the rest of a room has saddles too.
const CANDIDATES_PER_CORNER: usize = 12;

/// A place where four squares meet.
#[derive(Clone, Copy, Debug)]
pub struct Saddle {
    /// Where it is, pixels.
    pub place: Vector2<f64>,
    /// Angles of the four edges that leave it, radians, rising, over one turn.
    pub edges: [f64; 4],
    /// Angle of the middle of a bright square, radians, modulo half a turn.
    pub bright: f64,
    /// How strong it is.
    pub strength: f32,
}

/// The strongest saddles of an image, strongest first.
pub fn find(image: &GrayImage, config: &DetectionConfig, n_corners: usize) -> Vec<Saddle> {
    let plane = Plane::blurred(image);
    let (width, height) = (plane.width, plane.height);
    let margin = RING_PX.ceil() as usize + 2;
    if width <= 2 * margin || height <= 2 * margin {
        return Vec::new();
    }
    let mut strengths = vec![0.0f32; width * height];
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            strengths[y * width + x] = plane.saddle_strength(x, y);
        }
    }
    let mut peaks = Vec::new();
    for y in margin..height - margin {
        for x in margin..width - margin {
            let strength = strengths[y * width + x];
            if strength > 0.0 && is_peak(&strengths, width, x, y) {
                peaks.push((strength, x, y));
            }
        }
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.2, a.1).cmp(&(b.2, b.1))));
    peaks.truncate(CANDIDATES_PER_CORNER * n_corners);
    peaks.into_iter().filter_map(|(strength, x, y)| plane.saddle(x, y, strength, config)).collect()
}

fn is_peak(strengths: &[f32], width: usize, x: usize, y: usize) -> bool {
    let here = strengths[y * width + x];
    let around = (y - 2..=y + 2).flat_map(|row| (x - 2..=x + 2).map(move |column| (column, row)));
    around.into_iter().all(|(column, row)| {
        let there = strengths[row * width + column];
        // Of equal ones the first counts.
        there < here || (there == here && (row, column) >= (y, x))
    })
}

/// Gray levels as numbers.
struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Plane {
    fn blurred(image: &GrayImage) -> Self {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let reach = (3.0 * BLUR_PX).ceil() as isize;
        let weights: Vec<f32> =
            (-reach..=reach).map(|i| (-0.5 * (i as f32 / BLUR_PX).powi(2)).exp()).collect();
        let sum: f32 = weights.iter().sum();
        let weights: Vec<f32> = weights.iter().map(|weight| weight / sum).collect();
        let mut rows = vec![0.0f32; width * height];
        for y in 0..height {
            let row = image.row(y as u32);
            for x in 0..width {
                let at = |i: usize| (x as isize + i as isize - reach).clamp(0, width as isize - 1) as usize;
                rows[y * width + x] =
                    weights.iter().enumerate().map(|(i, weight)| weight * f32::from(row[at(i)])).sum();
            }
        }
        let mut values = vec![0.0f32; width * height];
        for y in 0..height {
            for (i, weight) in weights.iter().enumerate() {
                let from = (y as isize + i as isize - reach).clamp(0, height as isize - 1) as usize;
                for x in 0..width {
                    values[y * width + x] += weight * rows[from * width + x];
                }
            }
        }
        Self { width, height, values }
    }

    fn at(&self, x: usize, y: usize) -> f32 {
        self.values[y * self.width + x]
    }

    /// Minus the determinant of the second derivatives: positive where the surface is a saddle.
    fn saddle_strength(&self, x: usize, y: usize) -> f32 {
        let here = 2.0 * self.at(x, y);
        let xx = self.at(x - 1, y) + self.at(x + 1, y) - here;
        let yy = self.at(x, y - 1) + self.at(x, y + 1) - here;
        let xy = 0.25
            * (self.at(x - 1, y - 1) + self.at(x + 1, y + 1) - self.at(x + 1, y - 1) - self.at(x - 1, y + 1));
        xy * xy - xx * yy
    }

    /// Between pixels; inside the image.
    fn sample(&self, x: f32, y: f32) -> f32 {
        let (left, top) = (x.floor(), y.floor());
        let (u, v) = (x - left, y - top);
        let (left, top) = (left as usize, top as usize);
        let row = |y: usize| (1.0 - u) * self.at(left, y) + u * self.at(left + 1, y);
        (1.0 - v) * row(top) + v * row(top + 1)
    }

    /// The saddle at a peak of strength, if dark and bright take turns four times around it.
    fn saddle(&self, x: usize, y: usize, strength: f32, config: &DetectionConfig) -> Option<Saddle> {
        let angle = |i: usize| std::f32::consts::TAU * i as f32 / N_RING as f32;
        let ring: Vec<f32> = (0..N_RING)
            .map(|i| self.sample(x as f32 + RING_PX * angle(i).cos(), y as f32 + RING_PX * angle(i).sin()))
            .collect();
        let (low, high) =
            ring.iter().fold((f32::MAX, f32::MIN), |(low, high), v| (low.min(*v), high.max(*v)));
        if high - low < config.min_contrast {
            return None;
        }
        let middle = 0.5 * (low + high);
        let (mut edges, mut sine, mut cosine) = (Vec::with_capacity(4), 0.0, 0.0);
        for i in 0..N_RING {
            let (here, next) = (ring[i] - middle, ring[(i + 1) % N_RING] - middle);
            if (here < 0.0) != (next < 0.0) {
                let share = here / (here - next);
                edges.push(f64::from(std::f32::consts::TAU * (i as f32 + share) / N_RING as f32));
            }
            sine += here * (2.0 * angle(i)).sin();
            cosine += here * (2.0 * angle(i)).cos();
        }
        let edges: [f64; 4] = edges.try_into().ok()?;
        let bright = 0.5 * f64::from(sine.atan2(cosine));
        Some(Saddle { place: Vector2::new(x as f64, y as f64), edges, bright, strength })
    }
}
