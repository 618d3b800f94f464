//! What of the camera's images is not the scene: given with the session, or found while it runs.

use crate::input::SceneMask;
use std::sync::Arc;
use vision::GrayImage;
use vision::mask::{MaskFinder, MaskFinderConfig};

/// Keeps what is known of it. What was given is not doubted, and nothing is looked for beside it.
pub(super) struct MaskStage {
    known: Option<SceneMask>,
    /// Absent where nothing is to be looked for.
    finder: Option<MaskFinder>,
    /// Whether what is known was found by this finder, and not before a restart.
    is_own: bool,
}

impl MaskStage {
    pub fn new(known: Option<SceneMask>, is_looked_for: bool) -> Self {
        let is_given = known.as_ref().is_some_and(|known| known.is_given);
        let finder = (is_looked_for && !is_given).then(|| MaskFinder::new(MaskFinderConfig::default()));
        Self { known, finder, is_own: false }
    }

    pub fn mask(&self) -> Option<&SceneMask> {
        self.known.as_ref()
    }

    /// Looks at an image of the working size. Returns whether something else is known now. What was found
    /// before a restart holds until as much has been seen again.
    pub fn look(&mut self, image: &GrayImage) -> bool {
        let Some(finder) = &mut self.finder else { return false };
        let found = finder.look(image);
        if self.known.is_some() && !self.is_own && !finder.is_settled() {
            return false;
        }
        let is_first_verdict = !self.is_own && finder.is_settled();
        let found = if is_first_verdict { finder.mask() } else { found };
        self.is_own |= is_first_verdict || found.is_some();
        let Some(found) = found else { return false };
        let known = (found.share() > 0.0).then(|| SceneMask { mask: Arc::new(found), is_given: false });
        let has_changed = self.known != known;
        if has_changed {
            let share = known.as_ref().map_or(0.0, |known| known.mask.share());
            tracing::info!(share, "what is not the scene is left out of the images");
        }
        self.known = known;
        has_changed
    }
}
