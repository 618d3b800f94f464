//! From what a client asks of a session to what the engine runs with.

use crate::error::{ApiError, ErrorCode, FieldViolation};
use slam::{SlamConfig, Threading};
use store::SessionOptions;

/// The engine's configuration for these options.
///
/// # Errors
/// With a violation per option that cannot be used.
pub fn engine_config(options: &SessionOptions) -> Result<SlamConfig, ApiError> {
    let violations = unavailable(options);
    if let Some(first) = violations.first() {
        let message = format!("{}: {}", first.field, first.description);
        return Err(ApiError { code: ErrorCode::InvalidArgument, message, violations });
    }
    let mut config = SlamConfig::default();
    if options.deterministic == Some(true) {
        config.threading = Threading::Inline;
    }
    if let Some(seed) = options.seed {
        config.seed = seed;
    }
    if let Some(n_features) = options.n_features {
        config.orb.n_features = n_features as usize;
        config.initialisation.n_features = config.initialisation.n_features.max(n_features as usize);
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

/// The options asked for that this version does not have. Asking for what is there, or to leave out what is not,
/// is fine.
fn unavailable(options: &SessionOptions) -> Vec<FieldViolation> {
    let asked = [
        (
            "options.points",
            options.points == Some(false),
            "points cannot be left out: nothing else is tracked yet",
        ),
        (
            "options.lines",
            options.lines == Some(true),
            "lines are not available in this version; leave the field out",
        ),
        (
            "options.global_primitives",
            options.global_primitives == Some(true),
            "global primitives are not available in this version; leave the field out",
        ),
        (
            "options.loop_closing",
            options.loop_closing == Some(true),
            "loop closing is not available in this version; leave the field out",
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

    #[test]
    fn what_is_not_available_is_refused_by_name_and_leaving_it_out_is_not() {
        let asked =
            SessionOptions { lines: Some(true), loop_closing: Some(true), ..SessionOptions::default() };
        let error = engine_config(&asked).unwrap_err();
        let fields: Vec<_> = error.violations.iter().map(|violation| violation.field.as_str()).collect();
        assert_eq!(fields, ["options.lines", "options.loop_closing"]);
        let left_out = SessionOptions { lines: Some(false), points: Some(true), ..SessionOptions::default() };
        assert!(engine_config(&left_out).is_ok());
    }

    #[test]
    fn numbers_outside_their_range_are_refused_by_the_clients_name_for_them() {
        let asked = SessionOptions { n_features: Some(7), ..SessionOptions::default() };
        assert_eq!(engine_config(&asked).unwrap_err().violations[0].field, "options.n_features");
        let asked = SessionOptions { max_keyframes: Some(0), ..SessionOptions::default() };
        assert_eq!(engine_config(&asked).unwrap_err().violations[0].field, "options.max_keyframes");
    }
}
