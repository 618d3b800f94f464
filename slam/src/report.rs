//! What came of one frame: values with the measurements beside the thresholds they were held against.

use crate::features::FrameFeatures;
use crate::map::{FrameState, KeyframeId, LineId, PointId, PrimitiveId, Readout, SubmapId};
use geometry::nalgebra::Vector3;
use geometry::{CameraCorrection, Pose};
use std::fmt;
use std::sync::Arc;
use vision::lines::LineTrackingStatistics;

/// Why there is no map yet. Its text is written for the person who holds the camera.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum InitializationWait {
    /// The first usable frame was kept; motion is needed.
    #[error("first view kept; move the camera sideways")]
    FirstView,
    /// The session has no map and the stream may not make one.
    #[error("there is no map yet and this stream may only localise")]
    MappingDisabled,
    /// The image has too few corners.
    #[error(
        "too few features: {n_keypoints} keypoints, {n_required} needed; point the camera at more texture"
    )]
    TooFewFeatures {
        /// Keypoints found.
        n_keypoints: usize,
        /// Keypoints needed.
        n_required: usize,
    },
    /// The image has too little in common with the kept views.
    #[error("too few matches: {n_matches} with the best earlier view, {n_required} needed; move more slowly")]
    TooFewMatches {
        /// Matches with the best kept view.
        n_matches: usize,
        /// Matches needed.
        n_required: usize,
    },
    /// The camera has hardly moved, or only turned.
    #[error(
        "too little parallax: {parallax_deg:.2} degrees, {required_deg:.2} needed; move sideways, do not only turn"
    )]
    TooLittleParallax {
        /// Parallax of the best hypothesis, degrees.
        parallax_deg: f64,
        /// Parallax needed, degrees.
        required_deg: f64,
    },
    /// The matches do not pin the direction of motion down.
    #[error(
        "uncertain motion: its direction is known to {direction_sigma_deg:.1} degrees, {required_deg:.1} needed; move \
         further sideways"
    )]
    UncertainMotion {
        /// Standard deviation of the direction of motion, degrees.
        direction_sigma_deg: f64,
        /// Standard deviation needed, degrees.
        required_deg: f64,
    },
    /// Two motions explain the images equally well, or none does.
    #[error(
        "ambiguous motion: {n_agreeing} of {n_matches} matches agree with one motion and {n_runner_up} with another"
    )]
    Ambiguous {
        /// Matches that agree with the best motion.
        n_agreeing: usize,
        /// Matches that agree with the second best.
        n_runner_up: usize,
        /// Matches in all.
        n_matches: usize,
    },
}

/// Why a frame has no pose although there is a map.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LostReason {
    /// The image shows nothing to hold on to.
    #[error("too few features: {n_keypoints} keypoints and {n_segments} segments, {n_required} needed")]
    TooFewFeatures {
        /// Keypoints found.
        n_keypoints: usize,
        /// Line segments found.
        n_segments: usize,
        /// Features needed.
        n_required: usize,
    },
    /// Too few landmarks were found again.
    #[error("too few landmarks found again: {n_inliers}, {n_required} needed")]
    TooFewInliers {
        /// Landmarks that agree with the best pose.
        n_inliers: usize,
        /// Landmarks needed.
        n_required: usize,
    },
    /// The landmarks found again leave the pose open.
    #[error("the landmarks found again do not determine the pose: uncertain by {uncertainty}")]
    Undetermined {
        /// How well they determine it.
        uncertainty: PoseUncertainty,
    },
    /// No place in the map looks like the image.
    #[error("looking for a known place: {n_candidates} candidates, none fits")]
    NotRelocalized {
        /// Places that were tried.
        n_candidates: usize,
    },
}

/// How well a frame's landmarks determine its pose: standard deviations along the worst determined
/// directions, as far as noise of the image alone is concerned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseUncertainty {
    /// Of the attitude, radians.
    pub rotation_rad: f64,
    /// Of the position, as a share of the median depth of what the frame sees.
    pub position_share: f64,
}

impl PoseUncertainty {
    /// Of a pose that the landmarks leave open.
    pub const UNDETERMINED: Self = Self { rotation_rad: f64::INFINITY, position_share: f64::INFINITY };
}

impl fmt::Display for PoseUncertainty {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (degrees, percent) = (self.rotation_rad.to_degrees(), 100.0 * self.position_share);
        write!(f, "{degrees:.2} degrees and {percent:.2} % of the distance of what is seen")
    }
}

/// What tracking one frame came to. Losing track is an outcome, not an error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrackingOutcome {
    /// There is no map yet.
    Initialising(InitializationWait),
    /// The pose is good.
    Tracked,
    /// The pose is poorly determined: no keyframe may rest on it.
    Weak {
        /// Landmarks that agree with the pose.
        n_inliers: usize,
        /// Landmarks a good pose needs.
        n_required: usize,
        /// How well they determine it.
        uncertainty: PoseUncertainty,
    },
    /// The pose is good in a map that contradicts the calibration it was made with: the map is bent.
    CalibrationContradicted,
    /// There is no pose.
    Lost(LostReason),
}

impl TrackingOutcome {
    /// The outcome in one word.
    pub fn state(&self) -> FrameState {
        match self {
            Self::Initialising(_) => FrameState::Initialising,
            Self::Tracked => FrameState::Tracked,
            Self::Weak { .. } | Self::CalibrationContradicted => FrameState::Weak,
            Self::Lost(_) => FrameState::Lost,
        }
    }

    /// The reason in a plain sentence; empty for a good pose.
    pub fn reason(&self) -> String {
        match self {
            Self::Initialising(wait) => wait.to_string(),
            Self::Tracked => String::new(),
            Self::Weak { n_inliers, n_required, uncertainty } => {
                format!(
                    "weak pose: {n_inliers} landmarks agree, {n_required} needed for a good one; uncertain by {uncertainty}"
                )
            }
            Self::CalibrationContradicted => "the images contradict the calibration, so the map is bent: is it that of \
                                              another camera, or of images of another size? Give the right one, or \
                                              let the session find it (wide self-calibration)"
                .to_owned(),
            Self::Lost(reason) => reason.to_string(),
        }
    }
}

/// A correction of the map: by a place that was seen again, or of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MapEvent {
    /// A loop within a submap was closed.
    LoopClosed {
        /// The keyframe that shows the place again.
        keyframe: KeyframeId,
        /// The keyframe that showed it before.
        matched: KeyframeId,
        /// Points of the place found in the keyframe.
        n_matches: usize,
        /// Scale of the place as it was first mapped, over that at which it was mapped again: the drift of
        /// the scale.
        scale: f64,
    },
    /// Two submaps became one.
    SubmapsMerged {
        /// The keyframe that shows the place.
        keyframe: KeyframeId,
        /// The keyframe of the other submap that shows it.
        matched: KeyframeId,
        /// The submap that is part of the other one now.
        absorbed: SubmapId,
        /// The submap whose frame of reference remains.
        surviving: SubmapId,
        /// Points of the place found in the keyframe.
        n_matches: usize,
    },
    /// The camera differs from its calibration by this much, and the map was adjusted to it.
    CalibrationRefined {
        /// Against the calibration as it was given.
        correction: CameraCorrection,
        /// Standard deviation of the focal length, as a share of it.
        focal_sigma: f64,
    },
    /// The camera was not calibrated, and how it has moved so far does not tell its focal length: straight
    /// ahead, turning only, or before something flat. The map is bent as far as the focal length is wrong.
    CalibrationUndetermined {
        /// Standard deviation of the focal length, as a share of it.
        focal_sigma: f64,
    },
    /// The camera reads the rows of an image one after the other, and takes so long: that is taken out of
    /// what it sees, and the map was adjusted to it.
    ReadoutFound(Readout),
    /// The images contradict the calibration by more than it can be wrong by: it is used as it was given. The
    /// lens may be described wrongly, or the images may have been resized or cropped.
    CalibrationContradicted {
        /// The camera that would fit the images best.
        correction: CameraCorrection,
    },
}

impl MapEvent {
    /// The keyframe that shows the place again, and the one that showed it before, if it is about a place.
    pub fn keyframes(&self) -> Option<(KeyframeId, KeyframeId)> {
        match self {
            Self::LoopClosed { keyframe, matched, .. } | Self::SubmapsMerged { keyframe, matched, .. } => {
                Some((*keyframe, *matched))
            }
            _ => None,
        }
    }

    /// Points of the place that were found again.
    pub fn n_matches(&self) -> usize {
        match self {
            Self::LoopClosed { n_matches, .. } | Self::SubmapsMerged { n_matches, .. } => *n_matches,
            _ => 0,
        }
    }

    /// The submap that became part of another one, and that one.
    pub fn submaps(&self) -> Option<(SubmapId, SubmapId)> {
        match self {
            Self::SubmapsMerged { absorbed, surviving, .. } => Some((*absorbed, *surviving)),
            _ => None,
        }
    }

    /// How the camera that fits the images best differs from its calibration, and whether it is used.
    pub fn camera(&self) -> Option<(CameraCorrection, bool)> {
        match self {
            Self::CalibrationRefined { correction, .. } => Some((*correction, true)),
            Self::CalibrationContradicted { correction } => Some((*correction, false)),
            _ => None,
        }
    }

    /// How long the camera takes to read an image, where that was found.
    pub fn readout(&self) -> Option<Readout> {
        match self {
            Self::ReadoutFound(readout) => Some(*readout),
            _ => None,
        }
    }

    /// How well the focal length is known, as a share of it, where that was found.
    pub fn focal_sigma(&self) -> Option<f64> {
        match self {
            Self::CalibrationRefined { focal_sigma, .. } | Self::CalibrationUndetermined { focal_sigma } => {
                Some(*focal_sigma)
            }
            _ => None,
        }
    }
}

/// Wall time a named stage took. The stage `lines` may run beside `points`, on a thread of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageTime {
    /// Name of the stage, such as `extract`.
    pub name: &'static str,
    /// Wall time, nanoseconds.
    pub wall_ns: u64,
}

/// What came of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameReport {
    /// The client's number of the frame.
    pub sequence: u64,
    /// The client's time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// How tracking ended.
    pub outcome: TrackingOutcome,
    /// The camera's pose in the world, where there is one; map units.
    pub world_from_camera: Option<Pose>,
    /// The submap the pose is in.
    pub submap: SubmapId,
    /// Keypoints found in the image.
    pub n_keypoints: usize,
    /// Segments followed into the image or begun in it.
    pub n_segments: usize,
    /// What became of the last image's segments and of those detected, reason by reason.
    pub line_tracking: LineTrackingStatistics,
    /// Points that agree with the pose.
    pub n_inlier_points: usize,
    /// Lines that agree with the pose.
    pub n_inlier_lines: usize,
    /// The frame became a keyframe.
    pub is_keyframe: bool,
    /// The pose was found by recognizing the place, not by following the motion.
    pub relocalized: bool,
    /// Places that were tried to find the camera, if it had to be looked for; the stage `relocalize` tells
    /// how long.
    pub n_relocalization_candidates: Option<usize>,
    /// Corrections of the map that took effect with this frame.
    pub map_events: Vec<MapEvent>,
    /// Wall times by stage in the order they ran; empty without a clock.
    pub stages: Vec<StageTime>,
    /// Wall time of the whole frame on the tracking thread, nanoseconds; 0 without a clock.
    pub wall_ns: u64,
    /// CPU time of the tracking thread, nanoseconds; 0 without a clock.
    pub cpu_ns: u64,
}

/// What the last frame measured and what of it was recognized, to be shown to people.
#[derive(Clone, Debug)]
pub struct ObservedFrame {
    /// The client's number of the frame.
    pub sequence: u64,
    /// What the front end measured.
    pub features: Arc<FrameFeatures>,
    /// The point each keypoint was matched to; all `None` while there is no pose.
    pub points: Vec<Option<PointId>>,
    /// The line each segment was matched to, likewise.
    pub lines: Vec<Option<LineId>>,
    /// The primitive each segment is known to run along, likewise.
    pub primitives: Vec<Option<PrimitiveId>>,
}

/// Whether a candidate line entered the map, or which test, in this order, turned it away.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LineVerdict {
    /// The line is in the map.
    Made,
    /// The views do not determine its depth.
    UncertainDepth,
    /// It is much farther away than the rest of the scene.
    TooFar,
    /// Too few views show a segment where it projects.
    Reprojection,
    /// Too few of those left see it from the side.
    Sensitivity,
    /// Too few of those left show the same part of it.
    Overlap,
}

impl LineVerdict {
    /// The verdict in one word, such as `uncertain_depth`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Made => "made",
            Self::UncertainDepth => "uncertain_depth",
            Self::TooFar => "too_far",
            Self::Reprojection => "reprojection",
            Self::Sensitivity => "sensitivity",
            Self::Overlap => "overlap",
        }
    }
}

/// What mapping made of a track of segments at a keyframe. One refused is judged again when the track has
/// grown.
#[derive(Clone, Debug, PartialEq)]
pub struct LineJudgement {
    /// The client's number of the frame whose keyframe brought the newest view.
    pub sequence: u64,
    /// The submap it is in.
    pub submap: SubmapId,
    /// Number of the track.
    pub track: u64,
    /// Ends of the candidate in the keyframe's camera, map units: the world may be corrected later.
    pub endpoints_in_camera: [Vector3<f64>; 2],
    /// What came of it.
    pub verdict: LineVerdict,
}
