//! What a report is made of, as the server tells it.

use std::collections::{BTreeMap, HashSet};

use anyhow::{Context, Result};
use client::HttpClient;
use geometry::nalgebra::Vector3;
use recordings::Trajectory;
use serde_json::{Map, Value, json};

use crate::commands::picture::MapLine;
use crate::commands::progress::StepBar;

/// Points in the page at most, at some 60 bytes a point: of a larger map every second, or third, and so on.
const MAX_POINTS: usize = 150_000;

/// A session with all that is shown of it.
pub struct Gathered {
    /// The session, as the interface tells it.
    pub session: Value,
    /// The parts of its scene.
    pub scene: Vec<Value>,
    /// Pairs of keyframes with common landmarks.
    pub covisibility: Value,
    /// Pairs of keyframes that see the same global primitive.
    pub ties: Value,
    /// By keyframe, image and measurements of those that are shown.
    pub images: Map<String, Value>,
    /// The trajectory of the largest submap.
    pub trajectory: Trajectory,
}

impl Gathered {
    /// Fetches it, with the images of so many keyframes, evenly over the session.
    pub async fn fetch(http: &HttpClient, session: &str, n_images: usize) -> Result<Self> {
        let bar = StepBar::new("parts of the report", 5 + n_images);
        let told = http.session_json(session, "").await?;
        bar.advance();
        let mut lines = Vec::new();
        http.write_scene(session, &mut lines).await?;
        let parts = lines.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
        let mut scene: Vec<Value> =
            parts.map(serde_json::from_slice).collect::<Result<_, _>>().context("the map cannot be read")?;
        bar.advance();
        let covisibility = http.session_json(session, "graph?kind=covisibility&min_weight=1").await?;
        bar.advance();
        let ties = http.session_json(session, "graph?kind=primitives").await?;
        bar.advance();
        let trajectory = http.trajectory(session).await?;
        bar.advance();
        let mut images = Map::new();
        for keyframe in chosen(&scene, n_images) {
            let image = http.keyframe_image(session, keyframe).await?;
            let observed = http.session_json(session, &format!("keyframes/{keyframe}/observed")).await?;
            let address = super::page::data_address(&image.media_type, &image.bytes);
            images.insert(keyframe.to_string(), json!({ "image": address, "observed": observed }));
            bar.advance();
        }
        thin_points(&mut scene);
        mark_images(&mut scene, &images);
        let edges = |mut graph: Value| graph["edges"].take();
        let (covisibility, ties) = (edges(covisibility), edges(ties));
        Ok(Self { session: told, scene, covisibility, ties, images, trajectory })
    }

    /// The rows of a kind of part: the values of some columns, row by row.
    fn rows<'a, const N: usize>(
        &'a self,
        part: &'a str,
        columns: [&'a str; N],
    ) -> impl Iterator<Item = [&'a Value; N]> {
        rows(&self.scene, part, columns)
    }

    /// What a length in the trajectory is in map units, inverted: metres, or one.
    fn scale(&self) -> f64 {
        self.session["metres_per_unit"].as_f64().unwrap_or(1.0)
    }

    /// The submap with the most keyframes, which the trajectory is of.
    fn largest_submap(&self) -> Option<u64> {
        let mut n_keyframes: BTreeMap<u64, usize> = BTreeMap::new();
        for [submap] in self.rows("keyframes", ["submap_ids"]) {
            *n_keyframes.entry(submap.as_u64()?).or_default() += 1;
        }
        n_keyframes.into_iter().max_by_key(|(submap, n)| (*n, std::cmp::Reverse(*submap))).map(|(id, _)| id)
    }

    /// The points of the largest submap, in the unit of the trajectory.
    pub fn points(&self) -> Vec<Vector3<f64>> {
        let largest = self.largest_submap();
        let rows = self.rows("points", ["submap_ids", "positions"]);
        let of_submap = rows.filter(|[submap, _]| submap.as_u64() == largest);
        of_submap.filter_map(|[_, position]| vector(position, 0)).map(|p| p * self.scale()).collect()
    }

    /// The lines of the largest submap, likewise.
    pub fn lines(&self) -> Vec<MapLine> {
        let largest = self.largest_submap();
        let rows = self.rows("lines", ["submap_ids", "ends", "primitive_ids"]);
        let of_submap = rows.filter(|[submap, ..]| submap.as_u64() == largest);
        let line = |[_, ends, primitive]: [&Value; 3]| {
            let ends = [vector(ends, 0)? * self.scale(), vector(ends, 3)? * self.scale()];
            Some(MapLine { ends, primitive: primitive.as_u64() })
        };
        of_submap.filter_map(line).collect()
    }

    /// Where the keyframes of the largest submap are, by their number.
    pub fn keyframes(&self) -> BTreeMap<u64, Vector3<f64>> {
        let largest = self.largest_submap();
        let rows = self.rows("keyframes", ["ids", "submap_ids", "poses"]);
        let of_submap = rows.filter(|[_, submap, _]| submap.as_u64() == largest);
        of_submap.filter_map(|[id, _, pose]| Some((id.as_u64()?, vector(pose, 0)? * self.scale()))).collect()
    }

    /// Time in seconds and state of each frame.
    pub fn states(&self) -> Vec<(f64, String)> {
        let rows = self.rows("frames", ["times_s", "states"]);
        rows.filter_map(|[time, state]| Some((time.as_f64()?, state.as_str()?.to_owned()))).collect()
    }

    /// Each primitive: its number, direction, lines and keyframes.
    pub fn primitives(&self) -> Vec<(u64, [f64; 3], usize, usize)> {
        let mut n_lines: BTreeMap<u64, usize> = BTreeMap::new();
        for [primitive] in self.rows("lines", ["primitive_ids"]) {
            if let Some(id) = primitive.as_u64() {
                *n_lines.entry(id).or_default() += 1;
            }
        }
        let primitive = |[id, direction, keyframes]: [&Value; 3]| {
            let id = id.as_u64()?;
            let n_keyframes = keyframes.as_array()?.len();
            let n_lines = n_lines.get(&id).copied().unwrap_or(0);
            Some((id, vector(direction, 0)?.into(), n_lines, n_keyframes))
        };
        self.rows("primitives", ["ids", "directions", "keyframe_ids"]).filter_map(primitive).collect()
    }
}

fn rows<'a, const N: usize>(
    scene: &'a [Value],
    part: &'a str,
    columns: [&'a str; N],
) -> impl Iterator<Item = [&'a Value; N]> {
    scene.iter().filter_map(move |value| value.get(part)).flat_map(move |part| {
        let n_rows = part[columns[0]].as_array().map_or(0, Vec::len);
        (0..n_rows).map(move |row| columns.map(|column| &part[column][row]))
    })
}

/// Three numbers of a list, from one on.
fn vector(list: &Value, first: usize) -> Option<Vector3<f64>> {
    let number = |idx: usize| list[first + idx].as_f64();
    Some(Vector3::new(number(0)?, number(1)?, number(2)?))
}

/// Keyframes whose image was kept: so many, evenly over all of them.
fn chosen(scene: &[Value], n_images: usize) -> Vec<u64> {
    let rows = rows(scene, "keyframes", ["ids", "has_image"]);
    let kept: Vec<u64> = rows
        .filter(|[_, has_image]| **has_image == Value::Bool(true))
        .filter_map(|[id, _]| id.as_u64())
        .collect();
    let n = n_images.min(kept.len());
    // With the first and the last.
    let last = kept.len().saturating_sub(1);
    (0..n).map(|i| kept[if n == 1 { 0 } else { i * last / (n - 1) }]).collect()
}

/// Takes out points evenly where there are too many for a page.
fn thin_points(scene: &mut [Value]) {
    let n_points = rows(scene, "points", ["ids"]).count();
    let every = n_points.div_ceil(MAX_POINTS).max(1);
    if every == 1 {
        return;
    }
    for part in scene.iter_mut().filter_map(|value| value.get_mut("points")) {
        let columns = part.as_object_mut().into_iter().flat_map(Map::values_mut);
        for column in columns.filter_map(Value::as_array_mut) {
            let kept: Vec<Value> = column.iter().step_by(every).cloned().collect();
            *column = kept;
        }
    }
}

/// In the page there is an image only of the keyframes that were chosen.
fn mark_images(scene: &mut [Value], images: &Map<String, Value>) {
    let there: HashSet<u64> = images.keys().filter_map(|id| id.parse().ok()).collect();
    for part in scene.iter_mut().filter_map(|value| value.get_mut("keyframes")) {
        let ids = part["ids"].as_array().cloned().unwrap_or_default();
        part["has_image"] =
            ids.iter().map(|id| id.as_u64().is_some_and(|id| there.contains(&id))).collect::<Vec<_>>().into();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene() -> Vec<Value> {
        let ids: Vec<u64> = (1..=9).collect();
        let has_image: Vec<bool> = ids.iter().map(|id| *id != 5).collect();
        vec![
            json!({"scene": {"session_id": "room"}}),
            json!({"keyframes": {"ids": ids, "has_image": has_image}}),
            json!({"points": {"ids": [1, 2, 3], "positions": [[0, 1, 2], [3, 4, 5], [6, 7, 8]]}}),
        ]
    }

    #[test]
    fn keyframes_are_chosen_evenly_and_only_they_have_images() {
        let mut scene = scene();
        assert_eq!(chosen(&scene, 3), [1, 4, 9]);
        assert_eq!(chosen(&scene, 1), [1]);
        assert_eq!(chosen(&scene, 100).len(), 8);
        assert!(chosen(&[], 3).is_empty() && chosen(&scene, 0).is_empty());
        let images = Map::from_iter([("4".to_owned(), json!({}))]);
        mark_images(&mut scene, &images);
        let marked: Vec<bool> =
            rows(&scene, "keyframes", ["has_image"]).filter_map(|[value]| value.as_bool()).collect();
        assert_eq!(marked.iter().position(|is_there| *is_there), Some(3));
        assert_eq!(marked.iter().filter(|is_there| **is_there).count(), 1);
    }

    #[test]
    fn rows_are_read_across_columns() {
        let scene = scene();
        let read: Vec<_> = rows(&scene, "points", ["ids", "positions"])
            .filter_map(|[id, position]| Some((id.as_u64()?, vector(position, 0)?.y)))
            .collect();
        assert_eq!(read, [(1, 1.0), (2, 4.0), (3, 7.0)]);
    }
}
