//! Images in an object store that is away for a while: frames go on, and what is acknowledged is there.

use crate::crash::stream;
use crate::program::{ServerProcess, run, said};
use std::path::Path;
use tests::{FrameStream, SmallWorld, create_session, open_message};

/// Runs a command of the program on a data folder; what it said.
fn command(arguments: &[&str], data_dir: &Path) -> String {
    let mut all: Vec<std::ffi::OsString> = arguments.iter().map(Into::into).collect();
    all.extend(["--data-dir".into(), data_dir.into()]);
    let output = run(&all);
    assert!(output.status.success(), "{}", said(&output));
    said(&output)
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_go_on_while_the_object_store_is_away() {
    let (data, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let objects = data.path().join("objects");
    let url = format!("file://{}", objects.display());
    let server = ServerProcess::start_with(data.path(), |command| {
        command.env("MONOSLAM_STORAGE__OBJECTS", &url).env("MONOSLAM_SESSIONS__SAVE_RETRY_S", "0.2");
    });
    let world = SmallWorld::new(1);
    let mut client = server.client().await;
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    stream(&mut frames, &world, 0, 30).await;

    let aside = data.path().join("aside");
    std::fs::rename(&objects, &aside).unwrap();
    std::fs::write(&objects, b"in the way").unwrap();
    let answers = stream(&mut frames, &world, 38, 30).await;
    let stood_still_at = answers.last().unwrap().durable_sequence;
    assert!(stood_still_at < Some(60), "it says that images are saved which cannot be: {stood_still_at:?}");
    assert!(answers.iter().any(|answer| answer.is_key_frame), "there was no image to be saved");
    std::fs::remove_file(&objects).unwrap();
    std::fs::rename(&aside, &objects).unwrap();

    frames.finish().await.unwrap();
    let session = tests::get(server.http_addr, "/v1/sessions/room").await.unwrap();
    let session: serde_json::Value = serde_json::from_str(&session).unwrap();
    assert_eq!(session["durable_sequence"], 75, "everything is saved once it is back");
    let page = tests::get(server.http_addr, "/v1/sessions/room/keyframes").await.unwrap();
    let page: serde_json::Value = serde_json::from_str(&page).unwrap();
    let keyframes = page["keyframes"].as_array().unwrap();
    assert!(keyframes.len() > 2, "{page}");
    for keyframe in keyframes {
        let path = format!("http://{}/v1/sessions/room/keyframes/{}/image", server.http_addr, keyframe["id"]);
        let image = reqwest::get(path).await.unwrap();
        assert_eq!(image.status(), 200, "{keyframe}");
        assert!(image.bytes().await.unwrap().len() > 1000);
    }
    assert!(server.terminate());

    // The database's own copy knows that they are elsewhere, and a migration brings them to where it is told.
    let file = elsewhere.path().join("copy.sqlite");
    let text = command(&["backup", file.to_str().unwrap()], data.path());
    assert!(text.contains("in the object store"), "{text}");
    assert!(command(&["check"], data.path()).contains("not looked for"), "no object store is named");
    let (from, to) = (format!("sqlite:{}", data.path().display()), elsewhere.path().join("data"));
    let to = format!("sqlite:{}", to.display());
    let text = command(&["migrate", "--from", &from, "--to", &to, "--objects", &url], data.path());
    assert!(text.contains("copied, and the same row by row"), "{text}");
    std::fs::remove_dir_all(&objects).unwrap();
    let config = elsewhere.path().join("monoslam.toml");
    std::fs::write(&config, format!("[storage]\nobjects = {url:?}\n")).unwrap();
    let output =
        run(&["check", "--config", config.to_str().unwrap(), "--data-dir", data.path().to_str().unwrap()]);
    assert!(!output.status.success() && said(&output).contains("is missing in the object store"));
}
