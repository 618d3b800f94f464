//! Smooth camera paths.
//!
//! A path is drawn as dense samples of position and heading, timed so that no limit is exceeded, resampled at
//! equal times and used as the control points of a cubic B-spline. The spline is twice continuously
//! differentiable, and its derivatives are averages of the differences of its control points, so that it
//! keeps the limits.

use std::f64::consts::TAU;

use geometry::Pose;
use nalgebra::{Matrix3, SVector, UnitQuaternion, Vector2, Vector3};
use rand::Rng;

use crate::random::stream;
use crate::spline::UniformSpline;

/// The plan of a path. Heights are above the floor.
#[derive(Clone, Debug, PartialEq)]
pub enum PathKind {
    /// An ellipse around `middle`, looking across it: sideways motion throughout, which suits initialization.
    Orbit {
        /// Middle of the ellipse.
        middle: Vector2<f64>,
        /// Semi-axes along x and y.
        radius: Vector2<f64>,
        /// Mean height of the camera.
        height: f64,
        /// Number of times around.
        turns: f64,
        /// Amplitude of looking left and right of the middle.
        look_around_deg: f64,
    },
    /// A walk along a polyline, looking ahead, with a sideways sway.
    Walk {
        /// Corners of the polyline.
        waypoints: Vec<Vector2<f64>>,
        /// How many times around the closed polyline; `None` walks the open one once.
        laps: Option<f64>,
        /// Height of the camera.
        height: f64,
        /// Amplitude of the sway to either side.
        sway: f64,
        /// Amplitude of looking left and right of the way ahead.
        look_around_deg: f64,
    },
    /// Parallel strips over a rectangle, always looking towards `yaw_deg` (0 is +x, 90 is +y).
    Lawnmower {
        /// Corner with the least coordinates.
        low: Vector2<f64>,
        /// Corner with the greatest coordinates.
        high: Vector2<f64>,
        /// Distance between strips, which run along x.
        spacing: f64,
        /// Height of the camera.
        height: f64,
        /// Heading.
        yaw_deg: f64,
    },
}

/// What the camera's motion never exceeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionLimits {
    /// Map units per second.
    pub speed: f64,
    /// Degrees per second.
    pub rotation_deg: f64,
}

impl Default for MotionLimits {
    /// A calm hand: faster turns blur and lose features in most recordings.
    fn default() -> Self {
        Self { speed: 0.6, rotation_deg: 35.0 }
    }
}

/// The shake of a hand-held camera, as sums of sines between 0.5 and 2.5 Hz.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jitter {
    /// Greatest displacement along each axis.
    pub position: f64,
    /// Greatest rotation about each axis.
    pub rotation_deg: f64,
}

/// What a path is made from.
#[derive(Clone, Debug, PartialEq)]
pub struct PathConfig {
    /// The plan.
    pub kind: PathKind,
    /// Limits of speed and rotation, jitter included.
    pub limits: MotionLimits,
    /// Shake of the hand, if any.
    pub jitter: Option<Jitter>,
    /// Seed of phases and jitter.
    pub seed: u64,
}

/// A camera path, twice continuously differentiable in time.
#[derive(Clone, Debug)]
pub struct Path {
    /// Position, yaw and pitch.
    spline: UniformSpline<5>,
    /// Sines for three displacements and three rotations.
    jitter: Vec<[Sine; 3]>,
}

#[derive(Clone, Copy, Debug)]
struct Sine {
    amplitude: f64,
    rate_rad_s: f64,
    phase: f64,
}

/// Time between control points.
const KNOT_S: f64 = 0.25;
/// Length of the dense samples' steps.
const STEP: f64 = 0.02;
/// The way ahead is taken this far before and behind the camera.
const LOOK_AHEAD: f64 = 0.9;
/// Turns and slow stretches are spread over this many steps.
const SMOOTHING_STEPS: usize = 40;

type Sample = SVector<f64, 5>;

impl Path {
    /// Draws the path.
    ///
    /// # Panics
    /// If a walk has fewer than two waypoints, or the jitter alone exceeds the limits.
    pub fn new(config: &PathConfig) -> Self {
        let samples = config.kind.samples(config.seed);
        let jitter = config.jitter.map_or_else(Vec::new, |jitter| jitter.sines(config.seed));
        let shake = |axes: &[[Sine; 3]]| {
            axes.iter()
                .map(|axis| axis.iter().map(|s| s.amplitude * s.rate_rad_s).sum::<f64>().powi(2))
                .sum::<f64>()
        };
        let speed = config.limits.speed - shake(&jitter[..jitter.len() / 2]).sqrt();
        let rotation = config.limits.rotation_deg.to_radians() - shake(&jitter[jitter.len() / 2..]).sqrt();
        assert!(speed > 0.0 && rotation > 0.0, "the jitter alone exceeds the limits of motion");
        Self { spline: UniformSpline::new(&retime(&samples, speed, rotation)), jitter }
    }

    /// How long it takes.
    pub fn duration_s(&self) -> f64 {
        self.spline.n_spans() as f64 * KNOT_S
    }

    /// Where the camera is `t_s` seconds after the start; before and after the path it stands still, but for
    /// the jitter.
    pub fn camera_from_world(&self, t_s: f64) -> Pose {
        let state = self.spline.at(t_s / KNOT_S);
        let shake = |axis: usize| {
            self.jitter.get(axis).map_or(0.0, |sines| {
                sines.iter().map(|s| s.amplitude * (s.rate_rad_s * t_s + s.phase).sin()).sum()
            })
        };
        let rotation = look_along(state[3], state[4])
            * UnitQuaternion::from_scaled_axis(Vector3::new(shake(3), shake(4), shake(5)));
        let position = state.fixed_rows::<3>(0) + Vector3::new(shake(0), shake(1), shake(2));
        Pose::new(rotation, position).inverse()
    }
}

/// `world_from_camera` rotation of a level camera that looks `yaw` from +x towards +y and `pitch` up.
fn look_along(yaw: f64, pitch: f64) -> UnitQuaternion<f64> {
    let forward = Vector3::new(yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin());
    let right = Vector3::new(yaw.sin(), -yaw.cos(), 0.0);
    let down = forward.cross(&right);
    UnitQuaternion::from_matrix(&Matrix3::from_columns(&[right, down, forward]))
}

impl Jitter {
    fn sines(&self, seed: u64) -> Vec<[Sine; 3]> {
        let mut rng = stream(seed, "jitter");
        let amplitudes = [self.position, self.rotation_deg.to_radians()];
        (0..6)
            .map(|axis| {
                [(0.6, 0.5..0.9), (0.3, 0.9..1.6), (0.1, 1.6..2.5)].map(|(share, hertz)| Sine {
                    amplitude: amplitudes[axis / 3] * share,
                    rate_rad_s: TAU * rng.random_range(hertz),
                    phase: rng.random_range(0.0..TAU),
                })
            })
            .collect()
    }
}

impl PathKind {
    /// Dense samples, about [`STEP`] apart, with continuous yaw.
    fn samples(&self, seed: u64) -> Vec<Sample> {
        let mut rng = stream(seed, "path");
        let phases: [f64; 3] = std::array::from_fn(|_| rng.random_range(0.0..TAU));
        match self {
            Self::Orbit { middle, radius, height, turns, look_around_deg } => {
                let n = (TAU * radius.max() * turns / STEP).ceil() as usize;
                let start = phases[0];
                (0..=n)
                    .map(|i| {
                        let angle = TAU * turns * i as f64 / n as f64;
                        let around = start + angle;
                        let offset = Vector2::new(radius.x * around.cos(), radius.y * around.sin());
                        // The glances grow in from nothing, so that the start is a sideways motion.
                        let glance = look_around_deg.to_radians() * (1.7 * angle).sin();
                        let facing = unwrap((-offset.y).atan2(-offset.x), around + 0.5 * TAU) + glance;
                        let z = height + 0.12 * (2.0 * angle + phases[1]).sin();
                        let pitch = -0.12 + 0.08 * (1.3 * angle + phases[2]).sin();
                        Sample::from([middle.x + offset.x, middle.y + offset.y, z, facing, pitch])
                    })
                    .collect()
            }
            Self::Walk { waypoints, laps, height, sway, look_around_deg } => {
                let line = polyline(waypoints, *laps);
                walk(&line, *height, *sway, look_around_deg.to_radians(), &phases)
            }
            Self::Lawnmower { low, high, spacing, height, yaw_deg } => {
                let n_strips = ((high.y - low.y) / spacing).floor() as usize + 1;
                let corners: Vec<Vector2<f64>> = (0..n_strips)
                    .flat_map(|strip| {
                        let y = low.y + strip as f64 * spacing;
                        let ends = [Vector2::new(low.x, y), Vector2::new(high.x, y)];
                        if strip % 2 == 0 { ends } else { [ends[1], ends[0]] }
                    })
                    .collect();
                polyline(&corners, None)
                    .iter()
                    .map(|p| Sample::from([p.x, p.y, *height, yaw_deg.to_radians(), 0.0]))
                    .collect()
            }
        }
    }
}

/// The value of `angle` modulo a full turn that is nearest to `near`.
fn unwrap(angle: f64, near: f64) -> f64 {
    angle + TAU * ((near - angle) / TAU).round()
}

/// Points about [`STEP`] apart along a polyline.
fn polyline(waypoints: &[Vector2<f64>], laps: Option<f64>) -> Vec<Vector2<f64>> {
    assert!(waypoints.len() >= 2, "a walk needs two waypoints");
    let closed = laps.map(|_| waypoints[0]);
    let corners: Vec<Vector2<f64>> = waypoints.iter().copied().chain(closed).collect();
    let lap: Vec<Vector2<f64>> = corners
        .windows(2)
        .flat_map(|leg| {
            let (from, along) = (leg[0], leg[1] - leg[0]);
            let n = (along.norm() / STEP).ceil().max(1.0) as usize;
            (0..n).map(move |i| from + along * (i as f64 / n as f64))
        })
        .collect();
    let n = (lap.len() as f64 * laps.unwrap_or(1.0)).round() as usize;
    (0..n).map(|i| lap[i % lap.len()]).collect()
}

/// Adds heading, sway and glances to the line walked.
fn walk(line: &[Vector2<f64>], height: f64, sway: f64, look_around: f64, phases: &[f64; 3]) -> Vec<Sample> {
    let reach = (LOOK_AHEAD / STEP) as usize;
    let last = line.len() - 1;
    // Rounded corners: the mean over a window about each point, narrower near the ends.
    let rounded: Vec<Vector2<f64>> = (0..=last)
        .map(|i| {
            let r = reach.min(i).min(last - i);
            line[i - r..=i + r].iter().sum::<Vector2<f64>>() / (2 * r + 1) as f64
        })
        .collect();
    let mut yaw = 0.0;
    let mut samples = Vec::with_capacity(line.len());
    for i in 0..=last {
        let ahead = rounded[(i + reach).min(last)] - rounded[i.saturating_sub(reach)];
        let heading = ahead.y.atan2(ahead.x);
        yaw = if i == 0 { heading } else { unwrap(heading, yaw) };
        let s = i as f64 * STEP;
        let left = Vector2::new(-heading.sin(), heading.cos());
        let position = rounded[i] + left * (sway * (TAU * s / 5.0 + phases[0]).sin());
        let glance = look_around * (TAU * s / 7.3 + phases[1]).sin();
        let z = height + 0.03 * (TAU * s / 1.4 + phases[2]).sin();
        let pitch = -0.06 + 0.04 * (TAU * s / 6.1).sin();
        samples.push(Sample::from([position.x, position.y, z, yaw + glance, pitch]));
    }
    samples
}

/// Samples at equal times, no two further apart than the limits allow.
fn retime(samples: &[Sample], speed: f64, rotation: f64) -> Vec<Sample> {
    let needed: Vec<f64> = samples
        .windows(2)
        .map(|pair| {
            let step = pair[1] - pair[0];
            let moved = step.fixed_rows::<3>(0).norm() / speed;
            moved.max(step.fixed_rows::<2>(3).norm() / rotation)
        })
        .collect();
    // The greatest need within reach, then its mean over the same reach: smooth, and never too short.
    let window = |i: usize| i.saturating_sub(SMOOTHING_STEPS)..(i + SMOOTHING_STEPS + 1).min(needed.len());
    let greatest: Vec<f64> =
        (0..needed.len()).map(|i| needed[window(i)].iter().copied().fold(0.0, f64::max)).collect();
    let mut times = vec![0.0];
    for i in 0..needed.len() {
        let around = &greatest[window(i)];
        times.push(times[i] + around.iter().sum::<f64>() / around.len() as f64);
    }
    let duration = times[times.len() - 1];
    let n_knots = (duration / KNOT_S).ceil() as usize;
    let mut i = 0;
    (0..=n_knots)
        .map(|knot| {
            let t = (knot as f64 * KNOT_S).min(duration);
            while i + 2 < times.len() && times[i + 1] < t {
                i += 1;
            }
            let share = ((t - times[i]) / (times[i + 1] - times[i]).max(1e-12)).clamp(0.0, 1.0);
            samples[i].lerp(&samples[i + 1], share)
        })
        .collect()
}
