//! Where global bundle adjustment runs: at once, or on a thread of its own beside tracking and mapping.

use super::intrinsics::{IntrinsicsCheck, Look, Memory};
use super::readout::ReadoutLook;
use crate::bundle::global::{GlobalResult, adjust};
use crate::config::{SlamConfig, Threading};
use crate::cores::{self, Share};
use crate::map::{Map, SubmapId};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

/// At most one global bundle adjustment at a time; a new one supersedes the one under way.
pub(super) struct GlobalStage {
    threading: Threading,
    under_way: Option<UnderWay>,
}

/// What is to be done.
pub(super) enum Task {
    /// Poses, landmarks and primitives of a submap are adjusted.
    AdjustMap,
    /// The camera is looked at, and the submap adjusted to it if it turns out to be another than was thought.
    CheckIntrinsics(Box<Check>),
}

/// What is known when the camera is looked at.
pub(super) struct Check {
    pub before: Memory,
    pub readout: Option<ReadoutLook>,
}

/// What came of it.
pub(super) enum Done {
    Adjusted(GlobalResult),
    CheckedIntrinsics(Box<IntrinsicsCheck>),
}

impl Task {
    fn run(self, map: &Map, submap: SubmapId, config: &SlamConfig, abort: &AtomicBool) -> Option<Done> {
        match self {
            Self::AdjustMap => adjust(map, submap, config, abort).map(Done::Adjusted),
            Self::CheckIntrinsics(check) => {
                let Check { before, readout } = *check;
                let look = Look { map, submap, config, abort };
                look.check(before, readout.as_ref()).map(|check| Done::CheckedIntrinsics(Box::new(check)))
            }
        }
    }
}

struct UnderWay {
    is_check: bool,
    abort: Arc<AtomicBool>,
    thread: JoinHandle<Option<Done>>,
}

impl GlobalStage {
    pub fn new(threading: Threading) -> Self {
        Self { threading, under_way: None }
    }

    /// Begins to adjust a submap. Returns the result if it is there at once.
    pub fn start(&mut self, task: Task, map: &Map, submap: SubmapId, config: &SlamConfig) -> Option<Done> {
        self.cancel();
        let abort = Arc::new(AtomicBool::new(false));
        if self.threading == Threading::Inline {
            return task.run(map, submap, config, &abort);
        }
        let is_check = matches!(task, Task::CheckIntrinsics(_));
        let (snapshot, config, aborted) = (map.clone(), config.clone(), abort.clone());
        let share = Share::of_this_thread();
        let run = move || {
            let _joined = share.map(Share::enter);
            cores::with_turn(|| task.run(&snapshot, submap, &config, &aborted))
        };
        // Without a thread the map stays as good as the essential graph has made it.
        let spawned = std::thread::Builder::new().name("slam-global-ba".into()).spawn(run);
        self.under_way = spawned.ok().map(|thread| UnderWay { is_check, abort, thread });
        None
    }

    /// Gives up what is under way: the map it began with is no longer ours.
    pub fn cancel(&mut self) {
        if let Some(under_way) = self.under_way.take() {
            under_way.abort.store(true, Ordering::Relaxed);
        }
    }

    /// Whether the camera is being looked at.
    pub fn is_checking_intrinsics(&self) -> bool {
        self.under_way.as_ref().is_some_and(|under_way| under_way.is_check)
    }

    /// Whether nothing is under way.
    pub fn is_idle(&self) -> bool {
        self.under_way.is_none()
    }

    /// The result, once it is there; `wait` waits for it.
    pub fn take(&mut self, wait: bool) -> Option<Done> {
        if !self.under_way.as_ref().is_some_and(|under_way| wait || under_way.thread.is_finished()) {
            return None;
        }
        // A panic there is a defect, and costs this correction only.
        let thread = self.under_way.take()?.thread;
        let joined = if thread.is_finished() { thread.join() } else { cores::wait(|| thread.join()) };
        joined.ok().flatten()
    }
}

impl Drop for GlobalStage {
    fn drop(&mut self) {
        self.cancel();
    }
}
