//! Configuration of a session. Every field has a default, a unit and a reason.

mod alignment;
mod calibration;
mod continuity;
mod lines;
mod loops;
mod primitives;
mod submaps;

pub use alignment::AlignmentConfig;
pub use calibration::CalibrationConfig;
pub use continuity::ContinuityConfig;
pub use lines::LineConfig;
pub use loops::LoopConfig;
pub use primitives::PrimitiveConfig;
pub use submaps::SubmapConfig;

use crate::features::PyramidGeometry;
use geometry::Camera;
use vision::OrbConfig;

/// How the stages of a session share the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Threading {
    /// Every stage in turn on the caller's thread: same frames and seed, same bytes out.
    Inline,
    /// Mapping runs on a thread of its own beside tracking.
    #[default]
    Background,
}

/// What a session uses beside points: the ablation of Jiang et al..
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeatureSwitches {
    /// Line segments are tracked, mapped and optimized. Default on.
    pub lines: bool,
    /// Vanishing directions are shared by keyframes as global primitives; needs `lines`. Default on.
    pub global_primitives: bool,
    /// Places seen before are recognized: loops are closed and submaps merged. Default on.
    pub loop_closing: bool,
    /// Self-calibration: focal length and principal point are checked and refined as the map grows. Default
    /// on.
    pub refine_calibration: bool,
}

impl Default for FeatureSwitches {
    fn default() -> Self {
        Self { lines: true, global_primitives: true, loop_closing: true, refine_calibration: true }
    }
}

/// Configuration of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct SlamConfig {
    /// How the stages share the machine. Default background.
    pub threading: Threading,
    /// Seed of every random choice. Default 0.
    pub seed: u64,
    /// What the session uses. Default everything.
    pub features: FeatureSwitches,
    /// Images wider than this are scaled down to it, and the calibration with them, pixels. Default 1280: the
    /// front end's time grows with the area, and corners of larger images are no better located.
    pub working_width_px: u32,
    /// Images of fewer pixels than this are worked on at twice their width and height; 0 for none. Default
    /// 160 000, half of VGA: corners are looked for in cells, patches and levels that are meant for such a
    /// size. KITTI 00 at 416 x 128: 3.6 % of the path became 0.5.
    pub enlarge_below_px: u32,
    /// The extractor of points.
    pub orb: OrbConfig,
    /// Initialization: the first map.
    pub initialization: InitializationConfig,
    /// Tracking.
    pub tracking: TrackingConfig,
    /// Relocalization.
    pub relocalization: RelocalizationConfig,
    /// When a frame is kept.
    pub keyframes: KeyframeConfig,
    /// Extending the map.
    pub mapping: MappingConfig,
    /// Line tracking and line mapping.
    pub lines: LineConfig,
    /// Global primitives: directions shared by keyframes.
    pub primitives: PrimitiveConfig,
    /// Direct (photometric) alignment, where features are lost.
    pub alignment: AlignmentConfig,
    /// Motion continuity: how far a lost camera can have moved.
    pub continuity: ContinuityConfig,
    /// Loop closing and map merging.
    pub loops: LoopConfig,
    /// Beginning submaps.
    pub submaps: SubmapConfig,
    /// Self-calibration.
    pub calibration: CalibrationConfig,
}

impl Default for SlamConfig {
    fn default() -> Self {
        Self {
            threading: Threading::default(),
            seed: 0,
            features: FeatureSwitches::default(),
            working_width_px: 1280,
            enlarge_below_px: 160_000,
            orb: OrbConfig::default(),
            initialization: InitializationConfig::default(),
            tracking: TrackingConfig::default(),
            relocalization: RelocalizationConfig::default(),
            keyframes: KeyframeConfig::default(),
            mapping: MappingConfig::default(),
            lines: LineConfig::default(),
            primitives: PrimitiveConfig::default(),
            alignment: AlignmentConfig::default(),
            continuity: ContinuityConfig::default(),
            loops: LoopConfig::default(),
            submaps: SubmapConfig::default(),
            calibration: CalibrationConfig::default(),
        }
    }
}

/// Initialization: the first map from two views.
#[derive(Clone, Debug, PartialEq)]
pub struct InitializationConfig {
    /// Features asked of the extractor while there is no map. Default 2000: matches are scarce at first.
    pub n_features: usize,
    /// Fewest keypoints a usable view has. Default 100.
    pub min_keypoints: usize,
    /// Views kept to start from; every second one goes when full. Default 30: a second of video.
    pub max_reference_views: usize,
    /// Frames that are kept to be placed once the map is good enough. Default 150: five seconds of video, 25
    /// MB.
    pub max_backfill_views: usize,
    /// Width of the keyframes' positions as a share of the scene's median depth from which a map is good
    /// enough to place older frames in, and those that were tracked in it while it was younger once more.
    /// Default 0.3: a map begun on few points believes to be wider than it is.
    pub mature_baseline_share: f64,
    /// Keyframes it must have as well. Default 5: how wide two views lie apart is known no better than their
    /// depths.
    pub mature_keyframes: usize,
    /// Pairs tried per frame: the widest usable baseline and shorter ones. Default 2, to bound the time.
    pub max_attempts_per_frame: usize,
    /// Side of the square a keypoint is looked for in is twice this, pixels at 640 wide. Default 100.
    pub search_radius_px: f64,
    /// Fewest matches two views need. Default 80.
    pub min_matches: usize,
    /// Iterations of the search for a motion. Default 300.
    pub max_iterations: usize,
    /// Fewest points the first map may have. Default 50.
    pub min_points: usize,
    /// Share of the matches that must agree with the motion found. Default 0.7.
    pub min_inlier_share: f64,
    /// A second motion whose cost over all matches is below this many times the best one's makes the pair
    /// ambiguous. Default 1.3.
    pub min_runner_up_cost_ratio: f64,
    /// Least parallax, reached by the widest fiftieth point, degrees. Default 1.0: below it depth is noise.
    pub min_parallax_deg: f64,
    /// Largest standard deviation of the direction of motion, degrees. Default 1.0: turning and moving
    /// sideways look alike over a short baseline, and a map begun on a wrong mixture of the two bends.
    pub max_direction_sigma_deg: f64,
    /// Views after which twice that is accepted, and in between and beyond in proportion. Default 90: three
    /// seconds.
    pub patience_views: usize,
    /// Share of the map's points a view between the two must confirm. Default 0.6.
    pub min_third_view_share: f64,
}

impl Default for InitializationConfig {
    fn default() -> Self {
        Self {
            n_features: 2000,
            min_keypoints: 100,
            max_reference_views: 30,
            max_backfill_views: 150,
            mature_baseline_share: 0.3,
            mature_keyframes: 5,
            max_attempts_per_frame: 2,
            search_radius_px: 100.0,
            min_matches: 80,
            max_iterations: 300,
            min_points: 50,
            min_inlier_share: 0.7,
            min_runner_up_cost_ratio: 1.3,
            min_parallax_deg: 1.0,
            max_direction_sigma_deg: 1.0,
            patience_views: 90,
            min_third_view_share: 0.6,
        }
    }
}

/// Tracking from frame to frame.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackingConfig {
    /// Radius in which a point of the last frame is looked for, pixels of its level. Default 15.
    pub motion_search_radius_px: f64,
    /// Fewer matches than this by the motion model double the radius. Default 20.
    pub min_motion_matches: usize,
    /// Fewest matches with the reference keyframe. Default 15.
    pub min_reference_matches: usize,
    /// Fewest landmarks that must agree with the first estimate of a pose. Default 6, as for a weak pose.
    pub min_first_inliers: usize,
    /// Radius in which a point of the local map is looked for, pixels of its level. Default 4.
    pub map_search_radius_px: f64,
    /// Largest angle between the direction a point was seen from and the one it is seen from now, degrees.
    /// Default 60: beyond it descriptors no longer match.
    pub max_view_angle_deg: f64,
    /// Best match's distance as a share of the second best's. Default 0.8.
    pub match_ratio: f32,
    /// Keyframes of the local map at most. Default 80.
    pub max_local_keyframes: usize,
    /// Landmarks that must agree for a good pose. Default 10: few edges and corners in general position
    /// determine a pose, and whether they do is judged by its uncertainty.
    pub min_inliers: usize,
    /// Landmarks that must agree for a weak pose; fewer and the camera is lost. Default 6: fewer
    /// agree by chance.
    pub min_weak_inliers: usize,
    /// Share of the landmarks that could be found again which a good pose needs, between `min_inliers` and
    /// `plentiful_inliers`; a weak one needs half of it. Default 0.2: true poses reach 0.3 and more, false
    /// ones 0.01.
    pub min_found_share: f64,
    /// A pose that was followed with fewer than this share of the landmarks of the frame before has to
    /// compete with poses found by descriptors alone. Default 0.6: in blur and after quick turns a wrong pose
    /// has kept half, and the right one nearly all.
    pub doubtful_kept_share: f64,
    /// How many times as many landmarks the other pose needs. Default 1.15: otherwise both are the same pose.
    pub better_pose_factor: f64,
    /// Landmarks that are enough for a good pose however many were expected, and half of it for a weak one.
    /// Default 60: in crowded places 35 have been seen to agree by chance, while blur and people in the way
    /// may hide all but some.
    pub plentiful_inliers: usize,
    /// Largest standard deviation of a good pose's attitude, degrees. Default 0.4; textured places reach
    /// 0.02.
    pub max_rotation_sigma_deg: f64,
    /// Largest standard deviation of a good pose's position, as a share of the scene's median depth. Default
    /// 0.01; textured places reach 0.0004.
    pub max_position_sigma_share: f64,
    /// How many times as uncertain as a good pose that of a keyframe may be. Default 1.5: where a camera
    /// turns from a bare wall to new texture, the pose is weak until there are landmarks, and there are none
    /// until there is a keyframe.
    pub keyframe_sigma_factor: f64,
    /// How many times as uncertain a weak pose may be; beyond it the camera is lost. Default 5.
    pub weak_sigma_factor: f64,
    /// For how long a camera that was lost is looked for where it was heading, nanoseconds. Default 0.5 s:
    /// then people have turned.
    pub max_coasting_ns: i64,
}

impl Default for TrackingConfig {
    fn default() -> Self {
        Self {
            motion_search_radius_px: 15.0,
            min_motion_matches: 20,
            min_reference_matches: 15,
            min_first_inliers: 6,
            map_search_radius_px: 4.0,
            max_view_angle_deg: 60.0,
            match_ratio: 0.8,
            max_local_keyframes: 80,
            min_inliers: 10,
            min_weak_inliers: 6,
            min_found_share: 0.2,
            doubtful_kept_share: 0.6,
            better_pose_factor: 1.15,
            plentiful_inliers: 60,
            max_rotation_sigma_deg: 0.4,
            max_position_sigma_share: 0.01,
            keyframe_sigma_factor: 1.5,
            weak_sigma_factor: 5.0,
            max_coasting_ns: 500_000_000,
        }
    }
}

/// Relocalization: finding a lost camera in the map.
#[derive(Clone, Debug, PartialEq)]
pub struct RelocalizationConfig {
    /// Places tried per frame. Default 5.
    pub max_candidates: usize,
    /// Fewest matches with a place worth a try. Default 15.
    pub min_matches: usize,
    /// The same where vanishing points tell the camera's attitude, but for a few possibilities. Default 8:
    /// two matches then give the position, and the others can agree.
    pub min_matches_with_directions: usize,
    /// Iterations of the search for a pose. Default 300.
    pub max_iterations: usize,
    /// Points that must agree with the pose found from the matches. Default 10.
    pub min_first_inliers: usize,
    /// The same where vanishing points tell the attitude. Default 6.
    pub min_first_inliers_with_directions: usize,
    /// Landmarks that must agree in the end. Default 40: a false place is worse than a lost frame.
    pub min_inliers: usize,
    /// Share of the landmarks to be expected at a place that must be found there, up to `plentiful_inliers`.
    /// Default 0.4: true places have shown 0.41 to 0.68, corners of a corridor that look alike 0.11 to 0.36.
    pub min_found_share: f64,
    /// Landmarks that are enough however many were expected. Default 200: a blurred image of a crowded place
    /// may show no more, and no two places have been seen to share as many.
    pub plentiful_inliers: usize,
}

impl Default for RelocalizationConfig {
    fn default() -> Self {
        Self {
            max_candidates: 5,
            min_matches: 15,
            min_matches_with_directions: 8,
            max_iterations: 300,
            min_first_inliers: 10,
            min_first_inliers_with_directions: 6,
            min_inliers: 40,
            min_found_share: 0.4,
            plentiful_inliers: 200,
        }
    }
}

impl RelocalizationConfig {
    /// Whether so many landmarks show a place, of those that could have been found there.
    pub(crate) fn is_enough(&self, n_inliers: usize, n_expected: usize) -> bool {
        n_inliers >= self.plentiful_inliers || n_inliers as f64 >= self.min_found_share * n_expected as f64
    }
}

/// When a frame becomes a keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct KeyframeConfig {
    /// A frame that finds less than this share of what its reference keyframe sees is kept. Default 0.9.
    pub max_tracked_share: f64,
    /// Median way that landmarks must have moved in the image since the last keyframe, as a share of its
    /// width. Default 0.025: views closer than that add work and no parallax.
    pub min_displacement: f64,
    /// A frame that finds less than this share is kept after a smaller way. Default 0.6: what is seen changes
    /// fast.
    pub urgent_tracked_share: f64,
    /// That smaller way, as a share of the image's width. Default 0.015.
    pub urgent_displacement: f64,
    /// After this way a frame is kept however much of the map it finds, as a share of the image's width.
    /// Default 0.1: points that two keyframes have made are known well once a third sees them from
    /// elsewhere.
    pub ample_displacement: f64,
    /// The same share once `max_interval_ns` have gone by. Default 0.97: a slow camera still refreshes the
    /// map.
    pub max_tracked_share_after_wait: f64,
    /// With fewer points than this found, segments ask for keyframes too. Default 100: a pose hangs on them
    /// then.
    pub plentiful_points: usize,
    /// Segments followed since the last keyframe and not yet in the map that ask for another. Default 6.
    pub min_followed_segments: usize,
    /// How many times the last keyframe's segments ask for another. Default 1.3.
    pub risen_segments_share: f64,
    /// Landmarks a keyframe must find at least. Default 10, as for a good pose.
    pub min_inliers: usize,
    /// After this time a smaller change is enough for a keyframe, nanoseconds. Default 1 s.
    pub max_interval_ns: i64,
    /// Frames after a relocalization that are not kept. Default 5: the pose settles first.
    pub settle_frames: u64,
    /// Keyframes kept per session; beyond it the most redundant one goes for each new one. Default 2000.
    pub max_keyframes: usize,
}

impl Default for KeyframeConfig {
    fn default() -> Self {
        Self {
            max_tracked_share: 0.9,
            min_displacement: 0.025,
            urgent_tracked_share: 0.6,
            urgent_displacement: 0.015,
            ample_displacement: 0.1,
            plentiful_points: 100,
            min_followed_segments: 6,
            risen_segments_share: 1.3,
            max_tracked_share_after_wait: 0.97,
            min_inliers: 10,
            max_interval_ns: 1_000_000_000,
            settle_frames: 5,
            max_keyframes: 2000,
        }
    }
}

/// Local mapping: extending and maintaining the map.
#[derive(Clone, Debug, PartialEq)]
pub struct MappingConfig {
    /// Shared points that make two keyframes neighbors. Default 15.
    pub min_covisible_points: u32,
    /// Neighbors with which new points are triangulated. Default 20.
    pub n_triangulation_neighbors: usize,
    /// Baseline as a share of the scene's median depth below which no point is made. Default 0.01.
    pub min_baseline_share: f64,
    /// Parallax below which no point is made, degrees. Default 0.7: half a pixel of error is then a tenth of
    /// the depth at usual focal lengths, and turning slowly past a bare wall gives no more.
    pub min_parallax_deg: f64,
    /// Best match's distance as a share of the second best's along the epipolar line. Default 0.8.
    pub match_ratio: f32,
    /// Neighbors into which points are fused. Default 20.
    pub n_fusion_neighbors: usize,
    /// Radius in which a duplicate of a point is looked for, pixels of its level. Default 3.
    pub fusion_radius_px: f64,
    /// A young point found in less than this share of the frames that should see it goes. Default 0.25.
    pub min_found_ratio: f64,
    /// Keyframes after which a point must have been seen by three. Default 2.
    pub probation_keyframes: u64,
    /// Keyframes that local bundle adjustment moves at most. Default 20, for a steady latency.
    pub max_local_keyframes: usize,
    /// Keyframes that hold the local window in place at most, those with the most shared points. Default 40.
    pub max_fixed_keyframes: usize,
    /// Iterations of local bundle adjustment before and after outliers are dropped. Default 5 and 10.
    pub local_iterations: (usize, usize),
    /// A keyframe goes when this share of its points is seen by three others as well. Default 0.9.
    pub redundant_share: f64,
}

impl Default for MappingConfig {
    fn default() -> Self {
        Self {
            min_covisible_points: 15,
            n_triangulation_neighbors: 20,
            min_baseline_share: 0.01,
            min_parallax_deg: 0.7,
            match_ratio: 0.8,
            n_fusion_neighbors: 20,
            fusion_radius_px: 3.0,
            min_found_ratio: 0.25,
            probation_keyframes: 2,
            max_local_keyframes: 20,
            max_fixed_keyframes: 40,
            local_iterations: (5, 10),
            redundant_share: 0.9,
        }
    }
}

/// How many times as wide and as high small images are worked on.
const ENLARGEMENT: u32 = 2;

/// A field of the configuration that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct ConfigError {
    /// Which field, such as `orb.n_features`.
    pub field: &'static str,
    /// What is wrong with it, in a plain sentence.
    pub reason: String,
}

impl SlamConfig {
    /// Checks that every field can be used.
    ///
    /// # Errors
    /// The first field that cannot.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let refuse = |field, reason: &str| Err(ConfigError { field, reason: reason.to_owned() });
        self.orb.validate().map_err(|error| ConfigError { field: "orb", reason: error.to_string() })?;
        if !(100..=10_000).contains(&self.orb.n_features) {
            return refuse("orb.n_features", "must be between 100 and 10000");
        }
        if !(160..=8192).contains(&self.working_width_px) {
            return refuse("working_width_px", "must be between 160 and 8192");
        }
        if self.initialization.max_reference_views == 0 || self.initialization.max_attempts_per_frame == 0 {
            return refuse("initialization.max_reference_views", "must be at least 1");
        }
        if self.tracking.min_weak_inliers < 6 || self.tracking.min_weak_inliers > self.tracking.min_inliers {
            return refuse(
                "tracking.min_weak_inliers",
                "must be at least 6 and at most tracking.min_inliers",
            );
        }
        if self.keyframes.max_keyframes < 10 {
            return refuse("keyframes.max_keyframes", "must be at least 10");
        }
        if self.loops.min_first_inliers < 3 || self.loops.min_inliers < self.loops.min_first_inliers {
            return refuse(
                "loops.min_inliers",
                "must be at least loops.min_first_inliers, which must be at least 3",
            );
        }
        self.calibration.validate()?;
        if !(self.loops.max_scale_change >= 1.0 && self.loops.max_drift_share >= 0.0) {
            return refuse(
                "loops.max_scale_change",
                "must be at least 1, and loops.max_drift_share not negative",
            );
        }
        if self.submaps.max_lost_ns < 0 || self.submaps.search_interval == 0 {
            return refuse(
                "submaps.max_lost_ns",
                "must not be negative, and submaps.search_interval at least 1",
            );
        }
        self.alignment.validate()
    }

    /// The camera the engine works with: the session's, scaled down where its images are wider than the
    /// working width, and up where they are small.
    pub fn working_camera(&self, camera: &Camera) -> Camera {
        if camera.width().saturating_mul(camera.height()) < self.enlarge_below_px
            && ENLARGEMENT * camera.width() <= self.working_width_px
        {
            return camera.scaled(f64::from(ENLARGEMENT), f64::from(ENLARGEMENT));
        }
        if camera.width() <= self.working_width_px {
            return camera.clone();
        }
        let factor = f64::from(self.working_width_px) / f64::from(camera.width());
        let height = (f64::from(camera.height()) * factor).round().max(1.0);
        camera.scaled(factor, height / f64::from(camera.height()))
    }

    /// The resolutions the extractor looks at.
    pub fn pyramid(&self) -> PyramidGeometry {
        PyramidGeometry { n_levels: self.orb.n_levels as u8, scale_factor: f64::from(self.orb.scale_factor) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{CameraModel, CameraParameters};

    fn camera(width: u32, height: u32) -> Camera {
        let (fx, fy, cx, cy) = (240.0, 241.0, 203.2, 62.7);
        let model = CameraModel::Pinhole;
        Camera::new(CameraParameters { model, width, height, fx, fy, cx, cy, distortion: Vec::new() })
            .unwrap()
    }

    #[test]
    fn small_images_are_worked_on_enlarged() {
        let config = SlamConfig::default();
        let size = |camera: &Camera| (camera.width(), camera.height());
        assert_eq!(size(&config.working_camera(&camera(416, 128))), (832, 256));
        assert_eq!(size(&config.working_camera(&camera(640, 480))), (640, 480));
        assert_eq!(size(&config.working_camera(&camera(2560, 1920))), (1280, 960));
        // A pixel's ray stays what it was.
        let (small, large) = (camera(416, 128), config.working_camera(&camera(416, 128)));
        let ray = |camera: &Camera, x, y| camera.pinhole().bearing(&geometry::nalgebra::Vector2::new(x, y));
        assert!((ray(&small, 10.0, 20.0) - ray(&large, 20.5, 40.5)).norm() < 1e-12);
        let before = SlamConfig { enlarge_below_px: 0, ..config };
        assert_eq!(size(&before.working_camera(&camera(416, 128))), (416, 128));
    }
}
