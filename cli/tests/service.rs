//! The commands that ask the service of stored maps: optimize, merge, operations, scale, localize, and
//! streams that only localize.

mod stage;

use stage::{Stage, refusal, summary, text};

/// Rendered frames of a room: enough for a map.
const N_FRAMES: usize = 50;

#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_located_in_measured_and_adjusted_by_commands() {
    let stage = Stage::set(N_FRAMES).await;
    let room = stage.path("room");
    let map = summary(&stage.stream(text(&room), "room", &[]).output().await.unwrap());
    assert!(map["tracked"].as_u64() > Some(20), "{map}");
    let run = async |words: &[&str]| stage.monoslam(words).output().await.unwrap();
    let keyframes = async || {
        let shown = run(&["sessions", "show", "room", "--json"]).await;
        summary(&shown)["keyframes"].as_u64().unwrap()
    };
    let before = keyframes().await;

    // Frames that are only located leave the map as it is; a session that is not there is not made.
    let again = ["--localize-only", "--again", "--end", "20"];
    let located = summary(&stage.stream(text(&room), "room", &again).output().await.unwrap());
    assert!(located["tracked"].as_u64() > Some(10), "{located}");
    assert_eq!(keyframes().await, before, "the map has grown");
    let refused = stage.stream(text(&room), "new", &["--localize-only"]).output().await.unwrap();
    assert!(refusal(&refused).contains("leave out --localize-only"), "{}", refusal(&refused));

    let optimized = summary(&run(&["optimize", "room", "--json"]).await);
    assert_eq!((optimized["state"].as_str(), optimized["progress"].as_f64()), (Some("done"), Some(1.0)));
    let result = &optimized["optimized"];
    assert!(result["cost_after"].as_f64() <= result["cost_before"].as_f64(), "{optimized}");
    let listed = summary(&run(&["operations", "list", "--json"]).await);
    assert_eq!(listed["operations"][0]["id"], optimized["id"]);
    let merged = refusal(&run(&["merge", "room", "room"]).await);
    assert!(merged.contains("another session"), "{merged}");

    let scaled =
        run(&["scale", "room", "--distance", "2", "--from", "keyframe:1", "--to", "keyframe:3", "--json"]);
    let scaled = summary(&scaled.await);
    assert!(scaled["metres_per_unit"].as_f64().unwrap() > 0.0, "{scaled}");
    let truth = stage.path("room/groundtruth.txt");
    let measured =
        summary(&run(&["scale", "room", "--positions", text(&truth), "--by-time", "--json"]).await);
    assert!(measured["scale_measurement"]["rms_m"].as_f64().unwrap() < 0.1, "{measured}");

    let image = stage.path("room/images/000030.png");
    let found = summary(&run(&["localize", text(&image), "--camera", "unknown", "--json"]).await);
    assert_eq!(
        (found["session_id"].as_str(), found["metric"].as_bool()),
        (Some("room"), Some(true)),
        "{found}"
    );
    let trajectory = run(&["trajectory", "room", "--submap", "largest"]).await;
    assert!(trajectory.status.success() && trajectory.stdout.len() > 1000);
    stage.end().await;
}
