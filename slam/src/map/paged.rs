//! A dense table of landmarks that is cheap to copy: copies share what neither has changed.

use std::sync::Arc;

/// Entries per page: a write copies one page of pointers, a copy of the table one pointer per page.
const PAGE_SIZE: usize = 64;

type Page<T> = [Option<Arc<T>>; PAGE_SIZE];

/// Entries by dense index, copy-on-write per entry.
///
/// Cloning costs one reference count per page, so that a map of 50 000 points is copied in
/// microseconds; the first write to an entry after a clone copies that entry and its page of pointers.
#[derive(Debug)]
pub(crate) struct Paged<T> {
    pages: Vec<Option<Arc<Page<T>>>>,
    len: usize,
}

impl<T> Clone for Paged<T> {
    fn clone(&self) -> Self {
        Self { pages: self.pages.clone(), len: self.len }
    }
}

impl<T> Default for Paged<T> {
    fn default() -> Self {
        Self { pages: Vec::new(), len: 0 }
    }
}

impl<T: Clone> Paged<T> {
    /// How many entries there are.
    pub fn len(&self) -> usize {
        self.len
    }

    pub fn get(&self, index: usize) -> Option<&T> {
        self.get_shared(index).map(Arc::as_ref)
    }

    pub fn get_shared(&self, index: usize) -> Option<&Arc<T>> {
        self.pages.get(index / PAGE_SIZE)?.as_ref()?[index % PAGE_SIZE].as_ref()
    }

    pub fn get_mut(&mut self, index: usize) -> Option<&mut T> {
        self.get(index)?;
        let page = self.pages[index / PAGE_SIZE].as_mut()?;
        Arc::make_mut(page)[index % PAGE_SIZE].as_mut().map(Arc::make_mut)
    }

    /// Puts an entry at an index, in place of the one that was there.
    pub fn insert(&mut self, index: usize, value: T) {
        let page_idx = index / PAGE_SIZE;
        if page_idx >= self.pages.len() {
            self.pages.resize_with(page_idx + 1, || None);
        }
        let page = self.pages[page_idx].get_or_insert_with(|| Arc::new([const { None }; PAGE_SIZE]));
        let slot = &mut Arc::make_mut(page)[index % PAGE_SIZE];
        self.len += usize::from(slot.is_none());
        *slot = Some(Arc::new(value));
    }

    /// Takes an entry out; a page without entries is freed.
    pub fn remove(&mut self, index: usize) -> Option<Arc<T>> {
        let slot = self.pages.get_mut(index / PAGE_SIZE)?;
        let page = Arc::make_mut(slot.as_mut()?);
        let removed = page[index % PAGE_SIZE].take()?;
        if page.iter().all(Option::is_none) {
            *slot = None;
        }
        self.len -= 1;
        Some(removed)
    }

    /// Every entry in the order of the indices.
    pub fn iter(&self) -> impl Iterator<Item = &T> {
        self.pages.iter().flatten().flat_map(|page| page.iter()).flatten().map(Arc::as_ref)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_keeps_its_values_when_the_original_is_written() {
        let mut table = Paged::default();
        for index in 0..200 {
            table.insert(index, index * 10);
        }
        let copy = table.clone();
        *table.get_mut(130).unwrap() = 7;
        table.remove(131);
        assert_eq!((copy.get(130), copy.get(131), copy.len()), (Some(&1300), Some(&1310), 200));
        assert_eq!((table.get(130), table.get(131), table.len()), (Some(&7), None, 199));
    }

    #[test]
    fn untouched_entries_are_shared_between_copies() {
        let mut table = Paged::default();
        (0..10).for_each(|index| table.insert(index, vec![index; 100]));
        let copy = table.clone();
        table.get_mut(3).unwrap().push(0);
        assert!(Arc::ptr_eq(table.get_shared(4).unwrap(), copy.get_shared(4).unwrap()));
        assert!(!Arc::ptr_eq(table.get_shared(3).unwrap(), copy.get_shared(3).unwrap()));
    }

    #[test]
    fn a_page_without_entries_is_freed() {
        let mut table = Paged::default();
        (0..PAGE_SIZE).for_each(|index| table.insert(index, index));
        (0..PAGE_SIZE).for_each(|index| assert!(table.remove(index).is_some()));
        assert!(table.pages[0].is_none());
        assert_eq!(table.iter().count(), 0);
    }
}
