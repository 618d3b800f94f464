//! What a session runs with. Every field has a default, a unit and a reason.

/// How the stages of a session share the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Threading {
    /// Every stage in turn on the caller's thread: same frames and seed, same bytes out.
    Inline,
    /// Mapping runs on a thread of its own beside tracking.
    #[default]
    Background,
}

/// Configuration of a session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SlamConfig {
    /// How the stages share the machine.
    pub threading: Threading,
    /// Seed of every random choice. Default 0.
    pub seed: u64,
}

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
        Ok(())
    }
}
