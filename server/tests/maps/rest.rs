//! What the HTTP interface says of maps made by hand, to the last number.

use crate::api::Api;
use serde_json::{Value, json};
use slam::map::PrimitiveId;
use testkit::world::{ln, pr};

#[tokio::test]
async fn lines_are_told_with_their_ends_and_pluecker_coordinates() {
    let api = Api::new().await;
    let session = api.json("").await;
    assert_eq!((&session["n_lines"], &session["n_primitives"]), (&json!(25), &json!(4)));
    let line = &api.world.lines[3];
    let expected = json!({
        "id": 4, "submap_id": 0, "start": line.endpoints[0].as_slice(), "end": line.endpoints[1].as_slice(),
        "direction": line.line.direction().as_slice(), "moment": line.line.moment().as_slice(),
        "n_observations": line.observations.len(), "primitive_id": line.primitive.map(PrimitiveId::get),
    });
    let page = api.json("/lines?page_size=1&page_token=3").await;
    assert_eq!(page, json!({ "scale": "up_to_scale", "lines": [expected], "next_page_token": "4" }));

    let middle = line.midpoint();
    let near = format!("/lines?near={},{},{}&radius=1e-6", middle.x, middle.y, middle.z);
    assert_eq!(api.json(&near).await["lines"], json!([expected]), "a line is where its middle is");
    let of_primitive = api.json("/lines?primitive_id=2").await;
    let ids: Vec<u64> =
        of_primitive["lines"].as_array().unwrap().iter().map(|line| line["id"].as_u64().unwrap()).collect();
    assert_eq!(ids, api.lines_of(pr(2)));
}

#[tokio::test]
async fn primitives_are_told_with_what_they_rest_on() {
    let api = Api::new().await;
    let page = api.json("/primitives").await;
    assert_eq!(page["primitives"].as_array().unwrap().len(), 4);
    let primitive = &api.world.primitives[1];
    let detail = api.json("/primitives/2").await;
    assert_eq!(detail["direction"], json!(primitive.direction.as_vector().as_slice()));
    assert_eq!(detail["covariance"][0][2], json!(primitive.covariance[(0, 2)]));
    let keyframes: Vec<u64> = primitive.observations.iter().map(|seen| seen.keyframe.get()).collect();
    assert_eq!((&detail["keyframes"], &detail["n_keyframes"]), (&json!(keyframes), &json!(keyframes.len())));
    assert_eq!(detail["lines"], json!(api.lines_of(pr(2))));
    assert_eq!(page["primitives"][1]["n_lines"], detail["n_lines"]);
    let variance = primitive.covariance.symmetric_eigenvalues().max().max(0.0);
    assert_eq!(detail["std_deg"], json!(variance.sqrt().to_degrees()));
}

#[tokio::test]
async fn the_graph_of_primitives_tells_ties_with_and_without_overlap() {
    let api = Api::new().await;
    let covisible = api.json("/graph?kind=covisibility").await;
    let pair = |edge: &Value| (edge["from"].as_u64().unwrap(), edge["to"].as_u64().unwrap());
    let overlapping: Vec<_> = covisible["edges"].as_array().unwrap().iter().map(pair).collect();
    let graph = api.json("/graph?kind=primitives").await;
    assert_eq!(graph["nodes"].as_array().unwrap().len(), 6);
    let mut expected = Vec::new();
    for primitive in &api.world.primitives {
        for (i, a) in primitive.observations.iter().enumerate() {
            for b in &primitive.observations[i + 1..] {
                expected.push((primitive.id.get(), a.keyframe.get(), b.keyframe.get()));
            }
        }
    }
    let edges = graph["edges"].as_array().unwrap();
    let found: Vec<_> = edges
        .iter()
        .map(|edge| (edge["primitive_id"].as_u64().unwrap(), pair(edge).0, pair(edge).1))
        .collect();
    assert_eq!(found, expected);
    for edge in edges {
        assert_eq!(edge["overlap"], json!(overlapping.contains(&pair(edge))), "{edge}");
        assert_eq!(edge["overlap"] == true, edge["weight"].as_u64() > Some(0));
    }
    assert!(
        edges.iter().any(|edge| edge["overlap"] == true) && edges.iter().any(|edge| edge["overlap"] == false)
    );

    let of_one = api.json("/graph?kind=primitives&keyframe_id=2").await;
    let n = edges.iter().filter(|edge| pair(edge).0 == 2 || pair(edge).1 == 2).count();
    assert_eq!(of_one["edges"].as_array().unwrap().len(), n);
    let essential = api.json("/graph?kind=essential").await;
    let spanning: Vec<_> = essential["edges"].as_array().unwrap().iter().map(pair).collect();
    assert_eq!(
        spanning,
        [(1, 2), (2, 3), (3, 4), (4, 5), (5, 6)],
        "a chain of keyframes that share too little"
    );
}

#[tokio::test]
async fn the_polygon_file_has_lines_as_edges() {
    let api = Api::new().await;
    let ply = api.text("/map?format=ply").await;
    let (head, body) = ply.split_once("end_header\n").unwrap();
    assert!(head.contains("element vertex 110\n") && head.contains("element edge 25\n"), "{head}");
    let rows: Vec<&str> = body.lines().collect();
    assert_eq!(rows.len(), 110 + 25);
    let point = api.world.points[0].position;
    assert_eq!(rows[0], format!("{} {} {} 200 200 200", point.x, point.y, point.z));
    for (idx, line) in api.world.lines.iter().enumerate() {
        let ends: Vec<usize> = rows[110 + idx].split(' ').map(|vertex| vertex.parse().unwrap()).collect();
        for (end, vertex) in line.endpoints.iter().zip(ends) {
            assert!(rows[vertex].starts_with(&format!("{} {} {} ", end.x, end.y, end.z)), "{}", rows[vertex]);
        }
    }
    let other = api.text("/map?format=ply&submap_id=3").await;
    assert!(other.contains("element vertex 0\n") && other.ends_with("end_header\n"));
    let whole = api.json("/map?format=json").await;
    assert_eq!(whole["lines"][3], api.json("/lines?page_size=1&page_token=3").await["lines"][0]);
    assert_eq!(whole["primitives"], api.json("/primitives").await["primitives"]);
    assert_eq!(whole["lines"].as_array().unwrap().last().unwrap()["id"], json!(ln(25).get()));
}
