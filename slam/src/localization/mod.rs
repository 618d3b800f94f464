//! Locating single images, of any camera, in a map that does not change. [method: Relocalization]
//!
//! Descriptors tell a place apart only where it is seen at the resolution it was mapped at. So an image is
//! worked on at the size at which its focal length in pixels is the map's; what the image shows is then found
//! at the pyramid's levels where it is expected, whatever camera took it.

mod focal;

use crate::clock::{Clock, Stopwatch};
use crate::config::{SlamConfig, Threading};
use crate::features::View;
use crate::frame_result::FrameResult;
use crate::front_end::{CameraState, FrontEnd};
use crate::input::{ResumeError, SceneMask};
use crate::map::{Map, MapCamera, MapParts};
use crate::report::{FrameReport, InitializationWait, LostReason, TrackingOutcome};
use crate::tracking::{Located, Tracker};
use geometry::nalgebra::{Matrix3, Matrix6, Vector3};
use geometry::{Camera, CameraParameters};
use std::sync::Arc;
use vision::GrayImage;
use vision::lines::LineTrackingStatistics;

/// Widest image worked on, pixels: beyond it nothing more is seen that a map could know.
const MAX_WORKING_SIDE_PX: f64 = 1280.0;
/// Shortest larger side of an image worked on, pixels: with less, corners become too few.
const MIN_WORKING_SIDE_PX: f64 = 320.0;
/// Smallest side of an image worked on, pixels: what the extractor needs.
const MIN_SHORT_SIDE_PX: f64 = 96.0;
/// Focal lengths an image can have, as shares of its larger side: 150 to 10 degrees.
const FOCAL_SHARES: std::ops::RangeInclusive<f64> = 0.13..=6.0;
/// Places tried for an image, at most: nothing is known of where it was taken, and nobody waits for the next
/// frame.
const MAX_CANDIDATES: usize = 12;
/// Neighbors of each whose points are matched as well.
const N_MATCHED_NEIGHBORS: usize = 4;
/// Keypoints asked of the extractor, as a multiple of what a frame of the session has: what a map knows of a
/// place is a part of what can be found there, and it is not always the strongest corners.
const MORE_FEATURES: usize = 2;
/// A focal length that was found anew and differs by less, as a share, is as good as it was.
const SAME_FOCAL: f64 = 0.004;
/// Looks at an image with a focal length that is found better each time, at most.
const MAX_FOCAL_ROUNDS: usize = 3;

/// Which camera took an image.
#[derive(Clone, Debug, PartialEq)]
pub enum LocalizeCamera {
    /// The map's own.
    Session,
    /// This one.
    Given(Box<Camera>),
    /// Nobody knows: square pixels, no distortion, and the principal point in the middle are assumed, and the
    /// focal length is found.
    Unknown,
}

/// Where to look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// Where the camera is thought to be, map units.
    pub position: Vector3<f64>,
    /// How far it may be from there, map units.
    pub radius: f64,
}

/// What came of an image.
#[derive(Clone, Debug)]
pub struct Found {
    /// Its pose, or why there is none.
    pub report: FrameReport,
    /// Covariance of the position, map units, and of the attitude, radians about the world's axes: noise of
    /// the image alone.
    pub covariance: Option<Matrix6<f64>>,
    /// The camera it was located with, of the image's own size; `None` if none was found for it.
    pub camera: Option<CameraParameters>,
}

/// Locates images in one map.
pub struct Localizer {
    config: SlamConfig,
    camera: Camera,
    /// What of the session's own images is not the scene.
    mask: Option<SceneMask>,
    map: Map,
    tracker: Tracker,
    clock: Arc<dyn Clock>,
}

/// One look at an image.
struct Look {
    view: View,
    located: Located,
    stopwatch: Stopwatch,
    statistics: LineTrackingStatistics,
}

impl Localizer {
    /// For a stored map of a camera; takes as long as the map is large.
    ///
    /// # Errors
    /// If the configuration cannot be used or the map is inconsistent.
    pub fn new(
        config: SlamConfig,
        camera: Camera,
        mask: Option<SceneMask>,
        map: MapParts,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, ResumeError> {
        config.validate()?;
        let mut config = SlamConfig { threading: Threading::Inline, ..config };
        config.relocalization.max_candidates = config.relocalization.max_candidates.max(MAX_CANDIDATES);
        config.relocalization.n_matched_neighbors = N_MATCHED_NEIGHBORS;
        config.orb.n_features *= MORE_FEATURES;
        let map = Map::from_parts(map)?;
        let mut tracker =
            Tracker::new(config.clone(), MapCamera::default(), config.working_camera(&camera), None)?;
        tracker.sync_map(&map);
        Ok(Self { config, camera, mask, map, tracker, clock })
    }

    /// The map.
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// Locates an image. The same image gives the same answer, whatever was asked before.
    ///
    /// # Errors
    /// If the engine cannot work with such a camera.
    pub fn locate(
        &mut self,
        image: &GrayImage,
        camera: &LocalizeCamera,
        near: Option<Near>,
    ) -> Result<Found, ResumeError> {
        if self.map.n_keyframes() == 0 {
            return Ok(self.nowhere(TrackingOutcome::Initialising(InitializationWait::MappingDisabled)));
        }
        match camera {
            LocalizeCamera::Session => {
                let own = self.camera.with_correction(self.map.correction());
                let look = self.look(image, &self.camera.clone(), &self.config.clone(), true, near)?;
                Ok(self.found(look, Some(own.corrected_parameters())))
            }
            LocalizeCamera::Given(camera) => {
                let look = self.look_with(image, camera, near)?;
                Ok(self.found(look, Some(camera.corrected_parameters())))
            }
            LocalizeCamera::Unknown => self.locate_unknown(image, near),
        }
    }

    fn locate_unknown(&mut self, image: &GrayImage, near: Option<Near>) -> Result<Found, ResumeError> {
        let mut best: Option<(Look, Camera)> = None;
        for focal_px in self.guess_focals(image, near)? {
            let Some((look, camera)) = self.settle_focal(image, focal_px, near)? else { continue };
            let n = look.located.n_inliers();
            if best.as_ref().is_none_or(|(other, _)| n > other.located.n_inliers()) {
                best = Some((look, camera));
            }
            // The guesses are in the order of what speaks for them.
            if best.as_ref().is_some_and(|(look, _)| look.located.is_tracked()) {
                break;
            }
        }
        let Some((look, camera)) = best else {
            let n_candidates = self.tracker.n_places_tried();
            return Ok(self.nowhere(TrackingOutcome::Lost(LostReason::NotRelocalized { n_candidates })));
        };
        let parameters = camera.corrected_parameters();
        Ok(self.found(look, Some(parameters)))
    }

    /// Looks with a focal length, then with that which suits what was found, until it stays.
    fn settle_focal(
        &mut self,
        image: &GrayImage,
        mut focal_px: f64,
        near: Option<Near>,
    ) -> Result<Option<(Look, Camera)>, ResumeError> {
        let mut best: Option<(Look, Camera)> = None;
        for _ in 0..MAX_FOCAL_ROUNDS {
            let Some(camera) = simple_camera(image, focal_px) else { break };
            let look = self.look_with(image, &camera, near)?;
            let Some(frame) = &look.located.frame else { break };
            let better = focal::refine(frame, &self.map, &look.view.features.pinhole);
            let n = look.located.n_inliers();
            if best.as_ref().is_none_or(|(other, _)| n >= other.located.n_inliers()) {
                best = Some((look, camera));
            }
            let Some(factor) = better.filter(|factor| (factor - 1.0).abs() > SAME_FOCAL) else { break };
            focal_px *= factor;
        }
        Ok(best)
    }

    /// The configuration for images of other cameras, which are worked on at the size they were brought to.
    fn config_of_others(&self) -> SlamConfig {
        SlamConfig {
            working_width_px: 8192,
            enlarge_below_px: 0,
            enlarge_for_border: false,
            ..self.config.clone()
        }
    }

    /// Looks at an image of another camera, at the size that suits the map.
    fn look_with(
        &mut self,
        image: &GrayImage,
        camera: &Camera,
        near: Option<Near>,
    ) -> Result<Look, ResumeError> {
        let scaled = self.at_map_resolution(camera);
        let config = self.config_of_others();
        self.look(image, &scaled, &config, false, near)
    }

    fn look(
        &mut self,
        image: &GrayImage,
        camera: &Camera,
        config: &SlamConfig,
        is_own: bool,
        near: Option<Near>,
    ) -> Result<Look, ResumeError> {
        let mut stopwatch = Stopwatch::start(self.clock.clone());
        let (view, statistics) = self.view(image, camera, config, is_own, &mut stopwatch)?;
        let located = self.tracker.locate(&view, &self.map, near.map(|near| (near.position, near.radius)));
        stopwatch.lap("relocalise");
        Ok(Look { view, located, stopwatch, statistics })
    }

    fn view(
        &self,
        image: &GrayImage,
        camera: &Camera,
        config: &SlamConfig,
        is_own: bool,
        stopwatch: &mut Stopwatch,
    ) -> Result<(View, LineTrackingStatistics), ResumeError> {
        let mask = self.mask.clone().filter(|_| is_own);
        let mut front_end = FrontEnd::new(config, camera, 0, mask)?;
        if is_own {
            front_end.correct_camera(self.map.correction());
        }
        front_end.set_camera_state(CameraState::Lost);
        let working = Arc::new(front_end.working_image(image.clone()));
        let (features, statistics) = front_end.extract(&working, None, stopwatch);
        let mut view = View { sequence: 0, timestamp_ns: 0, features: Arc::new(features) };
        if is_own {
            view.correct_camera(&self.map.correction());
        }
        Ok((view, statistics))
    }

    /// The camera of an image resized so that its focal length is the map's, as far as that is of use.
    fn at_map_resolution(&self, camera: &Camera) -> Camera {
        let wanted = self.map_focal_px() / camera.pinhole().mean_focal_px();
        let (width, height) = (f64::from(camera.width()), f64::from(camera.height()));
        let (long, short) = (width.max(height), width.min(height));
        let least = (MIN_WORKING_SIDE_PX / long).max(MIN_SHORT_SIDE_PX / short);
        // Small sides must be there even where long ones are then too long.
        let factor = wanted.min(MAX_WORKING_SIDE_PX / long).max(least);
        camera.scaled((width * factor).round() / width, (height * factor).round() / height)
    }

    fn map_focal_px(&self) -> f64 {
        let own = self.camera.with_correction(self.map.correction());
        self.config.working_camera(&own).pinhole().mean_focal_px()
    }

    fn found(&self, look: Look, camera: Option<CameraParameters>) -> Found {
        let Look { view, located, stopwatch, statistics } = look;
        let covariance = located.frame.as_ref().zip(located.covariance).map(|(frame, covariance)| {
            in_world(&covariance, &frame.camera_from_world.rotation.inverse().to_rotation_matrix().into())
        });
        let camera = camera.filter(|_| located.frame.is_some());
        let submap = located.frame.as_ref().map_or_else(Default::default, |frame| frame.submap);
        let result = FrameResult::from(located.into_tracked());
        let report = result.into_report(&view, submap, statistics, Vec::new(), stopwatch.finish());
        Found { report, covariance, camera }
    }

    fn nowhere(&self, outcome: TrackingOutcome) -> Found {
        let stopwatch = Stopwatch::start(self.clock.clone());
        let features = crate::features::FrameFeatures::from_parts(
            Vec::new(),
            Vec::new(),
            &self.config.working_camera(&self.camera),
            self.config.pyramid(),
        );
        let features = features.map(Arc::new).expect("nothing has no place where the lens model ends");
        let view = View { sequence: 0, timestamp_ns: 0, features };
        let result = FrameResult::nowhere(outcome);
        let statistics = LineTrackingStatistics::default();
        let report =
            result.into_report(&view, Default::default(), statistics, Vec::new(), stopwatch.finish());
        Found { report, covariance: None, camera: None }
    }
}

/// A camera of an image that nothing is known of but a focal length.
fn simple_camera(image: &GrayImage, focal_px: f64) -> Option<Camera> {
    let (width, height) = (image.width(), image.height());
    if !FOCAL_SHARES.contains(&(focal_px / f64::from(width.max(height)))) {
        return None;
    }
    Camera::new(CameraParameters::of_focal_length(width, height, focal_px)).ok()
}

/// From the tangent of `camera_from_world`, turn before shift, to position and attitude in the world.
fn in_world(covariance: &Matrix6<f64>, world_from_camera: &Matrix3<f64>) -> Matrix6<f64> {
    // The center is -Rᵀt; a turn on the left of the pose leaves it where it is.
    let mut jacobian = Matrix6::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-world_from_camera);
    jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&-world_from_camera);
    jacobian * covariance * jacobian.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pose;
    use geometry::nalgebra::{UnitQuaternion, Vector6};

    #[test]
    fn a_perturbed_pose_moves_its_center_and_axes_as_the_covariance_says() {
        let rotation = UnitQuaternion::from_euler_angles(0.3, -0.8, 1.1);
        let pose = Pose::new(rotation, Vector3::new(0.4, -2.0, 0.7));
        let world_from_camera: Matrix3<f64> = rotation.inverse().to_rotation_matrix().into();
        let delta = Vector6::new(1e-6, -2e-6, 3e-6, 2e-6, 1e-6, -4e-6);
        let moved = pose.retract(&delta);
        let shift = moved.center() - pose.center();
        let turn = (moved.rotation.inverse() * pose.rotation).scaled_axis();
        let predicted = in_world(&(delta * delta.transpose()), &world_from_camera);
        let actual = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
        assert!((predicted - actual * actual.transpose()).norm() < 1e-16, "{predicted}");
    }
}
