//! Configuration of self-calibration: refinement of the camera.

use super::ConfigError;
use geometry::{CameraCorrection, CameraParameters};

/// A principal point farther from the middle than this share of the image is doubtful: calibrated cameras,
/// also those of cropped images, lie within a tenth.
const MAX_CENTER_SHARE: f64 = 0.15;
/// Focal lengths outside these are doubtful, in longer sides of the image: fisheyes have 0.2, telephoto
/// lenses 5.
const MIN_FOCAL_SHARE: f64 = 0.1;
/// See [`MIN_FOCAL_SHARE`].
const MAX_FOCAL_SHARE: f64 = 20.0;

/// How far what is said of the camera is to be believed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CalibrationTrust {
    /// It was calibrated: only what the images prove is changed, and little.
    #[default]
    Given,
    /// Its focal length is known roughly, as from a field of view or a data sheet.
    Approximate,
    /// Nothing is known but the size of the image; the focal length is a guess to begin with.
    Unknown,
}

/// Self-calibration: whether and when the camera is estimated along with the map.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationConfig {
    /// How far the calibration is to be believed. Default given.
    pub trust: CalibrationTrust,
    /// Whether a calibration that was given and that the images contradict is given up for what they say.
    /// Default off: the client is told, and it is used as it was given.
    pub wide: bool,
    /// Whether the calibration that was given is doubtful by its numbers alone: then one look at the images
    /// that speaks against it is enough. Default not; [`begin_with`](Self::begin_with) sets it.
    pub suspected: bool,
    /// Standard deviation of the focal length as given, as a share of it. Default 0.01: what calibrations by
    /// hand, autofocus and warming up leave.
    pub focal_sigma: f64,
    /// Standard deviation of the principal point as given, either way, in focal lengths. Default 0.01, for
    /// the same reasons.
    pub center_sigma: f64,
    /// Standard deviation of an approximate focal length, as a share of it. Default 0.15: a field of view
    /// from a data sheet may be that of the diagonal, or of pictures where the video is cropped.
    pub approximate_focal_sigma: f64,
    /// Focal length of a camera of which nothing is known, in lengths of the image's longer side. Default
    /// 0.8: 64 degrees, between phones (0.7 to 0.85), webcams (0.8 to 1.2) and wide lenses (0.4 to 0.7).
    pub unknown_focal_share: f64,
    /// Standard deviation of the logarithm of that. Default 0.35.
    pub unknown_focal_sigma: f64,
    /// Standard deviation of the principal point from the middle of the image, either way, in focal lengths,
    /// where the camera was not calibrated. Default 0.02: calibrated cameras lie 0.5 to 3 % off.
    pub unknown_center_sigma: f64,
    /// Standard deviation of the first coefficient of radial distortion where the camera was not calibrated.
    /// Default 0.15: phones have up to 0.1, wide lenses 0.3.
    pub radial_sigma: f64,
    /// Standard deviation of the second coefficient from the square of the first. Default 0.01: more
    /// takes up errors that are not the lens's.
    pub second_radial_sigma: f64,
    /// A camera of which little was known counts as known when the standard deviation of its focal length is
    /// below this share of it. Default 0.01.
    pub known_focal_sigma: f64,
    /// What was found of such a camera is taken over if it is off from the present one by this many of its
    /// standard deviations, in any member. Default 0.15: the newer is the better one.
    pub min_move_sigmas: f64,
    /// Where a camera of which little was known moves what is seen in a corner of the image by more than
    /// this, the map is gone over for what the keyframes share, pixels. Default 4: what tracking looks for
    /// lies within that.
    pub search_again_px: f64,
    /// Two vanishing directions of a keyframe closer to perpendicular than this are taken for a right angle
    /// of a building where the camera was not calibrated, degrees. Default 20: what a focal length that is a
    /// quarter off makes of one.
    pub right_angle_gate_deg: f64,
    /// Standard deviation of such an angle beside that of the directions, degrees. Default 0.5.
    pub right_angle_sigma_deg: f64,
    /// Focal lengths are gone through in steps of this, in their logarithm. Default 0.12.
    pub search_step: f64,
    /// How far from what is known they are gone through, standard deviations. Default 2.5.
    pub search_reach: f64,
    /// Iterations at each of them. Default 6.
    pub search_iterations: usize,
    /// Going on is hopeless where the cost is above the least by this, for independent errors. Default 100.
    pub hopeless_cost: f64,
    /// Errors of keypoints count for as many times their variance as they are found to be correlated, and at
    /// least this. Default 4.
    pub least_inflation: f64,
    /// The same at most: what disagrees more is a map of another camera, and does not speak for what was
    /// known before. Default 25.
    pub most_inflation: f64,
    /// Keyframes from which on a calibration that was given is tried. Default 10.
    pub min_keyframes: usize,
    /// Keyframes from which on a camera of which little is known is looked for. Default 4: three views and
    /// one for the errors.
    pub min_keyframes_while_unknown: usize,
    /// It is tried again when there are this many times as many keyframes. Default 1.5.
    pub growth: f64,
    /// The same while little is known of the camera. Default 1.2.
    pub growth_while_unknown: f64,
    /// Keyframes beyond which it is no longer tried. Default 60: the camera is known by then, and the time
    /// that adjusting all keyframes takes grows.
    pub max_keyframes: usize,
    /// Decrease of χ² from which on the camera is in doubt. Default 10: 170 looks at rendered cameras, which
    /// are exactly as given, brought 1 in the median and 10 to 21 in one of twenty; a camera off by 1 %, 15
    /// to 29.
    pub min_gain: f64,
    /// As `least_inflation`, where a calibration is given: how far that is to be believed beside images whose
    /// errors are correlated. Default 2: `kitti_snippet_2`, seeds 0 to 4, in % of the path, 0.16 0.18 0.23
    /// 0.20 0.18; at 1, as if errors were independent, 0.17 0.26 0.32 0.15 0.25; at 4 0.26 0.13 0.14 0.26
    /// 0.24.
    pub given_inflation: f64,
    /// It must differ as well from the present camera by this many standard deviations of itself, in any
    /// member, with errors of keypoints as correlated as they turn out to be. Default 2.
    pub min_given_sigmas: f64,
    /// Decrease of χ² from which on one look is enough. Default 40: twice what any camera that was as given
    /// brought.
    pub certain_gain: f64,
    /// The same only where errors of keypoints are correlated by no more than this. Default 4: more is
    /// something that no camera describes, such as a rolling shutter, and looks have to agree.
    /// `phone_desk_first100`: 6 to 8, `kitti_snippet_2`: 2.
    pub most_certain_inflation: f64,
    /// Decrease of χ² in keyframes left out of the fit from which on they speak for the camera too. Default
    /// 2.
    pub min_held_out_gain: f64,
    /// Squared distance of the camera that fits best from the calibration, in standard deviations of both,
    /// from which on two looks in a row need not agree on it to contradict the calibration. Default 100: they
    /// agree that the calibration is that far off.
    pub gross_contradiction: f64,
    /// A camera of which little was known is called undetermined where the standard deviation of its focal
    /// length is above this share of it. Default 0.1.
    pub undetermined_focal_sigma: f64,
    /// The same, keyframes from which on that is told; at the end of a stream with fewer as well. Default 15.
    pub undetermined_keyframes: usize,
    /// How much two looks in a row may disagree, as a share of the correction, for the camera to be taken
    /// over. Default 0.33: the rendered ones among them that were in doubt twice disagreed by 0.45 and more,
    /// the camera that was off by 0.15.
    pub max_disagreement: f64,
    /// Iterations of each adjustment. Default 10.
    pub max_iterations: usize,
}

impl CalibrationConfig {
    /// Cameras with which a first map is tried: in turn what is expected and
    /// four fifths of a standard deviation to either side, if nothing is known.
    pub(crate) fn hypotheses(&self) -> Vec<CameraCorrection> {
        if self.trust != CalibrationTrust::Unknown {
            return Vec::new();
        }
        let of = |sigmas: f64| (sigmas * self.unknown_focal_sigma).exp_m1();
        let correction = |focal| CameraCorrection { focal, ..CameraCorrection::default() };
        [0.0, of(-0.8), of(0.8)].map(correction).to_vec()
    }

    /// What makes a calibration of an image of this size doubtful before any image is seen, in a sentence.
    pub fn suspicion(&self, camera: &CameraParameters) -> Option<String> {
        let CameraParameters { width, height, fx, fy, cx, cy, .. } = camera;
        let longer = f64::from(*width.max(height));
        let shares = [(cx + 0.5) / f64::from(*width), (cy + 0.5) / f64::from(*height)];
        if let Some(share) = shares.into_iter().find(|share| (share - 0.5).abs() > MAX_CENTER_SHARE) {
            return Some(format!(
                "the principal point ({cx:.1}, {cy:.1}) lies {:.0} % of the way across the image of {width} x {height} pixels, \
                 where cameras have it near the middle: is the calibration that of an image of another size?",
                100.0 * share
            ));
        }
        let (least, most) = (fx.min(*fy) / longer, fx.max(*fy) / longer);
        (least < MIN_FOCAL_SHARE || most > MAX_FOCAL_SHARE).then(|| {
            format!(
                "the focal length ({fx:.4}, {fy:.4}) is {least:.3} to {most:.3} times the longer side of the image: it must \
                 be in pixels of an image of {width} x {height}, not in millimetres"
            )
        })
    }

    /// The camera to begin with where this one was given, and how it is looked at: one that is doubtful by
    /// its numbers alone is looked at early and often, and not used at all where the images may correct it.
    #[must_use]
    pub fn begin_with(self, camera: CameraParameters) -> (CameraParameters, Self) {
        if self.trust != CalibrationTrust::Given || self.suspicion(&camera).is_none() {
            return (camera, self);
        }
        if self.wide {
            let camera = self.camera_of_size(camera.width, camera.height);
            return (camera, Self { trust: CalibrationTrust::Unknown, ..self });
        }
        let (min_keyframes, growth) = (self.min_keyframes_while_unknown, self.growth_while_unknown);
        (camera, Self { min_keyframes, growth, suspected: true, ..self })
    }

    /// The camera to begin with where nothing is known but the size of its image.
    pub fn camera_of_size(&self, width: u32, height: u32) -> CameraParameters {
        let focal_px = self.unknown_focal_share * f64::from(width.max(height));
        CameraParameters::of_focal_length(width, height, focal_px)
    }

    /// Keyframes from which on the camera is looked at.
    pub(crate) fn first_look(&self) -> usize {
        match self.trust {
            CalibrationTrust::Given => self.min_keyframes,
            CalibrationTrust::Approximate | CalibrationTrust::Unknown => self.min_keyframes_while_unknown,
        }
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let refuse = |field, reason: &str| Err(ConfigError { field, reason: reason.to_owned() });
        let sigmas = [
            ("calibration.focal_sigma", self.focal_sigma),
            ("calibration.center_sigma", self.center_sigma),
            ("calibration.approximate_focal_sigma", self.approximate_focal_sigma),
            ("calibration.unknown_focal_share", self.unknown_focal_share),
            ("calibration.unknown_focal_sigma", self.unknown_focal_sigma),
            ("calibration.unknown_center_sigma", self.unknown_center_sigma),
            ("calibration.radial_sigma", self.radial_sigma),
            ("calibration.second_radial_sigma", self.second_radial_sigma),
            ("calibration.known_focal_sigma", self.known_focal_sigma),
            ("calibration.search_step", self.search_step),
            ("calibration.least_inflation", self.least_inflation),
            ("calibration.given_inflation", self.given_inflation),
        ];
        if let Some((field, _)) = sigmas.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
            return refuse(field, "must be above 0");
        }
        if self.min_keyframes < 3 || self.min_keyframes_while_unknown < 3 {
            return refuse(
                "calibration.min_keyframes",
                "must be at least 3: two views say nothing of the camera",
            );
        }
        if !(self.growth.is_finite() && self.growth > 1.0 && self.growth_while_unknown > 1.0) {
            return refuse("calibration.growth", "must be above 1");
        }
        Ok(())
    }
}

impl Default for CalibrationConfig {
    fn default() -> Self {
        Self {
            trust: CalibrationTrust::Given,
            wide: false,
            suspected: false,
            focal_sigma: 0.01,
            center_sigma: 0.01,
            approximate_focal_sigma: 0.15,
            unknown_focal_share: 0.8,
            unknown_focal_sigma: 0.35,
            unknown_center_sigma: 0.02,
            radial_sigma: 0.15,
            second_radial_sigma: 0.01,
            known_focal_sigma: 0.01,
            min_move_sigmas: 0.15,
            search_again_px: 4.0,
            right_angle_gate_deg: 20.0,
            right_angle_sigma_deg: 0.5,
            search_step: 0.12,
            search_reach: 2.5,
            search_iterations: 6,
            hopeless_cost: 100.0,
            least_inflation: 4.0,
            most_inflation: 25.0,
            min_keyframes: 10,
            min_keyframes_while_unknown: 4,
            growth: 1.5,
            growth_while_unknown: 1.2,
            max_keyframes: 60,
            given_inflation: 2.0,
            min_gain: 10.0,
            min_given_sigmas: 2.0,
            certain_gain: 40.0,
            most_certain_inflation: 4.0,
            min_held_out_gain: 2.0,
            gross_contradiction: 100.0,
            undetermined_focal_sigma: 0.1,
            undetermined_keyframes: 15,
            max_disagreement: 0.33,
            max_iterations: 10,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_calibration_of_half_the_size_or_in_millimetres_is_suspected() {
        let config = CalibrationConfig::default();
        let suspicion = |fx: f64, cx: f64, cy: f64| {
            config.suspicion(&CameraParameters { fx, fy: fx, cx, cy, ..config.camera_of_size(640, 480) })
        };
        assert_eq!(suspicion(525.0, 319.5, 239.5), None);
        assert_eq!(suspicion(458.0, 330.0, 255.0), None);
        assert!(suspicion(292.5, 160.0, 120.0).unwrap().contains("another size"));
        assert!(suspicion(3.6, 319.5, 239.5).unwrap().contains("millimetres"));
        assert!(suspicion(1e300, 319.5, 239.5).is_some());
    }

    #[test]
    fn hypotheses_are_for_cameras_of_which_nothing_is_known() {
        let of = |trust| CalibrationConfig { trust, ..CalibrationConfig::default() }.hypotheses();
        assert!(of(CalibrationTrust::Given).is_empty() && of(CalibrationTrust::Approximate).is_empty());
        let focals: Vec<f64> = of(CalibrationTrust::Unknown).iter().map(|camera| camera.focal).collect();
        assert_eq!(focals.len(), 3);
        assert!(focals[0] == 0.0 && focals[1] < -0.2 && focals[2] > 0.25, "{focals:?}");
    }
}
