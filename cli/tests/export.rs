//! The command `monoslam export`, and whether other programs read what it writes.

mod stage;

use std::fs;
use std::path::Path;

use stage::{Stage, summary, text};
use tokio::process::Command;

/// Rendered frames of a room: enough for a map with lines.
const N_FRAMES: usize = 60;

async fn mapped() -> Stage {
    let stage = Stage::set(N_FRAMES).await;
    let room = stage.path("room");
    let streamed =
        stage.stream(text(&room), "room", &["--deterministic", "--seed", "1"]).output().await.unwrap();
    assert!(summary(&streamed)["keyframes"].as_u64() > Some(3));
    stage
}

async fn export(stage: &Stage, format: &str, path: &Path) {
    let words = ["export", "room", "--format", format, "-o", text(path)];
    let output = stage.monoslam(&words).output().await.unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{format}: {said}");
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), text(path));
}

/// Every format, in files and folders named after it.
async fn export_all(stage: &Stage) {
    for name in ["map.ply", "map.json", "map.mcap", "colmap", "nerfstudio"] {
        let format = name.strip_prefix("map.").unwrap_or(name);
        export(stage, format, &stage.path(name)).await;
    }
}

fn n_files(folder: &Path) -> usize {
    fs::read_dir(folder).unwrap().count()
}

#[tokio::test(flavor = "multi_thread")]
async fn every_format_is_written_with_its_images() {
    let stage = mapped().await;
    export_all(&stage).await;
    let read = |name: &str| fs::read(stage.path(name)).unwrap();
    assert!(read("map.ply").starts_with(b"ply\n") && read("map.mcap").ends_with(b"\x89MCAP0\r\n"));
    let json: serde_json::Value = serde_json::from_slice(&read("map.json")).unwrap();
    let n_keyframes = json["keyframes"].as_array().unwrap().len();
    let transforms: serde_json::Value = serde_json::from_slice(&read("nerfstudio/transforms.json")).unwrap();
    assert_eq!(transforms["frames"].as_array().unwrap().len(), n_keyframes);
    for folder in ["colmap/images", "nerfstudio/images"] {
        assert_eq!(n_files(&stage.path(folder)), n_keyframes, "{folder}");
        assert!(read(&format!("{folder}/keyframe_000001.png")).starts_with(b"\x89PNG"));
    }
    assert_eq!(n_files(&stage.path("colmap/sparse/0")), 3);
    assert_eq!(n_files(&stage.path("nerfstudio")), 3);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_exported_is_said_and_leaves_nothing() {
    let stage = Stage::set(1).await;
    let path = stage.path("none.ply");
    let words = ["export", "none", "--format", "ply", "-o", text(&path)];
    let said = stage::refusal(&stage.monoslam(&words).output().await.unwrap());
    assert!(said.contains("none"), "{said}");
    assert!(!path.exists() && !stage.path("none.ply.part").exists());
    stage.end().await;
}

/// Real readers: `mcap` (the schemas and topics that Foxglove expects, and what is in the messages),
/// `pycolmap`, and a reader of PLY, on what was written.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs Python packages: set READERS_PYTHON"]
async fn other_programs_read_the_exports() {
    let stage = mapped().await;
    export_all(&stage).await;
    let python = std::env::var("READERS_PYTHON").expect("READERS_PYTHON names a Python with the packages");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_exports.py");
    let output = Command::new(python).arg(script).arg(stage.path("")).output().await.unwrap();
    let said =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("mcap: ok") && said.contains("colmap: ok") && said.contains("ply: ok"), "{said}");
    assert!(said.contains("transforms: ok"), "{said}");
    stage.end().await;
}
