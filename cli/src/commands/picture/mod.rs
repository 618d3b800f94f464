//! Pictures of maps and trajectories seen from above: one SVG file that needs nothing else, readable on light
//! and dark pages.

pub mod chart;
mod graph;
mod svg;
mod view;

pub use graph::Graph;

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use geometry::nalgebra::Vector3;
use geometry::{Pose, Similarity};
use recordings::{Trajectory, associate};

use svg::{Entry, Mark, Sheet, Style};
use view::{Frame, TopView};

/// Poses further apart in time than this are not of the same image, nanoseconds, as in an evaluation.
const MAX_DT_NS: i64 = 10_000_000;
/// Primitives with a color of their own, those with most lines first. The others share one.
const N_COLORS: usize = 6;
/// Points that are drawn, at most: 11 bytes each. Of more, every second or third is.
const MAX_POINTS: usize = 8000;
/// Lines that are drawn, at most: 20 bytes each. Likewise.
const MAX_LINES: usize = 3000;
/// Steps of the usual length between two poses that make a gap, in which no way is drawn.
const GAP_STEPS: i64 = 20;
/// Vertices of a trajectory that are drawn, at most: 10 bytes each. Likewise.
const MAX_VERTICES: usize = 2500;

/// Where a picture looks from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From above.
    Above,
    /// From the side, level.
    Side,
}

/// A line landmark.
#[derive(Clone, Debug)]
pub struct MapLine {
    /// The ends of the part that was seen, map units.
    pub ends: [Vector3<f64>; 2],
    /// The global primitive it belongs to, if it does.
    pub primitive: Option<u64>,
}

/// What is drawn. Map and estimate are in the map's world, the truth in its own.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// What is in the picture, for who cannot see it.
    pub title: String,
    /// The true trajectory, if it is known: everything is brought into its world.
    pub truth: Option<Trajectory>,
    /// The estimated trajectory.
    pub estimate: Trajectory,
    /// The points of the map.
    pub points: Vec<Vector3<f64>>,
    /// The lines of the map.
    pub lines: Vec<MapLine>,
}

impl Scene {
    /// Draws it into a file.
    ///
    /// # Errors
    /// As [`Self::draw`], or if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = self.draw()?;
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    }

    /// The picture from above.
    ///
    /// # Errors
    /// If there is no pose, or truth and estimate have too little in common to be laid over each other.
    pub fn draw(&self) -> Result<String> {
        self.draw_from(Direction::Above)
    }

    /// How far the estimate is from the truth at the times they have in common: seconds from the first, and
    /// distance after alignment in units of the truth. `None` without a truth that it can be laid over.
    pub fn position_errors(&self) -> Option<Vec<[f64; 2]>> {
        let truth = self.truth.as_ref()?;
        let truth_from_map = alignment(truth, &self.estimate).ok()?;
        let matches = associate(truth, &self.estimate, MAX_DT_NS);
        let first_ns = truth.poses()[matches.first()?.truth_idx].timestamp_ns;
        let error = |found: &recordings::Match| {
            let (truth, estimate) =
                (truth.poses()[found.truth_idx], self.estimate.poses()[found.estimate_idx]);
            let place = truth_from_map.transform(&estimate.world_from_camera.translation);
            let seconds = truth.timestamp_ns.saturating_sub(first_ns) as f64 * 1e-9;
            [seconds, (place - truth.world_from_camera.translation).norm()]
        };
        Some(matches.iter().map(error).collect())
    }

    /// The picture.
    ///
    /// # Errors
    /// As [`Self::draw`].
    pub fn draw_from(&self, direction: Direction) -> Result<String> {
        let aligned = self.aligned()?;
        let truth: Vec<Pose> = self.truth.iter().flat_map(poses).collect();
        let view = TopView::of(if truth.is_empty() { &aligned.estimate } else { &truth }, &aligned.lines)
            .context("there is no pose to draw")?;
        let view = if direction == Direction::Side { view.seen_from_the_side() } else { view };
        let path = |poses: &[Pose]| -> Vec<[f64; 2]> {
            poses.iter().map(|pose| view.seen(&pose.translation)).collect()
        };
        let (truth, estimate) = (path(&truth), path(&aligned.estimate));
        let points: Vec<[f64; 2]> = aligned.points.iter().map(|point| view.seen(point)).collect();
        let lines: Vec<[[f64; 2]; 2]> =
            aligned.lines.iter().map(|ends| ends.each_ref().map(|end| view.seen(end))).collect();
        let frame = Frame::around([&truth, &estimate], points.iter().chain(lines.as_flattened()));
        let mut sheet = Sheet::new(&self.title, &frame);
        self.add_map(&mut sheet, &points, &lines);
        if let Some(trajectory) = &self.truth {
            let mark = Mark::Paths(pieces(&truth, trajectory));
            sheet.add(Entry { label: "truth".to_owned(), style: Style::Truth, mark });
        }
        let label = format!("estimate, {} poses", estimate.len());
        let mark = Mark::Paths(pieces(&estimate, &self.estimate));
        sheet.add(Entry { label, style: Style::Estimate, mark });
        let unit = if self.truth.is_some() { "of the truth" } else { "of the map" };
        Ok(sheet.finish(unit))
    }

    fn add_map(&self, sheet: &mut Sheet, points: &[[f64; 2]], lines: &[[[f64; 2]; 2]]) {
        if !points.is_empty() {
            let label = format!("{} points", points.len());
            sheet.add(Entry { label, style: Style::Points, mark: Mark::Points(thinned(points, MAX_POINTS)) });
        }
        let share = lines.len().div_ceil(MAX_LINES).max(1);
        for (style, label, members) in self.groups_of_lines() {
            let segments = members.into_iter().step_by(share).map(|line_idx| lines[line_idx]).collect();
            sheet.add(Entry { label, style, mark: Mark::Segments(segments) });
        }
    }

    /// The lines by primitive, those without one first, so that the others lie on top of them.
    fn groups_of_lines(&self) -> Vec<(Style, String, Vec<usize>)> {
        let mut by_primitive: BTreeMap<Option<u64>, Vec<usize>> = BTreeMap::new();
        for (line_idx, line) in self.lines.iter().enumerate() {
            by_primitive.entry(line.primitive).or_default().push(line_idx);
        }
        let without = by_primitive.remove(&None);
        let mut primitives: Vec<(Option<u64>, Vec<usize>)> = by_primitive.into_iter().collect();
        primitives.sort_by_key(|(_, lines)| std::cmp::Reverse(lines.len()));
        let others: Vec<usize> = primitives
            .split_off(primitives.len().min(N_COLORS))
            .into_iter()
            .flat_map(|(_, lines)| lines)
            .collect();
        let mut groups = Vec::new();
        groups.extend(
            without.map(|lines| (Style::Lines, format!("{} lines without a primitive", lines.len()), lines)),
        );
        if !others.is_empty() {
            groups.push((
                Style::OtherPrimitives,
                format!("{} lines of other primitives", others.len()),
                others,
            ));
        }
        for (color_idx, (id, lines)) in primitives.into_iter().enumerate() {
            let label = format!("primitive {}, {} lines", id.unwrap_or_default(), lines.len());
            groups.push((Style::Primitive(color_idx), label, lines));
        }
        groups
    }

    /// Everything in the world of the truth, if there is one.
    fn aligned(&self) -> Result<Aligned> {
        let world_from_map = match &self.truth {
            Some(truth) => alignment(truth, &self.estimate)?,
            None => Similarity::identity(),
        };
        let point = |point: &Vector3<f64>| world_from_map.transform(point);
        let pose = |pose: Pose| Pose::new(world_from_map.rotation * pose.rotation, point(&pose.translation));
        Ok(Aligned {
            estimate: poses(&self.estimate).map(pose).collect(),
            points: self.points.iter().map(point).collect(),
            lines: self.lines.iter().map(|line| line.ends.each_ref().map(point)).collect(),
        })
    }
}

struct Aligned {
    estimate: Vec<Pose>,
    points: Vec<Vector3<f64>>,
    lines: Vec<[Vector3<f64>; 2]>,
}

fn poses(trajectory: &Trajectory) -> impl Iterator<Item = Pose> + '_ {
    trajectory.poses().iter().map(|stamped| stamped.world_from_camera)
}

/// The similarity that brings the estimate onto the truth, as an evaluation finds it.
fn alignment(truth: &Trajectory, estimate: &Trajectory) -> Result<Similarity> {
    let matches = associate(truth, estimate, MAX_DT_NS);
    ensure!(matches.len() >= 3, "truth and estimate have {} times in common; 3 are needed", matches.len());
    let position =
        |trajectory: &Trajectory, idx: usize| trajectory.poses()[idx].world_from_camera.translation;
    let truth: Vec<_> = matches.iter().map(|found| position(truth, found.truth_idx)).collect();
    let estimate: Vec<_> = matches.iter().map(|found| position(estimate, found.estimate_idx)).collect();
    Similarity::from_correspondences(&estimate, &truth, true).context(
        "the positions lie on one line or in one point, so no rotation lays the trajectories over each other",
    )
}

/// A path in pieces, which end where the trajectory has a gap: nothing is known of the way across.
fn pieces(path: &[[f64; 2]], trajectory: &Trajectory) -> Vec<Vec<[f64; 2]>> {
    let steps =
        trajectory.poses().windows(2).map(|pair| pair[1].timestamp_ns.saturating_sub(pair[0].timestamp_ns));
    let steps: Vec<i64> = steps.collect();
    let mut sorted = steps.clone();
    sorted.sort_unstable();
    let longest = sorted.get(sorted.len() / 2).map_or(i64::MAX, |median| median.saturating_mul(GAP_STEPS));
    let mut pieces = Vec::new();
    let mut start = 0;
    let ends = steps.iter().enumerate().filter(|(_, step)| **step > longest).map(|(idx, _)| idx + 1);
    for end in ends.chain([path.len()]) {
        // In proportion, so that many pieces are not more vertices than one.
        let most = (MAX_VERTICES * (end - start)).div_ceil(path.len().max(1));
        pieces.push(thinned(&path[start..end], most.max(2)));
        start = end;
    }
    pieces
}

/// At most so many of them, evenly, with the first and the last.
fn thinned(all: &[[f64; 2]], most: usize) -> Vec<[f64; 2]> {
    let share = all.len().div_ceil(most).max(1);
    let mut kept: Vec<_> = all.iter().step_by(share).copied().collect();
    if share > 1 {
        kept.extend(all.last());
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use recordings::StampedPose;

    /// A circle, `scale` times as large as that of the other trajectory.
    fn circle(scale: f64) -> Trajectory {
        let pose = |i: u32| {
            let angle = f64::from(i) * 0.1;
            // Cameras look along z, and down is y.
            let translation = scale * Vector3::new(angle.cos(), 0.0, angle.sin());
            let world_from_camera = Pose::new(Default::default(), translation);
            StampedPose { timestamp_ns: i64::from(i) * 100_000_000, world_from_camera }
        };
        Trajectory::new((0..60).map(pose).collect())
    }

    fn scene() -> Scene {
        let line = |i: u64, primitive| {
            let start = Vector3::new(i as f64 * 0.1, 0.0, 0.0);
            MapLine { ends: [start, start + Vector3::z()], primitive }
        };
        let mut lines: Vec<MapLine> = (0..6).map(|i| line(i, Some(i % 2))).collect();
        lines.extend([line(7, None), line(8, Some(0))]);
        Scene {
            title: "a circle".to_owned(),
            truth: Some(circle(2.0)),
            estimate: circle(1.0),
            points: vec![Vector3::new(0.5, -1.0, 0.5); 10],
            lines,
        }
    }

    /// The path of a style.
    fn path<'a>(picture: &'a str, style: &str) -> &'a str {
        let start = format!("<path class=\"{style}\" d=\"");
        picture.split_once(&start).and_then(|(_, rest)| rest.split_once('"')).map_or("", |(path, _)| path)
    }

    #[test]
    fn a_scaled_circle_is_not_off_and_is_flat_seen_from_the_side() {
        let errors = scene().position_errors().unwrap();
        assert!(errors.len() == 60 && errors.iter().all(|error| error[1] < 1e-9));
        assert!((errors[59][0] - 5.9).abs() < 1e-9);
        assert_ne!(scene().draw_from(Direction::Side).unwrap(), scene().draw().unwrap());
        assert!(Scene { truth: None, ..scene() }.position_errors().is_none());
    }

    #[test]
    fn the_estimate_is_laid_over_the_truth() {
        let picture = scene().draw().unwrap();
        assert!(path(&picture, "truth").len() > 300);
        assert_eq!(path(&picture, "truth"), path(&picture, "estimate"));
        for label in
            ["10 points", "primitive 0, 4 lines", "primitive 1, 3 lines", "1 lines without a primitive"]
        {
            assert!(picture.contains(label), "{label}");
        }
        assert_eq!(path(&picture, "p0").matches('M').count(), 4);
    }

    #[test]
    fn no_way_is_drawn_across_a_gap() {
        let mut scene = scene();
        let poses = scene.estimate.poses().iter().enumerate();
        let kept = poses.filter(|(idx, _)| !(10..40).contains(idx)).map(|(_, pose)| *pose);
        scene.estimate = Trajectory::new(kept.collect());
        let picture = scene.draw().unwrap();
        assert_eq!(path(&picture, "estimate").matches('M').count(), 2);
        assert_eq!(path(&picture, "truth").matches('M').count(), 1);
    }

    #[test]
    fn a_large_map_makes_a_small_file() {
        let mut scene = scene();
        scene.points =
            (0..100_000).map(|i| Vector3::new(f64::from(i % 300) * 0.01, 0.0, f64::from(i) * 3e-5)).collect();
        scene.lines = std::iter::repeat_with(|| scene.lines.clone()).take(3000).flatten().collect();
        let picture = scene.draw().unwrap();
        assert!(picture.len() < 200_000, "{} bytes", picture.len());
        assert!(picture.contains("100000 points"), "what is left out is counted");
    }

    #[test]
    fn what_cannot_be_drawn_is_said() {
        let message = |scene: &Scene| scene.draw().unwrap_err().to_string();
        assert!(message(&Scene::default()).contains("no pose"));
        let apart = Scene { estimate: Trajectory::default(), ..scene() };
        assert!(message(&apart).contains("0 times in common"));
    }
}
