//! Names of sessions.

use crate::error::ApiError;
use std::cmp::Ordering;
use std::fmt;
use std::hash::{Hash, Hasher};

/// Longest name of a session or an owner, characters.
const MAX_LENGTH: usize = 64;
/// Letters of an id the server makes: 20 base-32 characters are 100 random bits.
const GENERATED_LENGTH: usize = 20;

/// Stands between owner and name in the key of a session that has an owner.
pub const OWNER_END: char = '~';

/// A session's id: 1 to 64 letters, digits, `-` and `_`, after the name of the owner where the session has
/// one. No other string can be made into one, so an id can never be a path, a pattern or a piece of a query.
///
/// An owner's session is `owner~name` in the database, and `name` for who may see no others: [`Self::within`]
/// leads to no session but the owner's. `Display` is what the caller calls it, [`Self::as_str`] the key.
#[derive(Clone)]
pub struct SessionId {
    key: String,
    /// Where in the key begins what the caller calls the session.
    shown_from: usize,
}

impl SessionId {
    /// The session that a caller means who sees one owner's sessions, or, without an owner, those of all;
    /// `field` is what an error calls the text.
    ///
    /// # Errors
    /// If the string is not a valid id.
    pub fn within(owner: Option<&str>, text: &str, field: &str) -> Result<Self, ApiError> {
        match owner {
            Some(owner) if is_name(text) => {
                Ok(Self::stored(Some(owner), format!("{owner}{OWNER_END}{text}")))
            }
            None if text
                .split_once(OWNER_END)
                .map_or(is_name(text), |(owner, name)| is_name(owner) && is_name(name)) =>
            {
                Ok(Self::stored(None, text.to_owned()))
            }
            _ => {
                let sentence = format!("must be 1 to {MAX_LENGTH} letters, digits, '-' and '_'");
                Err(ApiError::invalid(field, sentence))
            }
        }
    }

    /// The id of a stored session, as a caller sees it who sees this owner's sessions, or those of all.
    pub fn stored(owner: Option<&str>, key: String) -> Self {
        let shown_from = owner.map_or(0, |owner| owner.len() + OWNER_END.len_utf8());
        Self { key, shown_from }
    }

    /// Another session of the same owner, by its key, as who sees this one sees it.
    pub fn beside(&self, key: &str) -> Self {
        Self { key: key.to_owned(), shown_from: self.shown_from }
    }

    /// A new id nobody can guess, of this owner's if there is one.
    pub fn generate(owner: Option<&str>) -> Self {
        const ALPHABET: &[u8; 32] = b"abcdefghijklmnopqrstuvwxyz234567";
        let letter = |_| ALPHABET[rand::random_range(0..ALPHABET.len())] as char;
        let name: String = (0..GENERATED_LENGTH).map(letter).collect();
        let key = owner.map_or(name.clone(), |owner| format!("{owner}{OWNER_END}{name}"));
        Self::stored(owner, key)
    }

    /// The id in the database and in the log.
    pub fn as_str(&self) -> &str {
        &self.key
    }

    /// An id as one who sees all sessions calls it.
    #[cfg(test)]
    pub fn parse(text: &str, field: &str) -> Result<Self, ApiError> {
        Self::within(None, text, field)
    }
}

/// Whether a text can name a session or an owner.
pub fn is_name(text: &str) -> bool {
    let is_valid = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_';
    !text.is_empty() && text.len() <= MAX_LENGTH && text.bytes().all(is_valid)
}

impl PartialEq for SessionId {
    fn eq(&self, other: &Self) -> bool {
        self.key == other.key
    }
}

impl Eq for SessionId {}

impl PartialOrd for SessionId {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for SessionId {
    fn cmp(&self, other: &Self) -> Ordering {
        self.key.cmp(&other.key)
    }
}

impl Hash for SessionId {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.key.hash(state);
    }
}

impl fmt::Display for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.key.get(self.shown_from..).unwrap_or(&self.key))
    }
}

impl fmt::Debug for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_that_could_mean_something_else_are_refused() {
        for text in
            ["", ".", "..", "../x", "a/b", "a b", "a%2f", "ä", "a\0", "~a", "a~", "a~b~c", &"x".repeat(65)]
        {
            assert!(SessionId::within(None, text, "session_id").is_err(), "{text:?} was accepted");
            assert!(SessionId::within(Some("o"), text, "session_id").is_err(), "{text:?} was accepted");
        }
        for text in ["a", "A-1_b", &"x".repeat(64)] {
            assert_eq!(SessionId::within(None, text, "session_id").unwrap().as_str(), text);
        }
    }

    #[test]
    fn an_owner_names_no_session_but_its_own() {
        let mine = SessionId::within(Some("ann"), "kitchen", "id").unwrap();
        assert_eq!((mine.as_str(), mine.to_string().as_str()), ("ann~kitchen", "kitchen"));
        for other in ["bob~kitchen", "ann~kitchen"] {
            assert!(SessionId::within(Some("ann"), other, "id").is_err());
        }
        let seen_by_all = SessionId::within(None, "ann~kitchen", "id").unwrap();
        assert_eq!((&seen_by_all, seen_by_all.to_string().as_str()), (&mine, "ann~kitchen"));
    }

    #[test]
    fn a_generated_id_is_valid() {
        for owner in [None, Some("ann")] {
            let id = SessionId::generate(owner);
            assert_eq!(SessionId::within(owner, &id.to_string(), "session_id").unwrap(), id);
        }
    }
}
