//! Keyframes and what ties them, seen from above.

use std::collections::BTreeMap;

use geometry::Pose;
use geometry::nalgebra::Vector3;

use super::svg::{Entry, Mark, Sheet, Style};
use super::view::{Frame, TopView};
use super::{Scene, poses};

/// Edges of a kind that are drawn, at most. Of more, every second or third is.
const MAX_EDGES: usize = 3000;

/// What is drawn, in the world of the map.
#[derive(Clone, Debug, Default)]
pub struct Graph {
    /// What is in the picture, for who cannot see it.
    pub title: String,
    /// Where keyframes are, by their number.
    pub keyframes: BTreeMap<u64, Vector3<f64>>,
    /// Pairs that share landmarks.
    pub covisible: Vec<[u64; 2]>,
    /// Pairs that see the same global primitive.
    pub tied: Vec<[u64; 2]>,
}

impl Graph {
    /// The picture, turned as that of the scene is; `None` without keyframes.
    pub fn draw(&self, scene: &Scene) -> Option<String> {
        let estimate: Vec<Pose> = poses(&scene.estimate).collect();
        let lines: Vec<[Vector3<f64>; 2]> = scene.lines.iter().map(|line| line.ends).collect();
        let view = TopView::of(&estimate, &lines)?;
        let places: BTreeMap<u64, [f64; 2]> =
            self.keyframes.iter().map(|(id, place)| (*id, view.seen(place))).collect();
        let dots: Vec<[f64; 2]> = places.values().copied().collect();
        if dots.is_empty() {
            return None;
        }
        let segments = |pairs: &[[u64; 2]]| -> Vec<[[f64; 2]; 2]> {
            let share = pairs.len().div_ceil(MAX_EDGES).max(1);
            let ends = |[from, to]: &[u64; 2]| Some([*places.get(from)?, *places.get(to)?]);
            pairs.iter().step_by(share).filter_map(ends).collect()
        };
        let mut sheet = Sheet::new(&self.title, &Frame::around([&dots, &Vec::new()], [].iter()));
        let edges = |what: &str, pairs: &[[u64; 2]], style| {
            let label = format!("{} {what}", pairs.len());
            Entry { label, style, mark: Mark::Segments(segments(pairs)) }
        };
        sheet.add(edges("pairs share a primitive", &self.tied, Style::Tied));
        sheet.add(edges("pairs share landmarks", &self.covisible, Style::Covisible));
        let label = format!("{} keyframes", dots.len());
        sheet.add(Entry { label, style: Style::Keyframes, mark: Mark::Points(dots) });
        Some(sheet.finish("of the map"))
    }
}
