//! What a client asks of a session, and what the engine runs with then.

use crate::error::{ApiError, FieldViolation};
use geometry::{Camera, CameraParameters};
use serde::{Deserialize, Serialize};
use slam::{
    CalibrationConfig, CalibrationTrust, FeatureSwitches, RollingShutterConfig, SlamConfig, Threading,
};
use store::SessionRecord;
use utoipa::ToSchema;

/// Options of a session; every field left out takes the server's default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
#[schema(as = Options)]
pub struct SessionOptions {
    /// Same frames and seed, same bytes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deterministic: Option<bool>,
    /// Seed of every random choice.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Features asked of the extractor per frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub n_features: Option<u32>,
    /// Whether points are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<bool>,
    /// Whether lines are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lines: Option<bool>,
    /// Whether global primitives are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub global_primitives: Option<bool>,
    /// Whether loops are closed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loop_closing: Option<bool>,
    /// Self-calibration: whether focal length and principal point are refined as the map grows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refine_calibration: Option<bool>,
    /// Most keyframes the session keeps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_keyframes: Option<u32>,
    /// How far what is said of the camera is to be believed; left out it is as if calibrated, or unknown
    /// where the camera is given by its size alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<Calibration>,
    /// Wide self-calibration: whether a calibration that the images contradict is given up for the camera
    /// that they show. Without it the contradiction is told, and the calibration used as it was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub give_up_calibration: Option<bool>,
    /// Whether what stays where it is in the image while the scene moves is found and left out: black
    /// borders, watermarks, a car's bonnet. Not where a mask was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub find_mask: Option<bool>,
    /// Rolling shutter: milliseconds from the first row of an image to the last, as phones and webcams take 8
    /// to 35; 0 is a global shutter, which reads all rows at once. Left out it is not known, and found where
    /// the motion shows it, unless `refine_calibration` is off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub readout_ms: Option<f64>,
}

/// How far what is said of a camera is to be believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Calibration {
    /// It was calibrated: little is changed, and only what the images prove.
    Given,
    /// Its focal length is known roughly, as from a field of view.
    Approximate,
    /// Nothing is known but the size of the image: focal length, principal point and radial distortion are
    /// found.
    Unknown,
}

macro_rules! same_words {
    ($from:path => $to:path) => {
        impl From<$from> for $to {
            fn from(calibration: $from) -> Self {
                match calibration {
                    <$from>::Given => Self::Given,
                    <$from>::Approximate => Self::Approximate,
                    <$from>::Unknown => Self::Unknown,
                }
            }
        }
    };
}
same_words!(Calibration => store::Calibration);
same_words!(store::Calibration => Calibration);
same_words!(Calibration => CalibrationTrust);

/// Conversion between two types with a field for each option. Naming each makes the compiler see when one is
/// added. Behind `as` stands one whose types convert, behind `from` one that a function converts.
macro_rules! convert_options {
    ($from:path => $to:path $(, from $own:ident = $convert:path)* $(, as $same:ident)*) => {
        impl From<$from> for $to {
            fn from(options: $from) -> Self {
                let $from {
                    deterministic,
                    seed,
                    n_features,
                    points,
                    lines,
                    global_primitives,
                    loop_closing,
                    refine_calibration,
                    max_keyframes,
                    give_up_calibration,
                    find_mask,
                    readout_ms,
                    $($own,)*
                    $($same,)*
                } = options;
                Self {
                    deterministic,
                    seed,
                    n_features,
                    points,
                    lines,
                    global_primitives,
                    loop_closing,
                    refine_calibration,
                    max_keyframes,
                    give_up_calibration,
                    find_mask,
                    readout_ms,
                    $($own: $convert($own),)*
                    $($same: $same.map(Into::into),)*
                }
            }
        }
    };
}
convert_options!(SessionOptions => store::SessionOptions, as calibration);
convert_options!(store::SessionOptions => SessionOptions, as calibration);
pub(crate) use convert_options;

impl SessionOptions {
    /// These options with those that are given in `changes`.
    pub fn changed(self, changes: Self) -> Self {
        Self {
            deterministic: changes.deterministic.or(self.deterministic),
            seed: changes.seed.or(self.seed),
            n_features: changes.n_features.or(self.n_features),
            points: changes.points.or(self.points),
            lines: changes.lines.or(self.lines),
            global_primitives: changes.global_primitives.or(self.global_primitives),
            loop_closing: changes.loop_closing.or(self.loop_closing),
            refine_calibration: changes.refine_calibration.or(self.refine_calibration),
            max_keyframes: changes.max_keyframes.or(self.max_keyframes),
            calibration: changes.calibration.or(self.calibration),
            give_up_calibration: changes.give_up_calibration.or(self.give_up_calibration),
            find_mask: changes.find_mask.or(self.find_mask),
            readout_ms: changes.readout_ms.or(self.readout_ms),
        }
    }
}

/// Whether a camera is given by the size of its images alone, its other numbers being zero.
pub fn is_of_size_alone(camera: &CameraParameters) -> bool {
    [camera.fx, camera.fy, camera.cx, camera.cy].iter().all(|value| *value == 0.0)
}

/// The camera that a session begins with, and its options: one that is given by its size alone, or of which
/// no more is to be believed, is guessed, and found as the map grows. So is one that is doubtful by its
/// numbers alone where the images may correct it.
pub fn camera_to_begin_with(
    camera: CameraParameters,
    options: SessionOptions,
) -> (CameraParameters, SessionOptions) {
    let calibration = options.calibration.or(is_of_size_alone(&camera).then_some(Calibration::Unknown));
    let is_doubted = matches!(calibration, None | Some(Calibration::Given))
        && options.give_up_calibration == Some(true)
        && CalibrationConfig::default().suspicion(&camera).is_some();
    let calibration = if is_doubted { Some(Calibration::Unknown) } else { calibration };
    let options = SessionOptions { calibration, ..options };
    if calibration != Some(Calibration::Unknown) {
        return (camera, options);
    }
    (CalibrationConfig::default().camera_of_size(camera.width, camera.height), options)
}

/// What is doubtful about a camera without keeping it from being used, in plain sentences.
pub fn camera_warnings(camera: &CameraParameters) -> Vec<String> {
    let lens = Camera::new(camera.clone()).map_or_else(|_| Vec::new(), |camera| camera.warnings());
    let doubt = CalibrationConfig::default().suspicion(camera);
    lens.into_iter().chain(doubt.map(|doubt| format!("the calibration is doubtful: {doubt}"))).collect()
}

/// The engine's configuration for a stored session.
///
/// # Errors
/// With a violation per option that cannot be used.
pub fn engine_config_of(record: &SessionRecord) -> Result<SlamConfig, ApiError> {
    let mut config = engine_config(&SessionOptions::from(record.options.clone()))?;
    config.calibration = config.calibration.begin_with(record.camera.clone()).1;
    if !record.enlarges_small_images {
        config.enlarge_below_px = 0;
    }
    config.enlarge_for_border = record.enlarges_for_border;
    Ok(config)
}

/// The engine's configuration for a session whose camera extends the map of another, `map`: what concerns the
/// map is as that says.
///
/// # Errors
/// As [`engine_config_of`].
pub fn engine_config_of_added(map: &SessionRecord, record: &SessionRecord) -> Result<SlamConfig, ApiError> {
    let (of_map, own) = (&map.options, &record.options);
    let options = store::SessionOptions {
        seed: own.seed,
        n_features: own.n_features,
        find_mask: own.find_mask,
        readout_ms: own.readout_ms,
        ..of_map.clone()
    };
    let record = SessionRecord { options, ..record.clone() };
    Ok(engine_config_of(&record)?.of_added_camera())
}

/// The options that a session has whose camera extends another's map.
///
/// # Errors
/// With a violation per option that concerns the map.
pub fn check_added_options(options: &SessionOptions) -> Result<(), ApiError> {
    let of_map = [
        ("deterministic", options.deterministic.is_some()),
        ("points", options.points.is_some()),
        ("lines", options.lines.is_some()),
        ("global_primitives", options.global_primitives.is_some()),
        ("loop_closing", options.loop_closing.is_some()),
        ("refine_calibration", options.refine_calibration.is_some()),
        ("max_keyframes", options.max_keyframes.is_some()),
        ("calibration", options.calibration.is_some()),
        ("give_up_calibration", options.give_up_calibration.is_some()),
    ];
    let given = of_map.into_iter().filter(|(_, is_given)| *is_given);
    let violations: Vec<FieldViolation> = given
        .map(|(name, _)| FieldViolation {
            field: format!("options.{name}"),
            description: "concerns the map: it is as the session says whose map it is, leave it out here"
                .into(),
        })
        .collect();
    if violations.is_empty() { Ok(()) } else { Err(ApiError::invalid_fields(violations)) }
}

/// The camera whose pixels a stored session's features are in.
///
/// # Errors
/// If the stored options or camera cannot be used.
pub fn working_camera(record: &SessionRecord) -> Result<Camera, ApiError> {
    Ok(engine_config_of(record)?.working_camera(&record.checked_camera()?))
}

/// The engine's configuration for these options.
///
/// # Errors
/// With a violation per option that cannot be used.
pub fn engine_config(options: &SessionOptions) -> Result<SlamConfig, ApiError> {
    let violations = contradictions(options);
    if !violations.is_empty() {
        return Err(ApiError::invalid_fields(violations));
    }
    let mut config = SlamConfig::default();
    let lines = options.lines.unwrap_or(config.features.lines);
    config.features = FeatureSwitches {
        lines,
        // Without lines there are none, unless they are asked for, which is refused above.
        global_primitives: lines && options.global_primitives.unwrap_or(config.features.global_primitives),
        loop_closing: options.loop_closing.unwrap_or(config.features.loop_closing),
        refine_calibration: options.refine_calibration.unwrap_or(config.features.refine_calibration),
        find_mask: options.find_mask.unwrap_or(config.features.find_mask),
    };
    config.calibration.trust = options.calibration.map_or(config.calibration.trust, Into::into);
    config.calibration.wide = options.give_up_calibration.unwrap_or(config.calibration.wide);
    if let Some(readout_ms) = options.readout_ms {
        config.rolling_shutter = RollingShutterConfig::of_ms(readout_ms);
    }
    if options.deterministic == Some(true) {
        config.threading = Threading::Inline;
    }
    if let Some(seed) = options.seed {
        config.seed = seed;
    }
    if let Some(n_features) = options.n_features {
        config.orb.n_features = n_features as usize;
        config.initialization.n_features = config.initialization.n_features.max(n_features as usize);
    }
    if let Some(max_keyframes) = options.max_keyframes {
        config.keyframes.max_keyframes = max_keyframes as usize;
    }
    config.validate().map_err(|error| {
        let field = match error.field {
            "orb.n_features" => "options.n_features".to_owned(),
            "keyframes.max_keyframes" => "options.max_keyframes".to_owned(),
            "rolling_shutter.readout_ns" => "options.readout_ms".to_owned(),
            other => format!("options ({other})"),
        };
        ApiError::invalid(field, error.reason)
    })?;
    Ok(config)
}

/// The options that cannot be met together, or at all.
fn contradictions(options: &SessionOptions) -> Vec<FieldViolation> {
    let asked = [
        (
            "options.points",
            options.points == Some(false),
            "points cannot be left out: the map is begun and places are recognised by them",
        ),
        (
            "options.global_primitives",
            options.global_primitives == Some(true) && options.lines == Some(false),
            "global primitives are directions of lines and need them: leave out lines = false, or set this to false too",
        ),
    ];
    let wrong = asked.into_iter().filter(|(_, is_wrong, _)| *is_wrong);
    wrong
        .map(|(field, _, sentence)| FieldViolation { field: field.into(), description: sentence.into() })
        .collect()
}

/// A camera that can be worked with.
///
/// # Errors
/// If a field of its calibration cannot be; the error names it.
pub(crate) fn check_camera(camera: CameraParameters) -> Result<Camera, ApiError> {
    Camera::new(camera).map_err(|error| ApiError::invalid(format!("camera.{}", error.field), error.message))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn switches(lines: Option<bool>, global_primitives: Option<bool>) -> Result<(bool, bool), ApiError> {
        let options = SessionOptions { lines, global_primitives, ..SessionOptions::default() };
        engine_config(&options).map(|config| (config.features.lines, config.features.global_primitives))
    }

    #[test]
    fn switches_reach_the_engine_and_are_on_when_left_out() {
        assert_eq!(engine_config(&SessionOptions::default()).unwrap().features, FeatureSwitches::default());
        assert_eq!(switches(None, None).unwrap(), (true, true));
        assert_eq!(switches(Some(true), Some(false)).unwrap(), (true, false));
        assert_eq!(switches(Some(false), Some(false)).unwrap(), (false, false));
        assert_eq!(switches(Some(false), None).unwrap(), (false, false), "no lines, no primitives");
        let open = SessionOptions { loop_closing: Some(false), ..SessionOptions::default() };
        assert!(!engine_config(&open).unwrap().features.loop_closing);
    }

    #[test]
    fn a_camera_of_which_only_the_size_is_given_is_unknown() {
        let size = CalibrationConfig::default().camera_of_size(640, 480);
        let alone = CameraParameters { fx: 0.0, fy: 0.0, cx: 0.0, cy: 0.0, ..size.clone() };
        let (camera, options) = camera_to_begin_with(alone, SessionOptions::default());
        assert_eq!((&camera, options.calibration), (&size, Some(Calibration::Unknown)));
        assert_eq!(engine_config(&options).unwrap().calibration.trust, CalibrationTrust::Unknown);
        // What is given is used unless it is not to be believed.
        let given = CameraParameters { fx: 500.0, ..size.clone() };
        let (camera, options) = camera_to_begin_with(given.clone(), SessionOptions::default());
        assert_eq!((&camera, options.calibration), (&given, None));
        let doubted = SessionOptions { calibration: Some(Calibration::Unknown), ..options };
        assert_eq!(camera_to_begin_with(given, doubted).0, size);
    }

    #[test]
    fn doubtful_cameras_are_told_apart() {
        let size = CalibrationConfig::default().camera_of_size(640, 480);
        assert_eq!(camera_warnings(&size), Vec::<String>::new());
        let of_half = CameraParameters { fx: 290.0, fy: 290.0, cx: 159.5, cy: 119.5, ..size };
        assert!(matches!(&camera_warnings(&of_half)[..], [doubt] if doubt.contains("another size")));
    }

    #[test]
    fn what_cannot_be_met_is_refused_by_name() {
        let error = switches(Some(false), Some(true)).unwrap_err();
        assert_eq!(error.violations[0].field, "options.global_primitives");
        let asked = SessionOptions { points: Some(false), ..SessionOptions::default() };
        assert_eq!(engine_config(&asked).unwrap_err().violations[0].field, "options.points");
    }

    #[test]
    fn numbers_outside_their_range_are_refused_by_the_clients_name_for_them() {
        let asked = SessionOptions { n_features: Some(7), ..SessionOptions::default() };
        assert_eq!(engine_config(&asked).unwrap_err().violations[0].field, "options.n_features");
        for wrong in [-1.0, 1e9, f64::NAN] {
            let asked = SessionOptions { readout_ms: Some(wrong), ..SessionOptions::default() };
            assert_eq!(engine_config(&asked).unwrap_err().violations[0].field, "options.readout_ms");
        }
        let asked = SessionOptions { readout_ms: Some(16.5), ..SessionOptions::default() };
        assert_eq!(engine_config(&asked).unwrap().rolling_shutter.readout_ns, Some(16_500_000));
        let asked = SessionOptions { max_keyframes: Some(0), ..SessionOptions::default() };
        assert_eq!(engine_config(&asked).unwrap_err().violations[0].field, "options.max_keyframes");
    }
}
