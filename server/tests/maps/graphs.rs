//! The essential graph that is served is the one the engine closes loops on.

use crate::api::Api;
use serde_json::Value;
use slam::map::{KeyframeId, MapParts, Observation};
use slam::{KeyframeTies, LoopConfig, essential_edges};
use std::collections::BTreeSet;
use testkit::world::{Size, kf, map, parts, pt};

const LONG: Size = Size { n_keyframes: 30, n_keypoints: 500, n_points: 2400 };
/// Points that keyframes 2 and 26 share since a loop was closed there, and 3 and 27: enough for a tie, and
/// too few.
const N_SHARED_ACROSS: [usize; 2] = [40, 20];

/// A chain of keyframes whose end sees the beginning again.
fn loop_world() -> MapParts {
    let mut world = parts(31, LONG);
    for (offset, n_shared) in N_SHARED_ACROSS.into_iter().enumerate() {
        let (first, second) = (1 + offset, 25 + offset);
        for _ in 0..n_shared {
            world.last_ids.point += 1;
            let mut point = world.points[0].clone();
            point.id = pt(world.last_ids.point);
            point.observations = [first, second].map(|idx| see(&mut world, idx, point.id)).into();
            point.created_by = point.observations[0].keyframe;
            world.points.push(point);
        }
    }
    world
}

fn see(world: &mut MapParts, keyframe_idx: usize, point: slam::map::PointId) -> Observation {
    let keyframe = &mut world.keyframes[keyframe_idx];
    let free = keyframe.points.iter().position(Option::is_none).expect("a keypoint is free");
    keyframe.points[free] = Some(point);
    Observation { keyframe: keyframe.id, feature_idx: free as u32 }
}

#[tokio::test]
async fn the_essential_graph_is_the_engines() {
    let world = loop_world();
    // What the engine makes of the stored map when a frame asks for it.
    let map = map(&world);
    let ties: Vec<KeyframeTies> = map.keyframes().map(KeyframeTies::of).collect();
    let engines = essential_edges(&ties, &LoopConfig::default());
    let api = Api::with(world, &[]).await;
    let graph = api.json("/graph?kind=essential").await;
    let edges = graph["edges"].as_array().unwrap();
    let ends = |edge: &Value| ["from", "to"].map(|end| kf(edge[end].as_u64().unwrap()));
    let served: BTreeSet<(KeyframeId, KeyframeId)> =
        edges.iter().map(ends).map(|[from, to]| (from.min(to), from.max(to))).collect();
    assert_eq!(served, engines);

    let tie = |from: u64, to: u64| edges.iter().find(|edge| edge["from"] == from && edge["to"] == to);
    assert_eq!(tie(2, 26).expect("a loop was closed")["weight"], N_SHARED_ACROSS[0]);
    assert!(tie(3, 27).is_none(), "too few points for a tie across time");
    let n_spanning = edges.iter().filter(|edge| edge["spanning"] == true).count();
    assert_eq!(n_spanning, 29, "a tree over 30 keyframes");
    let strong =
        edges.iter().filter(|edge| edge["spanning"] == false && edge["weight"].as_u64() >= Some(100));
    assert!(strong.count() > 0, "neighbours but one share a hundred points");
}
