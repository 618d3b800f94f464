//! Seeded maps made by hand, and updates between them.

use geometry::{Camera, CameraModel, CameraParameters, Direction, Line3, Pose};
use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};
use slam::features::{FrameFeatures, LineFeature};
use slam::map::{
    CameraId, FramePose, FrameRecord, FrameState, GlobalPrimitive, KeyframeId, LastIds, LineId, LineLandmark,
    MapChanges, MapParts, Observation, PointId, PointLandmark, PrimitiveId, PrimitiveObservation, SubmapId,
    VanishingObservation,
};
use slam::{Keyframe, Map, MapUpdate, SlamConfig};
use std::sync::Arc;
use vision::{Descriptor, Keypoint};

/// A small generator of numbers that are the same everywhere (SplitMix64).
pub struct Numbers(
    /// Where it begins.
    pub u64,
);

impl Numbers {
    /// The next 64.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [-1, 1).
    pub fn signed(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// Three of them, times the scale.
    pub fn vector(&mut self, scale: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.signed() * scale)
    }

    /// Anywhere within some units of the origin, turned in any way.
    pub fn pose(&mut self) -> Pose {
        let rotation = UnitQuaternion::from_scaled_axis(self.vector(1.0));
        Pose::new(rotation, self.vector(3.0))
    }
}

/// The camera of all maps: with lens distortion.
pub fn camera() -> CameraParameters {
    let distortion = vec![-0.283, 0.0739, 0.000194, 1.76e-5];
    let (fx, fy, cx, cy) = (458.654, 457.296, 367.215, 248.375);
    CameraParameters { model: CameraModel::Radtan, width: 752, height: 480, fx, fy, cx, cy, distortion }
}

/// A keyframe's id.
pub fn kf(id: u64) -> KeyframeId {
    KeyframeId::new(id).unwrap()
}

/// A point's id.
pub fn pt(id: u64) -> PointId {
    PointId::new(id).unwrap()
}

/// A line's id.
pub fn ln(id: u64) -> LineId {
    LineId::new(id).unwrap()
}

/// A primitive's id.
pub fn pr(id: u64) -> PrimitiveId {
    PrimitiveId::new(id).unwrap()
}

fn features(numbers: &mut Numbers, n: usize) -> Arc<FrameFeatures> {
    let config = SlamConfig::default();
    let camera = config.working_camera(&Camera::new(camera()).unwrap());
    let keypoints = (0..n)
        .map(|_| Keypoint {
            x: (376.0 + 350.0 * numbers.signed()) as f32,
            y: (240.0 + 220.0 * numbers.signed()) as f32,
            octave: (numbers.bits() % 8) as u8,
            angle: (numbers.bits() % 360) as f32 * 0.017,
            response: (numbers.bits() % 100) as f32,
        })
        .collect();
    let descriptors = (0..n).map(|_| Descriptor(std::array::from_fn(|_| numbers.bits()))).collect();
    Arc::new(FrameFeatures::from_parts(keypoints, descriptors, &camera, config.pyramid()).unwrap())
}

/// How large a map is.
#[derive(Clone, Copy)]
pub struct Size {
    /// Keyframes.
    pub n_keyframes: u64,
    /// Keypoints of each.
    pub n_keypoints: usize,
    /// Points of the map.
    pub n_points: u64,
}

/// Enough for every kind of landmark.
pub const SMALL: Size = Size { n_keyframes: 6, n_keypoints: 80, n_points: 60 };

/// A consistent map: each point is seen by two to four neighboring keyframes, which hang on one another in
/// a chain.
pub fn parts(seed: u64, size: Size) -> MapParts {
    let mut numbers = Numbers(seed);
    let keyframes = (1..=size.n_keyframes).map(|id| {
        let features = features(&mut numbers, size.n_keypoints);
        let parent = (id > 1).then(|| kf(id - 1));
        Keyframe::from_parts(
            kf(id),
            SubmapId(0),
            id * 10,
            id as i64 * 500_000_000,
            numbers.pose(),
            features,
            parent,
        )
    });
    let mut parts = MapParts {
        keyframes: keyframes.collect(),
        last_ids: LastIds { keyframe: size.n_keyframes, point: size.n_points, ..LastIds::default() },
        ..MapParts::default()
    };
    for id in 1..=size.n_points {
        let point = point(&mut numbers, &mut parts.keyframes, pt(id));
        parts.points.push(point);
    }
    parts
}

/// A new point seen by free keypoints of two to four neighboring keyframes.
pub fn point(numbers: &mut Numbers, keyframes: &mut [Keyframe], id: PointId) -> PointLandmark {
    let n_seen = 2 + (numbers.bits() % 3) as usize;
    let first = (numbers.bits() % (keyframes.len() - n_seen + 1) as u64) as usize;
    let mut observations = Vec::new();
    for keyframe in &mut keyframes[first..first + n_seen] {
        if let Some(free) = keyframe.points.iter().position(Option::is_none) {
            keyframe.points[free] = Some(id);
            observations.push(Observation { keyframe: keyframe.id, feature_idx: free as u32 });
        }
    }
    assert!(observations.len() >= 2, "the world is too full for another point");
    let distance = 2.0 + numbers.signed();
    PointLandmark {
        id,
        submap: SubmapId(0),
        position: numbers.vector(5.0),
        descriptor: Descriptor(std::array::from_fn(|_| numbers.bits())),
        mean_view_direction: numbers.vector(1.0).normalize(),
        distance_range: (distance / 3.58, distance),
        created_by: observations[0].keyframe,
        observations,
        n_visible: 5 + (numbers.bits() % 9) as u32,
        n_found: 2 + (numbers.bits() % 3) as u32,
    }
}

/// Segments of each keyframe of a structured map, a third of them for each of its vanishing points.
const N_SEGMENTS: u32 = 30;
/// Primitives of a structured map. The last is seen by no keyframe yet.
const N_PRIMITIVES: u64 = 4;
/// Lines of a structured map.
pub const N_LINES: u64 = 25;

/// A map as [`parts`] makes it, with segments, vanishing points, lines and primitives.
pub fn structured(seed: u64, size: Size) -> MapParts {
    let mut parts = parts(seed, size);
    let mut numbers = Numbers(seed ^ 0x51);
    for id in 1..=N_PRIMITIVES {
        parts.primitives.push(GlobalPrimitive {
            id: pr(id),
            submap: SubmapId(0),
            direction: Direction::new(numbers.vector(1.0)).unwrap(),
            covariance: Matrix3::from_fn(|_, _| 1e-5 * numbers.signed()),
            created_by: kf(id.min(size.n_keyframes)),
            observations: Vec::new(),
        });
    }
    for keyframe in &mut parts.keyframes {
        add_structure(&mut numbers, keyframe, &mut parts.primitives);
    }
    for id in 1..=N_LINES {
        let line = line(&mut numbers, &mut parts.keyframes, ln(id));
        parts.lines.push(line);
    }
    parts.last_ids = LastIds { line: N_LINES, primitive: N_PRIMITIVES, ..parts.last_ids };
    parts
}

/// Gives a keyframe segments and three vanishing points, of which the first two show primitives.
fn add_structure(numbers: &mut Numbers, keyframe: &mut Keyframe, primitives: &mut [GlobalPrimitive]) {
    let segments = (0..N_SEGMENTS).map(|_| LineFeature {
        start: Vector2::from_fn(|_, _| 300.0 + 300.0 * numbers.signed()),
        end: Vector2::from_fn(|_, _| 300.0 + 300.0 * numbers.signed()),
        sigma_px: 0.5 + 0.4 * numbers.signed(),
        descriptor: Descriptor(std::array::from_fn(|_| numbers.bits())),
        track: numbers.bits(),
    });
    let features = FrameFeatures::clone(&keyframe.features).with_lines(segments.collect());
    keyframe.features = Arc::new(features);
    keyframe.lines = vec![None; N_SEGMENTS as usize];
    for idx in 0..3 {
        let primitive = (idx < 2).then(|| pr(1 + (keyframe.id.get() + u64::from(idx)) % (N_PRIMITIVES - 1)));
        keyframe.vanishing.push(VanishingObservation {
            direction: numbers.vector(1.0).normalize(),
            covariance: Matrix3::from_fn(|_, _| 1e-4 * numbers.signed()),
            segments: (0..N_SEGMENTS).filter(|segment| segment % 3 == idx).rev().collect(),
            primitive,
        });
        if let Some(id) = primitive {
            let seen = PrimitiveObservation { keyframe: keyframe.id, vanishing_idx: idx };
            primitives[id.get() as usize - 1].observations.push(seen);
        }
    }
}

/// A new line seen by free segments of two to four neighboring keyframes; two in three have a primitive.
pub fn line(numbers: &mut Numbers, keyframes: &mut [Keyframe], id: LineId) -> LineLandmark {
    let n_seen = 2 + (numbers.bits() % 3) as usize;
    let first = (numbers.bits() % (keyframes.len() - n_seen + 1) as u64) as usize;
    let mut observations = Vec::new();
    for keyframe in &mut keyframes[first..first + n_seen] {
        if let Some(free) = keyframe.lines.iter().position(Option::is_none) {
            keyframe.lines[free] = Some(id);
            observations.push(Observation { keyframe: keyframe.id, feature_idx: free as u32 });
        }
    }
    assert!(observations.len() >= 2, "the world is too full for another line");
    let endpoints = [numbers.vector(5.0), numbers.vector(5.0)];
    LineLandmark {
        id,
        submap: SubmapId(0),
        line: Line3::from_points(&endpoints[0], &endpoints[1]).unwrap(),
        endpoints,
        descriptor: Descriptor(std::array::from_fn(|_| numbers.bits())),
        created_by: observations[0].keyframe,
        observations,
        n_visible: 6 + (numbers.bits() % 9) as u32,
        n_found: 2 + (numbers.bits() % 3) as u32,
        primitive: PrimitiveId::new(id.get() % 3),
    }
}

/// Shifts a line with its ends.
pub fn move_line(line: &mut LineLandmark, step: Vector3<f64>) {
    line.endpoints = line.endpoints.map(|end| end + step);
    line.line = Line3::from_points(&line.endpoints[0], &line.endpoints[1]).unwrap();
}

/// Takes a point out of the parts.
pub fn remove_point(parts: &mut MapParts, id: PointId) {
    parts.points.retain(|point| point.id != id);
    for slot in parts.keyframes.iter_mut().flat_map(|keyframe| &mut keyframe.points) {
        if *slot == Some(id) {
            *slot = None;
        }
    }
}

/// The map of these parts.
pub fn map(parts: &MapParts) -> Arc<Map> {
    Arc::new(Map::from_parts(parts.clone()).unwrap())
}

/// Everything in the parts is new.
pub fn all_new(parts: &MapParts) -> MapChanges {
    MapChanges {
        keyframes: parts.keyframes.iter().map(|keyframe| keyframe.id).collect(),
        points: parts.points.iter().map(|point| point.id).collect(),
        lines: parts.lines.iter().map(|line| line.id).collect(),
        primitives: parts.primitives.iter().map(|primitive| primitive.id).collect(),
        ..MapChanges::default()
    }
}

/// The whole map as one update, with a few frames.
pub fn first_update(parts: &MapParts) -> MapUpdate {
    let frames = (1..=20).map(|sequence| frame(sequence, kf(1 + sequence % 3))).collect();
    MapUpdate { map: map(parts), changes: all_new(parts), frames }
}

/// A tracked frame near a keyframe; its pose follows from its number.
pub fn frame(sequence: u64, reference: KeyframeId) -> FrameRecord {
    let camera_from_reference = Numbers(sequence).pose();
    FrameRecord {
        camera: CameraId::default(),
        sequence,
        timestamp_ns: sequence as i64 * 50_000_000,
        state: FrameState::Tracked,
        pose: Some(FramePose { submap: SubmapId(0), reference, camera_from_reference }),
        backfilled: false,
        reason: String::new(),
    }
}

/// A frame without a pose.
pub fn lost_frame(sequence: u64) -> FrameRecord {
    let reason = "too few landmarks agree with any pose".to_owned();
    FrameRecord { pose: None, state: FrameState::Lost, reason, ..frame(sequence, kf(1)) }
}

/// Compares maps to the last bit.
pub fn assert_same_parts(left: &MapParts, right: &MapParts) {
    assert_eq!(left.points, right.points);
    assert_eq!(left.lines, right.lines);
    assert_eq!(left.primitives, right.primitives);
    assert_eq!(left.removed_keyframes, right.removed_keyframes);
    assert_eq!(left.last_ids, right.last_ids);
    assert_eq!(left.keyframes.len(), right.keyframes.len());
    for (a, b) in left.keyframes.iter().zip(&right.keyframes) {
        assert_eq!(
            (a.id, a.submap, a.sequence, a.timestamp_ns),
            (b.id, b.submap, b.sequence, b.timestamp_ns)
        );
        assert_eq!((a.camera_from_world, a.parent), (b.camera_from_world, b.parent));
        assert_eq!(a.points, b.points);
        assert_eq!((&a.lines, &a.vanishing), (&b.lines, &b.vanishing));
        assert_eq!(a.features.lines, b.features.lines);
        assert_eq!(a.features.keypoints, b.features.keypoints);
        assert_eq!(a.features.descriptors, b.features.descriptors);
        assert_eq!(a.features.undistorted, b.features.undistorted);
        assert_eq!((a.features.pinhole, a.features.pyramid), (b.features.pinhole, b.features.pyramid));
    }
}
