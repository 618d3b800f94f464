//! A backup is made while a stream runs, and put back; then the session goes on.

use crate::crash::stream;
use crate::program::{ServerProcess, check, run, said};
use proto::v1;
use std::path::Path;
use tests::{FrameStream, SmallWorld, create_session, open_message};

/// Frames before the backup, while it is made, and after it was put back.
const N_FRAMES: [usize; 3] = [40, 20, 20];

/// Runs a command of the program on a data folder; whether it succeeded, and what it said.
fn command(arguments: &[&str], file: &Path, data_dir: &Path) -> (bool, String) {
    let mut all: Vec<std::ffi::OsString> = arguments.iter().map(Into::into).collect();
    all.extend([file.into(), "--data-dir".into(), data_dir.into()]);
    let output = run(&all);
    (output.status.success(), said(&output))
}

fn names_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
    entries.map(|name| name.into_string().unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_beside_a_stream_is_put_back_and_the_session_goes_on() {
    let [data, backups] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let file = backups.path().join("maps.sqlite");
    let world = SmallWorld::new(1);
    let server = ServerProcess::start(data.path());
    let mut client = server.client().await;
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    let answers = stream(&mut frames, &world, 0, N_FRAMES[0]).await;
    let saved_before = answers.last().and_then(|answer| answer.durable_sequence).expect("some are saved");

    // Beside the stream, and then in the way of itself.
    let (folder, into) = (data.path().to_owned(), file.clone());
    let backing_up = tokio::task::spawn_blocking(move || command(&["backup"], &into, &folder));
    stream(&mut frames, &world, N_FRAMES[0], N_FRAMES[1]).await;
    let (is_done, text) = backing_up.await.unwrap();
    assert!(is_done && text.contains("verified"), "{text}");
    let (is_done, text) = command(&["backup"], &file, data.path());
    assert!(!is_done && text.contains("--force"), "{text}");
    let (is_done, text) = command(&["verify"], &file, data.path());
    assert!(is_done && text.contains("is whole; sessions: 1"), "{text}");
    assert_eq!(names_in(backups.path()), ["maps.sqlite"], "nothing is left beside it");

    // What uses the data is not disturbed.
    let (is_done, text) = command(&["restore", "--force"], &file, data.path());
    assert!(!is_done && text.contains("another server uses"), "{text}");
    frames.finish().await.unwrap();
    drop(client);
    assert!(server.terminate());
    let (is_done, text) = command(&["restore"], &file, data.path());
    assert!(!is_done && text.contains("--force"), "{text}");
    let (is_done, text) = command(&["restore", "--force"], &file, data.path());
    assert!(is_done && text.contains("before-restore-1"), "{text}");
    let (is_done, text) =
        command(&["verify"], &data.path().join("monoslam.sqlite.before-restore-1"), data.path());
    assert!(is_done, "what was there is kept: {text}");

    let server = ServerProcess::start(data.path());
    let mut client = server.client().await;
    let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    let next = frames.opened.next_sequence as usize;
    assert!(next as u64 > saved_before && next <= N_FRAMES[0] + N_FRAMES[1], "it goes on from {next}");
    let answers = stream(&mut frames, &world, next, N_FRAMES[2]).await;
    frames.finish().await.unwrap();
    let found = answers.iter().any(|answer| answer.state() == v1::TrackingState::Tracked);
    assert!(found, "the session finds its place again");
    assert!(server.terminate());
    check(data.path());
}

#[test]
fn what_is_no_backup_is_not_put_in_place() {
    let [data, backups] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let file = backups.path().join("letter.txt");
    std::fs::write(&file, "Dear Sir or Madam, ".repeat(1000)).unwrap();
    for arguments in [&["restore"][..], &["verify"]] {
        let (is_done, text) = command(arguments, &file, data.path());
        assert!(!is_done && text.contains("not a map database"), "{arguments:?}: {text}");
    }
    assert!(!names_in(data.path()).iter().any(|name| name.contains("sqlite") || name.contains("partial")));
    let (is_done, text) = command(&["backup"], &backups.path().join("copy"), data.path());
    assert!(!is_done && text.contains("there is no database"), "{text}");
}
