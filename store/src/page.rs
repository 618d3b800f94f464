//! Pages of rows.

/// Some rows in the order of their keys.
#[derive(Clone, Debug, PartialEq)]
pub struct Page<T, K> {
    /// The rows.
    pub items: Vec<T>,
    /// Pass this as `after` for the next page; `None` on the last one.
    pub next: Option<K>,
}

impl<T, K> Page<T, K> {
    /// A page of rows of which one more was asked for than the page has: whether it came says whether this is
    /// the last.
    pub(crate) fn of(mut items: Vec<T>, page_size: u32, key: impl FnOnce(&T) -> K) -> Self {
        let has_more = items.len() > page_size as usize;
        items.truncate(page_size as usize);
        let next = items.last().filter(|_| has_more).map(key);
        Self { items, next }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_too_many_means_another_page() {
        let page = |n: u32| Page::of((0..n).collect(), 3, |row| *row);
        assert_eq!(page(4), Page { items: vec![0, 1, 2], next: Some(2) });
        assert_eq!(page(3), Page { items: vec![0, 1, 2], next: None });
        assert_eq!(page(0), Page { items: vec![], next: None });
    }
}
