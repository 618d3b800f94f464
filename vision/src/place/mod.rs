//! Place recognition: which stored images show what this image shows.

use crate::Descriptor;

/// A stored image that may show the queried place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceCandidate {
    /// The id the image was inserted with.
    pub image_id: u64,
    /// Similarity, the higher the better; comparable between candidates of one query.
    pub score: f32,
    /// Number of query descriptors that voted for this image.
    pub n_votes: u32,
}

/// An index of images by their binary descriptors, growing and shrinking as images come and go.
#[derive(Clone, Debug, Default)]
pub struct PlaceIndex {
    images: Vec<(u64, Vec<Descriptor>)>,
}

impl PlaceIndex {
    /// An empty index.
    pub fn new() -> Self {
        Self::default()
    }

    /// Number of images held.
    pub fn len(&self) -> usize {
        self.images.len()
    }

    /// Whether no image is held.
    pub fn is_empty(&self) -> bool {
        self.images.is_empty()
    }

    /// Adds an image, replacing one of the same id.
    pub fn insert(&mut self, image_id: u64, descriptors: &[Descriptor]) {
        self.remove(image_id);
        self.images.push((image_id, descriptors.to_vec()));
    }

    /// Takes an image out; `false` if it was not there.
    pub fn remove(&mut self, image_id: u64) -> bool {
        let before = self.images.len();
        self.images.retain(|(id, _)| *id != image_id);
        self.images.len() < before
    }

    /// The `max_results` stored images most like the queried one, best first.
    pub fn query(&self, descriptors: &[Descriptor], max_results: usize) -> Vec<PlaceCandidate> {
        let mut candidates: Vec<PlaceCandidate> = self
            .images
            .iter()
            .map(|(image_id, stored)| {
                let near = |d: &&Descriptor| stored.iter().any(|s| s.distance(d) <= 40);
                let n_votes = descriptors.iter().filter(near).count() as u32;
                PlaceCandidate { image_id: *image_id, score: n_votes as f32, n_votes }
            })
            .filter(|c| c.n_votes > 0)
            .collect();
        candidates.sort_by(|a, b| b.n_votes.cmp(&a.n_votes).then(a.image_id.cmp(&b.image_id)));
        candidates.truncate(max_results);
        candidates
    }
}
