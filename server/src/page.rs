//! Long answers in pages.

use crate::error::ApiError;
use crate::ids::{RowId, parse_id};
use std::fmt::Display;

/// Sessions or rows on a page if the caller does not say.
pub const DEFAULT_PAGE_SIZE: u32 = 100;
/// Sessions or rows on a page at most.
pub const MAX_PAGE_SIZE: u32 = 1000;

/// Which page of a list is wanted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PageRequest {
    size: u32,
    token: String,
}

impl PageRequest {
    /// The page that a token of the page before leads to, or, with an empty token, the first one; a size of 0
    /// takes the default.
    ///
    /// # Errors
    /// If the page is too large.
    pub fn new(size: u32, token: impl Into<String>) -> Result<Self, ApiError> {
        let size = match size {
            0 => DEFAULT_PAGE_SIZE,
            1..=MAX_PAGE_SIZE => size,
            _ => {
                let sentence = format!("is {size} but must be at most {MAX_PAGE_SIZE}");
                return Err(ApiError::invalid("page_size", sentence));
            }
        };
        Ok(Self { size, token: token.into() })
    }

    /// Entries wanted at most.
    pub fn size(&self) -> u32 {
        self.size
    }

    /// The token; `None` for the first page.
    pub fn token(&self) -> Option<&str> {
        Some(self.token.as_str()).filter(|token| !token.is_empty())
    }

    /// The row that ended the page before; `None` for the first page.
    ///
    /// # Errors
    /// If the token is none of a list of such rows.
    pub fn after<K: RowId>(&self) -> Result<Option<K>, ApiError> {
        self.token().map(|token| parse_id("page_token", token)).transpose()
    }
}

/// Some entries of a list, in its order.
#[derive(Clone, Debug, PartialEq)]
pub struct Page<T> {
    /// The entries.
    pub items: Vec<T>,
    /// Where the next page begins; `None` on the last.
    pub next_page_token: Option<String>,
}

impl<T> Page<T> {
    /// A page of stored rows, each as callers see it.
    pub fn of<R, K: Display>(stored: store::Page<R, K>, view: impl FnMut(R) -> T) -> Self {
        let next_page_token = stored.next.map(|last| last.to_string());
        Self { items: stored.items.into_iter().map(view).collect(), next_page_token }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slam::map::PointId;

    #[test]
    fn a_page_has_a_default_size_and_a_largest_one() {
        let size = |size| PageRequest::new(size, "").map(|page| page.size());
        assert_eq!(size(0).unwrap(), DEFAULT_PAGE_SIZE);
        assert_eq!(size(MAX_PAGE_SIZE).unwrap(), MAX_PAGE_SIZE);
        assert_eq!(size(MAX_PAGE_SIZE + 1).unwrap_err().violations[0].field, "page_size");
    }

    #[test]
    fn a_token_is_the_last_row_before_the_page() {
        let after = |token: &str| PageRequest::new(0, token).unwrap().after::<PointId>();
        assert_eq!(after("").unwrap(), None);
        assert_eq!(after("4").unwrap(), PointId::new(4));
        assert_eq!(after("x").unwrap_err().violations[0].field, "page_token");
    }
}
