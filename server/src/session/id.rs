//! Names of sessions.

use crate::error::ApiError;
use std::fmt;

/// Longest id, characters.
const MAX_LENGTH: usize = 64;
/// Letters of an id the server makes: 20 base-32 characters are 100 random bits.
const GENERATED_LENGTH: usize = 20;

/// A session's id: 1 to 64 letters, digits, `-` and `_`. No other string can be made into one, so an id can
/// never be a path, a pattern or a piece of a query.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionId(String);

impl SessionId {
    /// Checks an id; `field` is what an error calls it.
    ///
    /// # Errors
    /// If the string is not a valid id.
    pub fn parse(text: &str, field: &str) -> Result<Self, ApiError> {
        let valid_characters =
            text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_');
        if text.is_empty() || text.len() > MAX_LENGTH || !valid_characters {
            let sentence = format!("must be 1 to {MAX_LENGTH} letters, digits, '-' and '_'");
            return Err(ApiError::invalid(field, sentence));
        }
        Ok(Self(text.to_owned()))
    }

    /// A new id nobody can guess.
    pub fn generate() -> Self {
        const ALPHABET: &[u8; 32] = b"abcdefghijklmnopqrstuvwxyz234567";
        let letter = |_| ALPHABET[rand::random_range(0..ALPHABET.len())] as char;
        Self((0..GENERATED_LENGTH).map(letter).collect())
    }

    /// The id as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Debug for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_that_could_mean_something_else_are_refused() {
        for text in ["", ".", "..", "../x", "a/b", "a b", "a%2f", "ä", "a\0", &"x".repeat(65)] {
            assert!(SessionId::parse(text, "session_id").is_err(), "{text:?} was accepted");
        }
        for text in ["a", "A-1_b", &"x".repeat(64)] {
            assert_eq!(SessionId::parse(text, "session_id").unwrap().as_str(), text);
        }
    }

    #[test]
    fn a_generated_id_is_valid() {
        let id = SessionId::generate();
        assert_eq!(SessionId::parse(id.as_str(), "session_id").unwrap(), id);
    }
}
