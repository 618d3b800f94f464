//! Backfill: poses for frames that came before there was a good map: while there was none, while the camera
//! was lost, and while the map was young and its geometry still rough.
//!
//! Their features are kept for a while. Once the map is good enough, the recording is followed backwards from
//! the present frame, one kept frame per new frame, so that no frame takes much longer than another. What
//! lies between two submaps and is reached from neither is kept on, and followed from both sides once the two
//! have been merged.

use crate::config::{InitializationConfig, SlamConfig};
use crate::features::View;
use crate::map::{FramePose, FrameRecord, FrameState, Keyframe, Map, MapCamera, median_depth};
use crate::report::TrackingOutcome;
use crate::rolling_shutter::RollingShutter;
use crate::tracking::Tracker;
use crate::tracking::frame::TrackedFrame;
use std::collections::VecDeque;

/// A second pose replaces the first only if it is borne by at least this share of the first one's inliers.
const MIN_INLIER_SHARE: f64 = 0.8;
/// Frames in a row that may fail before the rest is given up.
const MAX_FAILURES: usize = 5;

/// Frames that may still get a pose, or a better one.
pub(crate) struct Backfill {
    config: SlamConfig,
    /// Whose frames they are.
    camera: MapCamera,
    rolling_shutter: Option<RollingShutter>,
    /// Frames since the camera was last followed, oldest first.
    waiting: VecDeque<Waiting>,
    /// Where the way back begins, until the map is good enough.
    start: Option<Anchor>,
    /// The last frame that was placed.
    last: Option<Anchor>,
    /// Where the camera was when it was lost last.
    lost_at: Option<Anchor>,
    way: Option<Way>,
    /// What lies between submaps, oldest first.
    gaps: VecDeque<Gap>,
    is_mature: bool,
    /// Frames that were placed while the readout of the camera's shutter was looked for, oldest first; absent
    /// where it is not.
    rolled: Option<VecDeque<Waiting>>,
}

/// A kept frame.
#[derive(Clone)]
struct Waiting {
    view: View,
    /// Landmarks that agreed with the pose it was answered with, if it had one.
    n_inliers: Option<usize>,
}

/// A placed frame that can be found again after corrections of the map.
#[derive(Clone)]
struct Anchor {
    frame: TrackedFrame,
    place: FramePose,
}

/// Kept frames that are being visited, one after the other.
struct Way {
    tracker: Tracker,
    /// In the opposite order to that of the visit.
    views: Vec<Waiting>,
    /// Frames without a pose that were visited in vain, in the order of the visit.
    missed: Vec<Waiting>,
    /// How far it has come.
    reached: Anchor,
    n_failures: usize,
    rest: Rest,
}

/// What becomes of the frames that a way does not reach.
enum Rest {
    /// They lie behind the place where the camera was lost, if it was followed before.
    Gap(Option<Box<Anchor>>),
    /// They are visited from the other side.
    Forward(Box<Anchor>),
    /// They stay without a pose.
    Nothing,
}

/// Frames between two submaps.
struct Gap {
    before: Anchor,
    after: Anchor,
    /// Oldest first.
    views: Vec<Waiting>,
}

impl Backfill {
    pub fn new(config: SlamConfig, camera: MapCamera, rolling_shutter: Option<RollingShutter>) -> Self {
        Self {
            config,
            camera,
            rolling_shutter,
            waiting: VecDeque::new(),
            start: None,
            last: None,
            lost_at: None,
            way: None,
            gaps: VecDeque::new(),
            is_mature: false,
            rolled: None,
        }
    }

    /// Takes over what is known of the camera's shutter.
    pub fn set_rolling_shutter(&mut self, rolling_shutter: Option<RollingShutter>) {
        if let Some(way) = &mut self.way {
            way.tracker.set_rolling_shutter(rolling_shutter.clone());
        }
        self.rolling_shutter = rolling_shutter;
        // Those that were placed without regard to it are placed anew, together with those still waiting.
        for waiting in self.rolled.take().into_iter().flatten() {
            if !self.waiting.iter().any(|other| other.view.sequence == waiting.view.sequence) {
                self.waiting.push_back(waiting);
            }
        }
        self.waiting.make_contiguous().sort_by_key(|waiting| waiting.view.sequence);
    }

    /// Whether the readout of the camera's shutter is looked for: then frames are kept until it is known.
    pub fn expect_readout(&mut self, is_looked_for: bool) {
        if is_looked_for {
            self.rolled.get_or_insert_default();
        } else {
            self.rolled = None;
        }
    }

    /// Keeps a frame that got no pose, or got one while the map was young; the oldest goes when there are too
    /// many.
    pub fn keep(&mut self, view: &View, n_inliers: Option<usize>) {
        let waiting = Waiting { view: view.clone(), n_inliers };
        let max_views = self.config.initialization.max_backfill_views;
        if n_inliers.is_none() {
            self.lost_at = self.last.take().or(self.lost_at.take());
        } else {
            if let Some(rolled) = &mut self.rolled {
                push_bounded(rolled, waiting.clone(), max_views);
            }
            if self.is_mature {
                return;
            }
        }
        push_bounded(&mut self.waiting, waiting, max_views);
    }

    fn way(&self, start: Anchor, views: Vec<Waiting>, rest: Rest) -> Way {
        let tracker = Tracker::follower(self.config.clone(), self.rolling_shutter.clone());
        Way { tracker, views, missed: Vec::new(), reached: start, n_failures: 0, rest }
    }

    /// Notes that a frame was placed: the frames kept until now can be reached from it.
    pub fn placed(&mut self, frame: &TrackedFrame, map: &Map) {
        let anchor = Anchor::of(frame, map);
        if !self.waiting.is_empty() {
            self.start.clone_from(&anchor);
        }
        self.last = anchor;
    }

    /// What was placed since the camera was lost is no longer in the map: kept frames may be placed anew.
    pub fn forget_poses(&mut self) {
        if let Some(Way { views, rest: Rest::Gap(lost_at), .. }) = self.way.take_if(|way| way.is_back()) {
            self.lost_at = lost_at.map(|anchor| *anchor);
            views.into_iter().rev().for_each(|waiting| self.waiting.push_front(waiting));
        }
        self.waiting.iter_mut().for_each(|waiting| waiting.n_inliers = None);
        self.last = None;
        self.start = None;
        self.is_mature = false;
    }

    /// A new submap begins: frames without a pose may still be reached from it, and it is young again.
    pub fn begin_submap(&mut self) {
        self.waiting.retain(|waiting| waiting.n_inliers.is_none());
        if self.way.as_ref().is_some_and(Way::is_back) {
            self.end_way();
        }
        self.start = None;
        self.is_mature = false;
    }

    /// Whether there is nothing left to do.
    pub fn is_done(&self, map: &Map) -> bool {
        self.start.is_none() && self.way.is_none() && !self.gaps.iter().any(|gap| gap.is_bridged(map))
    }

    /// Tries to place one kept frame, unless the map is too young and `force` is not set.
    pub fn step(&mut self, map: &Map, force: bool) -> Option<FrameRecord> {
        if self.way.is_none() {
            self.way = self.way_back(map, force).or_else(|| self.way_into_gap(map));
        }
        let way = self.way.as_mut()?;
        let next = if way.n_failures < MAX_FAILURES { way.views.pop() } else { None };
        match next {
            Some(waiting) => way.visit(waiting, self.camera, map),
            None => {
                self.end_way();
                None
            }
        }
    }

    /// From the present frame to those kept before it.
    fn way_back(&mut self, map: &Map, force: bool) -> Option<Way> {
        let start = self.start.as_ref()?;
        let is_full = self.waiting.len() >= self.config.initialization.max_backfill_views;
        self.is_mature |= is_mature(map, &start.frame, &self.config.initialization);
        if !(self.is_mature || is_full || force) {
            return None;
        }
        let start = self.start.take()?;
        let views = std::mem::take(&mut self.waiting).into();
        let rest = Rest::Gap(self.lost_at.take().map(Box::new));
        Some(self.way(start, views, rest))
    }

    /// From the later side of a gap whose sides have come into one frame of reference.
    fn way_into_gap(&mut self, map: &Map) -> Option<Way> {
        let bridged = self.gaps.iter().position(|gap| gap.is_bridged(map))?;
        let Gap { before, after, views } = self.gaps.remove(bridged)?;
        Some(self.way(after, views, Rest::Forward(Box::new(before))))
    }

    /// Sees to the frames that a way has not reached.
    fn end_way(&mut self) {
        let Some(Way { views, missed, reached, rest, .. }) = self.way.take() else { return };
        let mut left = missed;
        left.extend(views.into_iter().rev().filter(|waiting| waiting.n_inliers.is_none()));
        if left.is_empty() {
            return;
        }
        match rest {
            Rest::Gap(Some(before)) if before.frame.submap != reached.frame.submap => {
                left.reverse();
                self.gaps.push_back(Gap { before: *before, after: reached, views: left });
                let n_kept = |gaps: &VecDeque<Gap>| gaps.iter().map(|gap| gap.views.len()).sum::<usize>();
                while n_kept(&self.gaps) > self.config.initialization.max_backfill_views {
                    self.gaps.pop_front();
                }
            }
            Rest::Forward(before) => {
                self.way = Some(self.way(*before, left, Rest::Nothing));
            }
            Rest::Gap(_) | Rest::Nothing => {}
        }
    }
}

/// Adds a frame; the oldest goes when there are too many.
fn push_bounded(frames: &mut VecDeque<Waiting>, frame: Waiting, max_frames: usize) {
    if frames.len() >= max_frames {
        frames.pop_front();
    }
    frames.push_back(frame);
}

impl Anchor {
    fn of(frame: &TrackedFrame, map: &Map) -> Option<Self> {
        Some(Self { frame: frame.clone(), place: frame.pose_in(map)? })
    }

    /// The frame where the map now has it.
    fn now(&self, map: &Map) -> Option<TrackedFrame> {
        let (submap, camera_from_world) = map.locate(&self.place)?;
        Some(TrackedFrame { submap, camera_from_world, ..self.frame.clone() })
    }
}

impl Gap {
    /// Whether both sides are in one frame of reference.
    fn is_bridged(&self, map: &Map) -> bool {
        let submap = |anchor: &Anchor| map.locate(&anchor.place).map(|(submap, _)| submap);
        submap(&self.before).is_some_and(|before| submap(&self.after) == Some(before))
    }
}

impl Way {
    /// Whether it leads back from the present, rather than into a gap.
    fn is_back(&self) -> bool {
        matches!(self.rest, Rest::Gap(_))
    }

    /// Tries to place a frame next to the one reached last.
    fn visit(&mut self, waiting: Waiting, camera: MapCamera, map: &Map) -> Option<FrameRecord> {
        let Waiting { mut view, n_inliers } = waiting;
        view.correct_camera(&map.correction_of(camera));
        match self.tracker.last_frame() {
            Some(_) => self.tracker.sync_map(map),
            None => self.tracker.start(self.reached.now(map)?, map),
        }
        // What bundle adjustment says of a keyframe is better than any pose found from one frame.
        let is_kept =
            |keyframe: &&Keyframe| keyframe.sequence == view.sequence && keyframe.camera.id == camera.id;
        if let Some(keyframe) = map.keyframes().find(is_kept)
            && keyframe.submap == self.reached.frame.submap
        {
            let frame = TrackedFrame::of_keyframe(keyframe);
            self.reached = Anchor::of(&frame, map)?;
            self.tracker.pass(frame, map);
            self.n_failures = 0;
            return None;
        }
        let tracked = self.tracker.track(&view, map);
        let placed = tracked.frame.filter(|_| matches!(tracked.outcome, TrackingOutcome::Tracked));
        let Some(anchor) = placed.and_then(|frame| Anchor::of(&frame, map)) else {
            self.n_failures += 1;
            // The next is looked for from where the way had come, without a motion.
            self.tracker.forget();
            if n_inliers.is_none() {
                self.missed.push(Waiting { view, n_inliers });
            }
            return None;
        };
        self.n_failures = 0;
        let pose = Some(anchor.place);
        self.reached = anchor;
        let n_required = MIN_INLIER_SHARE * n_inliers.unwrap_or(0) as f64;
        (tracked.inliers.total() as f64 >= n_required).then_some(FrameRecord {
            camera: camera.id,
            sequence: view.sequence,
            timestamp_ns: view.timestamp_ns,
            state: FrameState::Tracked,
            pose,
            backfilled: n_inliers.is_none(),
            reason: String::new(),
        })
    }
}

/// Whether the keyframes of the frame's submap are many enough, and spread widely enough, for its depths to
/// be known well.
fn is_mature(map: &Map, frame: &TrackedFrame, config: &InitializationConfig) -> bool {
    let in_submap = || map.keyframes_of(frame.submap);
    if in_submap().take(config.mature_keyframes).count() < config.mature_keyframes {
        return false;
    }
    let Some(origin) = in_submap().next() else { return false };
    let Some(median_depth) = map.keyframe(frame.reference).and_then(|reference| median_depth(map, reference))
    else {
        return false;
    };
    let origin = origin.camera_from_world.center();
    in_submap().any(|other| {
        (other.camera_from_world.center() - origin).norm() >= config.mature_baseline_share * median_depth
    })
}
