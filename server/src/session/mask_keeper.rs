//! Saves what was found not to be the scene, beside everything else.

use super::load::History;
use slam::SceneMask;
use tokio::runtime::Handle;
use tokio::task::JoinHandle;

/// Saves one state at a time, always the newest: should one be lost, it is found again.
pub struct MaskKeeper {
    history: History,
    runtime: Handle,
    /// As it was saved last, or is being.
    saved: Option<SceneMask>,
    saving: Option<JoinHandle<()>>,
}

impl MaskKeeper {
    /// `stored` is what the database has.
    pub fn new(history: History, runtime: Handle, stored: Option<SceneMask>) -> Self {
        Self { history, runtime, saved: stored, saving: None }
    }

    /// Begins to save a mask that is another than that before, unless one is being saved.
    pub fn offer(&mut self, mask: Option<&SceneMask>) {
        let is_busy = self.saving.as_ref().is_some_and(|saving| !saving.is_finished());
        if !is_busy && mask != self.saved.as_ref() {
            self.saved = mask.cloned();
            let (history, mask) = (self.history.clone(), self.saved.clone());
            self.saving = Some(self.runtime.spawn(async move { history.save_mask(mask).await }));
        }
    }

    /// Waits until a mask is saved. Not on a thread of the runtime.
    pub fn finish(&mut self, mask: Option<&SceneMask>) {
        self.wait();
        self.offer(mask);
        self.wait();
    }

    fn wait(&mut self) {
        if let Some(saving) = self.saving.take() {
            // A panic was told by the runtime, and costs a mask that is found again.
            let _ = self.runtime.block_on(saving);
        }
    }
}
