//! Map initialization (two-view bootstrap): two views far enough apart, a motion between them that nothing
//! else explains, and a third view that agrees.

mod correspondence;
mod matching;
mod motion;
mod pace;
mod third_view;
mod two_view;
mod unrolling;

use crate::bundle;
use crate::config::{InitializationConfig, SlamConfig, Threading};
use crate::features::View;
use crate::parallel;
use crate::report::InitializationWait;
use crate::rolling_shutter::RollingShutter;
use geometry::nalgebra::Vector3;
use geometry::{CameraCorrection, Pose};
use pace::Pace;
use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use two_view::TwoViewMotion;

/// The width of image that pixel distances in the configuration are meant for.
const REFERENCE_WIDTH_PX: f64 = 640.0;

/// Demands on the direction of motion fall to a share of one over this at most.
const MAX_RELAXATION: f64 = 2.5;

/// Two views with the motion between them and what both see. The median depth in the first view is 1.
#[derive(Clone, Debug)]
pub(crate) struct InitialPair {
    pub first: View,
    pub second: View,
    pub second_from_first: Pose,
    /// Keypoint of the first view, keypoint of the second, position in the first camera's frame.
    pub points: Vec<(usize, usize, Vector3<f64>)>,
    /// The camera they were found with, if that was only tried.
    pub hypothesis: Option<CameraCorrection>,
}

/// Keeps recent views and tries to start a map from pairs of them.
pub(crate) struct Initializer {
    config: InitializationConfig,
    views: VecDeque<View>,
    /// Views tried since the start.
    n_waited: usize,
    pace: Pace,
    rng: ChaCha8Rng,
    threading: Threading,
    /// Cameras to be tried in turn, view by view; none where the camera is known.
    hypotheses: Vec<CameraCorrection>,
    /// Absent where all rows of an image are read at once.
    rolling_shutter: Option<RollingShutter>,
}

impl Initializer {
    /// `is_first` says that there is no map yet, whose camera would be that of this one too.
    pub fn new(config: &SlamConfig, is_first: bool, rolling_shutter: Option<RollingShutter>) -> Self {
        Self {
            rolling_shutter,
            hypotheses: if is_first { config.calibration.hypotheses() } else { Vec::new() },
            config: config.initialization.clone(),
            views: VecDeque::new(),
            n_waited: 0,
            pace: Pace::default(),
            rng: ChaCha8Rng::seed_from_u64(config.seed),
            threading: config.threading,
        }
    }

    /// Tries to start a map with this view as the second one; keeps it as a possible first one otherwise.
    pub fn try_start(&mut self, view: View) -> Result<InitialPair, InitializationWait> {
        let (n_keypoints, n_required) = (view.features.len(), self.config.min_keypoints);
        if n_keypoints < n_required {
            return Err(InitializationWait::TooFewFeatures { n_keypoints, n_required });
        }
        // Where cameras are tried in turn, none is to miss its turn.
        let passed = self.pace.wait_at(self.n_waited).filter(|_| self.hypotheses.is_empty());
        let attempt = passed.map_or_else(|| self.attempt(&view), Err);
        if let Err(wait) = &attempt {
            if passed.is_none() {
                self.pace.note(self.n_waited, *wait);
            }
            self.keep(view);
        }
        self.n_waited += 1;
        attempt
    }

    /// Begins anew with the next view.
    pub fn forget_views(&mut self) {
        self.views.clear();
        self.pace = Pace::default();
    }

    /// Keeps a view. When there are too many every second one goes, so that a slow camera can still look far
    /// back.
    fn keep(&mut self, view: View) {
        if self.views.len() >= self.config.max_reference_views {
            let mut position = 0;
            self.views.retain(|_| {
                position += 1;
                position % 2 == 1
            });
        }
        self.views.push_back(view);
    }

    /// Tries pairs from the widest baseline to shorter ones: the widest beside the others, unless all is to
    /// be inline.
    fn attempt(&mut self, view: &View) -> Result<InitialPair, InitializationWait> {
        let mut wait = InitializationWait::FirstView;
        let mut oldest_matches = Vec::new();
        // Views too old to share anything with the present one only cost time.
        while let Some(oldest) = self.views.front() {
            oldest_matches = self.matches(oldest, view);
            let (n_matches, n_required) = (oldest_matches.len(), self.config.min_matches);
            if n_matches >= n_required {
                break;
            }
            wait = InitializationWait::TooFewMatches { n_matches, n_required };
            self.views.pop_front();
        }
        let n = self.views.len();
        let mut positions: Vec<usize> = (0..self.config.max_attempts_per_frame)
            .map(|attempt| n - (n >> attempt))
            .filter(|at| *at < n)
            .collect();
        positions.dedup();
        let Some((widest, others)) = positions.split_first() else { return Err(wait) };
        // Random numbers of their own, so that the threads do not matter.
        let mut rngs = [self.rng.next_u64(), self.rng.next_u64()].map(ChaCha8Rng::seed_from_u64);
        let [rng, rng_of_others] = &mut rngs;
        let try_widest = || self.try_pair(&self.views[*widest], view, &oldest_matches, rng);
        let try_others = || {
            let mut tried = others.iter().map(|position| {
                let reference = &self.views[*position];
                self.try_pair(reference, view, &self.matches(reference, view), rng_of_others)
            });
            first_success(&mut tried)
        };
        let tried = match self.threading {
            Threading::Background if !others.is_empty() => {
                let (widest, others) = parallel::join("initialise", try_widest, try_others);
                first_success(&mut [widest, others].into_iter())
            }
            _ => first_success(&mut std::iter::once_with(try_widest).chain(std::iter::once_with(try_others))),
        };
        tried.map_err(|reason| more_telling(wait, reason))
    }

    fn matches(&self, first: &View, second: &View) -> Vec<(usize, usize)> {
        let radius_px = self.config.search_radius_px * first.features.width_px() / REFERENCE_WIDTH_PX;
        matching::match_views(&first.features, &second.features, radius_px)
    }

    fn try_pair(
        &self,
        first: &View,
        second: &View,
        matches: &[(usize, usize)],
        rng: &mut ChaCha8Rng,
    ) -> Result<InitialPair, InitializationWait> {
        let (n_matches, n_required) = (matches.len(), self.config.min_matches);
        if n_matches < n_required {
            return Err(InitializationWait::TooFewMatches { n_matches, n_required });
        }
        let hypothesis = self.hypothesis();
        let [first, second] = &[first, second].map(|view| with_camera(view, hypothesis.as_ref()));
        let config = self.relaxed();
        let motion = two_view::solve(&first.features, &second.features, matches, &config, rng)?;
        let (mut pair, mut direction_sigma_deg) = refine(first, second, matches, &motion);
        if let Some([first, second]) = self.unroll(&pair, rng) {
            (pair, direction_sigma_deg) = refine(&first, &second, matches, &motion);
        }
        let n_agreeing = pair.points.len();
        let required_deg = config.max_direction_sigma_deg;
        if direction_sigma_deg > required_deg {
            return Err(InitializationWait::UncertainMotion { direction_sigma_deg, required_deg });
        }
        if n_agreeing < self.config.min_points {
            return Err(InitializationWait::Ambiguous { n_agreeing, n_runner_up: 0, n_matches });
        }
        pair.hypothesis = hypothesis;
        self.confirm(pair, rng)
    }

    fn unroll(&self, pair: &InitialPair, rng: &mut ChaCha8Rng) -> Option<[View; 2]> {
        let shutter = self.rolling_shutter.as_ref()?;
        let camera = self.hypothesis();
        let views: Vec<View> = self.views.iter().map(|view| with_camera(view, camera.as_ref())).collect();
        unrolling::unroll_pair(shutter, pair, &views, &self.config, rng)
    }

    /// Takes over what is known of the camera's shutter.
    pub fn set_rolling_shutter(&mut self, rolling_shutter: Option<RollingShutter>) {
        self.rolling_shutter = rolling_shutter;
    }

    /// The camera whose turn it is: a wrong one may still do for a map, but sees more motions as doubtful.
    fn hypothesis(&self) -> Option<CameraCorrection> {
        let n = self.hypotheses.len();
        (n > 0).then(|| self.hypotheses[self.n_waited % n])
    }

    /// How well the direction of motion must be known, and how far a motion must lead. A camera that has
    /// moved for long without a good pair will hardly offer a better one, so less is asked for with time.
    fn relaxed(&self) -> InitializationConfig {
        let patience = self.config.patience_views.max(1) as f64;
        let relaxation = (1.0 + self.n_waited as f64 / patience).min(MAX_RELAXATION);
        InitializationConfig {
            max_direction_sigma_deg: self.config.max_direction_sigma_deg * relaxation,
            min_runner_up_lead: self.config.min_runner_up_lead / relaxation,
            ..self.config.clone()
        }
    }

    /// A further view must see the points where the motion puts them: one between the two, or else one before
    /// them.
    fn confirm(&self, pair: InitialPair, rng: &mut ChaCha8Rng) -> Result<InitialPair, InitializationWait> {
        let inside =
            |view: &&View| view.sequence > pair.first.sequence && view.sequence < pair.second.sequence;
        let between: Vec<&View> = self.views.iter().filter(inside).collect();
        let before = self.views.iter().rev().find(|view| view.sequence < pair.first.sequence);
        let Some(third) = between.get(between.len() / 2).copied().or(before) else {
            return Err(InitializationWait::FirstView);
        };
        let third = with_camera(third, pair.hypothesis.as_ref());
        let (n_confirmed, n_looked_for) = third_view::confirm(&pair, &third, &self.config, rng);
        if (n_confirmed as f64) < self.config.min_third_view_share * n_looked_for as f64 {
            let (n_agreeing, n_matches) = (n_confirmed, n_looked_for);
            return Err(InitializationWait::Ambiguous { n_agreeing, n_runner_up: 0, n_matches });
        }
        Ok(pair)
    }
}

/// A view as another camera would have it.
fn with_camera(view: &View, camera: Option<&CameraCorrection>) -> View {
    let mut view = view.clone();
    if let Some(camera) = camera {
        view.correct_camera(camera);
    }
    view
}

/// The first that succeeded, later ones not tried; else the most telling reason.
fn first_success(
    attempts: &mut dyn Iterator<Item = Result<InitialPair, InitializationWait>>,
) -> Result<InitialPair, InitializationWait> {
    let mut wait = InitializationWait::FirstView;
    for attempt in attempts {
        match attempt {
            Ok(pair) => return Ok(pair),
            Err(reason) => wait = more_telling(wait, reason),
        }
    }
    Err(wait)
}

/// The reason that is nearer to success: few matches, then little parallax, then ambiguity.
fn more_telling(a: InitializationWait, b: InitializationWait) -> InitializationWait {
    let rank = |wait: &InitializationWait| match wait {
        InitializationWait::FirstView | InitializationWait::MappingDisabled => 0,
        InitializationWait::TooFewFeatures { .. } => 1,
        InitializationWait::TooFewMatches { .. } => 2,
        InitializationWait::TooLittleParallax { .. } => 3,
        InitializationWait::UncertainMotion { .. } => 4,
        InitializationWait::Ambiguous { .. } => 5,
    };
    if rank(&b) > rank(&a) { b } else { a }
}

/// Bundle adjustment of the two views, points that disagree left out, and the median depth as the unit of
/// length. Also returns the standard deviation of the direction of motion, degrees.
fn refine(
    first: &View,
    second: &View,
    matches: &[(usize, usize)],
    motion: &TwoViewMotion,
) -> (InitialPair, f64) {
    let problem: Vec<_> = motion
        .points
        .iter()
        .map(|(match_idx, position)| {
            (*position, two_view::factors(&first.features, &second.features, matches[*match_idx]))
        })
        .collect();
    let refined = bundle::two_view::refine(motion.second_from_first, &problem);
    let mut points: Vec<(usize, usize, Vector3<f64>)> = motion
        .points
        .iter()
        .zip(refined.points)
        .filter_map(|((match_idx, _), position)| {
            let (a, b) = matches[*match_idx];
            Some((a, b, position?))
        })
        .collect();
    let mut depths: Vec<f64> = points.iter().map(|(_, _, position)| position.z).collect();
    depths.sort_by(f64::total_cmp);
    let unit = depths.get(depths.len() / 2).copied().unwrap_or(1.0);
    points.iter_mut().for_each(|(_, _, position)| *position /= unit);
    let pose = refined.second_from_first;
    let second_from_first = Pose::new(pose.rotation, pose.translation / unit);
    let pair = InitialPair {
        first: first.clone(),
        second: second.clone(),
        second_from_first,
        points,
        hypothesis: None,
    };
    (pair, refined.direction_sigma_deg)
}
