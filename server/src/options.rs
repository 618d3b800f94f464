//! What a client asks of a session, and what the engine runs with then.

use crate::error::{ApiError, FieldViolation};
use serde::{Deserialize, Serialize};
use slam::{FeatureSwitches, SlamConfig, Threading};
use store::SessionRecord;
use utoipa::ToSchema;

/// Options of a session; every field left out takes the server's default.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
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
}

/// Conversion between two types with a field for each option. Naming each makes the compiler see when one is
/// added.
macro_rules! convert_options {
    ($from:path => $to:path) => {
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
                }
            }
        }
    };
}
convert_options!(SessionOptions => store::SessionOptions);
convert_options!(store::SessionOptions => SessionOptions);
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
        }
    }
}

/// The engine's configuration for a stored session.
///
/// # Errors
/// With a violation per option that cannot be used.
pub fn engine_config_of(record: &SessionRecord) -> Result<SlamConfig, ApiError> {
    let mut config = engine_config(&SessionOptions::from(record.options.clone()))?;
    if !record.enlarges_small_images {
        config.enlarge_below_px = 0;
    }
    Ok(config)
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
    };
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
        let asked = SessionOptions { max_keyframes: Some(0), ..SessionOptions::default() };
        assert_eq!(engine_config(&asked).unwrap_err().violations[0].field, "options.max_keyframes");
    }
}
