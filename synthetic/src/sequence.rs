//! A world seen along a path: frames and everything that is true of them.

use std::str::FromStr;
use std::sync::Arc;

use geometry::{Camera, CameraError, CameraModel, CameraParameters, Pose};
use nalgebra::{Vector2, Vector3};

use crate::image::GrayImage;
use crate::path::{Jitter, MotionLimits, Path, PathConfig, PathKind};
use crate::random::mix;
use crate::render::{ExposureCurve, RenderOptions, Renderer};
use crate::segments::{self, VisibleSegment};
use crate::world::{
    AtlantaConfig, CorridorConfig, CorridorShape, FourRoomsConfig, RayHit, RoomConfig, Texture,
    UnstructuredConfig, World, WorldConfig,
};

/// Timestamp of the first frame, so that no timestamp is zero.
const START_NS: i64 = 1_000_000_000_000;

/// A sequence that is ready made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Preset {
    /// A furnished room with texture everywhere; a full circle around the table in the middle.
    RoomRich,
    /// The same with plain paint.
    RoomPoor,
    /// A walk of about 50 units down a plain corridor.
    CorridorStraight,
    /// A plain corridor around a block, 48 units long, walked one and a quarter times.
    CorridorRing,
    /// A walk of about 50 units along three sides of a block of plain corridors, without coming back, with a
    /// wide lens, a noisy sensor and a changing exposure: the walls that were in view are gone after each
    /// corner.
    CorridorCorners,
    /// Through four rooms and back into the first two.
    FourRooms,
    /// A plain hall with blocks in three horizontal directions.
    Atlanta,
    /// A cave without parallel edges.
    Unstructured,
    /// A straight corridor, each stretch of which looks like all others.
    LookAlike,
}

impl Preset {
    /// All presets.
    pub const ALL: [Self; 9] = [
        Self::RoomRich,
        Self::RoomPoor,
        Self::CorridorStraight,
        Self::CorridorRing,
        Self::CorridorCorners,
        Self::FourRooms,
        Self::Atlanta,
        Self::Unstructured,
        Self::LookAlike,
    ];

    /// The name users write, such as `room-rich`.
    pub fn name(self) -> &'static str {
        match self {
            Self::RoomRich => "room-rich",
            Self::RoomPoor => "room-poor",
            Self::CorridorStraight => "corridor-straight",
            Self::CorridorRing => "corridor-ring",
            Self::CorridorCorners => "corridor-corners",
            Self::FourRooms => "four-rooms",
            Self::Atlanta => "atlanta",
            Self::Unstructured => "unstructured",
            Self::LookAlike => "look-alike",
        }
    }
}

/// A name that is no preset's.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownPreset(
    /// The name.
    pub String,
);

impl std::fmt::Display for UnknownPreset {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let known = Preset::ALL.map(Preset::name).join(", ");
        write!(f, "there is no preset {:?}; there are {known}", self.0)
    }
}

impl std::error::Error for UnknownPreset {}

impl FromStr for Preset {
    type Err = UnknownPreset;

    fn from_str(name: &str) -> Result<Self, UnknownPreset> {
        Self::ALL
            .into_iter()
            .find(|preset| preset.name() == name)
            .ok_or_else(|| UnknownPreset(name.to_owned()))
    }
}

/// Everything a sequence is made from.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceConfig {
    /// The world.
    pub world: WorldConfig,
    /// The camera's path through it.
    pub path: PathConfig,
    /// The camera.
    pub camera: CameraParameters,
    /// Frames per second.
    pub fps: f64,
    /// Number of frames. `None`: as many as the path lasts.
    pub n_frames: Option<usize>,
    /// Sensor and quality.
    pub render: RenderOptions,
    /// Seed of the sensor's noise.
    pub seed: u64,
}

impl SequenceConfig {
    /// The configuration of a preset, to be changed before [`Sequence::new`]. All presets have a pinhole
    /// camera of 640 x 480 pixels at 20 frames a second, 70 degrees wide; 90 where there are corners to walk
    /// around.
    pub fn preset(preset: Preset, seed: u64) -> Self {
        let (world, kind, limits) = preset_parts(preset, seed);
        // Around a corner a lens of 70 degrees sees nothing but a plain wall.
        let focal_px = if preset == Preset::CorridorCorners { 320.0 } else { 460.0 };
        let jitter = Some(Jitter { position: 0.004, rotation_deg: 0.35 });
        Self {
            world,
            path: PathConfig { kind, limits, jitter, seed },
            camera: CameraParameters {
                model: CameraModel::Pinhole,
                width: 640,
                height: 480,
                fx: focal_px,
                fy: focal_px,
                cx: 319.5,
                cy: 239.5,
                distortion: Vec::new(),
            },
            fps: 20.0,
            n_frames: None,
            render: render_options(preset),
            seed,
        }
    }
}

fn render_options(preset: Preset) -> RenderOptions {
    match preset {
        Preset::CorridorCorners => RenderOptions {
            noise_sigma: 4.0,
            exposure: ExposureCurve::Swing { amplitude: 0.2, period_s: 9.0 },
            ..RenderOptions::default()
        },
        _ => RenderOptions::default(),
    }
}

fn preset_parts(preset: Preset, seed: u64) -> (WorldConfig, PathKind, MotionLimits) {
    let room = |texture| WorldConfig::Room(RoomConfig { texture, seed, ..RoomConfig::default() });
    let orbit = |x: f64, y: f64, height: f64| PathKind::Orbit {
        middle: Vector2::zeros(),
        radius: Vector2::new(x, y),
        height,
        turns: 1.05,
        look_around_deg: 18.0,
    };
    let walk = |waypoints: Vec<Vector2<f64>>, laps, sway, look_around_deg| PathKind::Walk {
        waypoints,
        laps,
        height: 1.5,
        sway,
        look_around_deg,
    };
    let corridor = |shape, look_alike_every| {
        WorldConfig::Corridor(CorridorConfig { shape, look_alike_every, seed, ..CorridorConfig::default() })
    };
    let calm = MotionLimits::default();
    let walking = MotionLimits { speed: 1.2, rotation_deg: 35.0 };
    let straight = CorridorShape::Straight { length: 54.0 };
    let down_the_corridor = vec![Vector2::new(1.5, 0.0), Vector2::new(51.5, 0.0)];
    match preset {
        Preset::RoomRich => (room(Texture::Rich), orbit(1.7, 1.3, 1.45), calm),
        Preset::RoomPoor => (room(Texture::Poor), orbit(1.7, 1.3, 1.45), calm),
        Preset::CorridorStraight => {
            (corridor(straight, None), walk(down_the_corridor, None, 0.3, 10.0), walking)
        }
        Preset::LookAlike => {
            (corridor(straight, Some(4.5)), walk(down_the_corridor, None, 0.3, 10.0), walking)
        }
        Preset::CorridorRing => {
            let (length_x, length_y) = (14.0, 10.0);
            let corner = |sx: f64, sy: f64| Vector2::new(0.5 * sx * length_x, 0.5 * sy * length_y);
            let waypoints = vec![
                Vector2::new(-0.2 * length_x, -0.5 * length_y),
                corner(1.0, -1.0),
                corner(1.0, 1.0),
                corner(-1.0, 1.0),
                corner(-1.0, -1.0),
            ];
            let shape = CorridorShape::Ring { length_x, length_y };
            (corridor(shape, None), walk(waypoints, Some(1.25), 0.25, 8.0), walking)
        }
        Preset::CorridorCorners => {
            let (length_x, length_y) = (22.0, 16.0);
            let waypoints = vec![
                Vector2::new(-9.0, -0.5 * length_y),
                Vector2::new(0.5 * length_x, -0.5 * length_y),
                Vector2::new(0.5 * length_x, 0.5 * length_y),
                Vector2::new(-5.0, 0.5 * length_y),
            ];
            let shape = CorridorShape::Ring { length_x, length_y };
            (corridor(shape, None), walk(waypoints, None, 0.25, 8.0), walking)
        }
        Preset::FourRooms => {
            let config = FourRoomsConfig { seed, ..FourRoomsConfig::default() };
            let middles = (0..4).map(|room| config.room_middle(room).xy()).collect();
            let limits = MotionLimits { speed: 0.7, rotation_deg: 35.0 };
            (WorldConfig::FourRooms(config), walk(middles, Some(1.3), 0.1, 30.0), limits)
        }
        Preset::Atlanta => {
            let world = WorldConfig::Atlanta(AtlantaConfig { seed, ..AtlantaConfig::default() });
            (world, orbit(1.9, 1.7, 1.5), calm)
        }
        Preset::Unstructured => {
            let world =
                WorldConfig::Unstructured(UnstructuredConfig { seed, ..UnstructuredConfig::default() });
            (world, orbit(1.2, 1.0, 0.0), calm)
        }
    }
}

/// One frame with its truth.
#[derive(Clone, Debug, PartialEq)]
pub struct SyntheticFrame {
    /// Time of the middle of the exposure, of the middle row with a rolling shutter.
    pub timestamp_ns: i64,
    /// What the camera saw.
    pub image: GrayImage,
    /// Where it was.
    pub camera_from_world: Pose,
}

/// A world seen along a path. Frames are rendered when asked for, in any order, and are always the same.
pub struct Sequence {
    renderer: Renderer,
    path: Path,
    config: SequenceConfig,
    len: usize,
}

impl Sequence {
    /// Builds world and path.
    ///
    /// # Errors
    /// If the camera is refused.
    pub fn new(config: SequenceConfig) -> Result<Self, CameraError> {
        let camera = Camera::new(config.camera.clone())?;
        let path = Path::new(&config.path);
        let renderer = Renderer::new(Arc::new(config.world.build()), camera, config.render.clone());
        let len = config.n_frames.unwrap_or((path.duration_s() * config.fps) as usize + 1);
        Ok(Self { renderer, path, config, len })
    }

    /// A ready-made sequence.
    pub fn preset(preset: Preset, seed: u64) -> Self {
        Self::new(SequenceConfig::preset(preset, seed)).expect("the camera of the presets is valid")
    }

    /// What it is made from.
    pub fn config(&self) -> &SequenceConfig {
        &self.config
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no frames.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        self.renderer.camera()
    }

    /// The world.
    pub fn world(&self) -> &World {
        self.renderer.world()
    }

    /// The path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The renderer, for views from elsewhere.
    pub fn renderer(&self) -> &Renderer {
        &self.renderer
    }

    /// Timestamp of frame `i`.
    pub fn timestamp_ns(&self, i: usize) -> i64 {
        START_NS + (self.time_s(i) * 1e9).round() as i64
    }

    /// True pose of frame `i`.
    pub fn camera_from_world(&self, i: usize) -> Pose {
        self.path.camera_from_world(self.time_s(i))
    }

    /// Renders frame `i`.
    pub fn frame(&self, i: usize) -> SyntheticFrame {
        let t_s = self.time_s(i);
        let RenderOptions { shutter_s, blur_samples, readout_s, .. } = self.config.render;
        let n = blur_samples.max(1);
        // In the middle of the image the row is exposed at the frame's time.
        let exposure = |share: f64| -> Vec<Pose> {
            let middle_s = t_s + share * readout_s;
            let blur = |k| shutter_s * ((k as f64 + 0.5) / n as f64 - 0.5);
            (0..n).map(|k| self.path.camera_from_world(middle_s + blur(k))).collect()
        };
        let noise_seed = mix(self.config.seed, i as u64);
        let image = if readout_s == 0.0 {
            self.renderer.render(&exposure(0.0), t_s, noise_seed)
        } else {
            self.renderer.render_rolling(exposure, t_s, noise_seed)
        };
        SyntheticFrame {
            timestamp_ns: self.timestamp_ns(i),
            image,
            camera_from_world: self.camera_from_world(i),
        }
    }

    /// All frames in order, each rendered when it is taken.
    pub fn frames(&self) -> impl Iterator<Item = SyntheticFrame> + '_ {
        (0..self.len).map(|i| self.frame(i))
    }

    /// `(timestamp_ns, world_from_camera)` of every frame.
    pub fn ground_truth(&self) -> Vec<(i64, Pose)> {
        (0..self.len).map(|i| (self.timestamp_ns(i), self.camera_from_world(i).inverse())).collect()
    }

    /// What is seen at `pixel` of frame `i`: the distance is along the ray, from the camera center.
    pub fn cast_pixel(&self, i: usize, pixel: &Vector2<f64>) -> Option<RayHit> {
        let world_from_camera = self.camera_from_world(i).inverse();
        let bearing = self.camera().unproject(pixel)?;
        self.world().cast_ray(&world_from_camera.translation, &(world_from_camera.rotation * bearing))
    }

    /// The z coordinate, in the camera frame, of what is seen at `pixel` of frame `i`.
    pub fn depth(&self, i: usize, pixel: &Vector2<f64>) -> Option<f64> {
        let hit = self.cast_pixel(i, pixel)?;
        Some(self.camera_from_world(i).transform(&hit.point).z)
    }

    /// Where frame `i` sees a world point; `None` outside of the image or behind something.
    pub fn observe(&self, i: usize, point_in_world: &Vector3<f64>) -> Option<Vector2<f64>> {
        let pose = self.camera_from_world(i);
        let pixel = self.camera().project(&pose.transform(point_in_world))?;
        let visible = self.camera().contains(&pixel)
            && self.world().is_visible_between(&pose.center(), point_in_world, segments::TOUCH_DISTANCE);
        visible.then_some(pixel)
    }

    /// The true segments that frame `i` sees, cut to their visible parts, in the order of their indices. One
    /// edge may be seen in several parts.
    pub fn visible_segments(&self, i: usize) -> Vec<VisibleSegment> {
        segments::visible_segments(&self.renderer, &self.camera_from_world(i))
    }

    fn time_s(&self, i: usize) -> f64 {
        i as f64 / self.config.fps
    }
}
