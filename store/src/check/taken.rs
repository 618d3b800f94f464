//! Which features are taken: each sees one landmark at most.

use super::{Findings, Measured};
use slam::map::KeyframeId;
use std::collections::BTreeMap;
use std::fmt::Display;

/// The features of one kind, by keyframe, with whether they are taken.
pub(super) struct Taken {
    thing: &'static str,
    feature: &'static str,
    features: BTreeMap<KeyframeId, Vec<bool>>,
}

impl Taken {
    /// None is taken. The words name the thing that is seen and what sees it.
    pub fn new(words: [&'static str; 2], measured: &Measured, count: fn(&[usize; 3]) -> &usize) -> Self {
        let [thing, feature] = words;
        let features = measured.iter().map(|(id, counts)| (*id, vec![false; *count(counts)])).collect();
        Self { thing, feature, features }
    }

    /// Takes a feature for the thing with this id; notes what is wrong if that is not possible.
    pub fn take(
        &mut self,
        id: &dyn Display,
        keyframe: KeyframeId,
        feature_idx: u32,
        problems: &mut Findings,
    ) {
        let Self { thing, feature, features } = self;
        let what = match features.get_mut(&keyframe).map(|taken| taken.get_mut(feature_idx as usize)) {
            None => "a keyframe that is not there".to_owned(),
            Some(None) => format!("a {feature} its keyframe does not have"),
            Some(Some(taken)) if *taken => format!("a {feature} that another {thing} is seen by"),
            Some(Some(taken)) => {
                *taken = true;
                return;
            }
        };
        problems.add(format!("{thing} {id} is seen by {what}: {feature_idx} of {keyframe}"));
    }
}
