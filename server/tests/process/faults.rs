//! Faults of the machine: kills under load, a disk that is full, a folder that cannot be written. Nothing
//! that was acknowledged is lost. Damaged pages, a deleted file and clocks that are set are in
//! `tests/end_to_end`.

use crate::program::{ServerProcess, check, limit_files};
use proto::v1;
use proto::v1::stream_frames_request::Message as Request;
use proto::v1::stream_frames_response::Message as Response;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tests::{Client, FrameStream, SmallWorld, camera, create_session, open_message, raw_gray};
use tonic::Status;

/// Kills, and streams at each.
const N_KILLS: u64 = 50;
const N_STREAMS: usize = 4;
/// Frames that the streams take from the world over and over.
const N_IMAGES: usize = 60;

/// What one session was promised: every frame before this number is saved.
type Promised = Arc<AtomicU64>;

/// Streams into a session from where it is until the server is gone, noting what is promised.
async fn stream(mut client: Client, id: String, images: Arc<Vec<v1::Image>>, promised: Promised) {
    let Ok(mut stream) = FrameStream::open(&mut client, open_message(&id)).await else { return };
    let (sender, first) = (stream.sender(), stream.opened.next_sequence);
    let sending = tokio::spawn(async move {
        for sequence in first.. {
            let image = images[sequence as usize % images.len()].clone();
            let message = Some(Request::Frame(tests::frame(sequence, image)));
            if sender.send(v1::StreamFramesRequest { message }).await.is_err() {
                break;
            }
        }
    });
    while let Ok(Some(Response::Result(result))) = stream.next().await {
        if let Some(durable) = result.durable_sequence {
            promised.fetch_max(durable + 1, Ordering::SeqCst);
        }
    }
    sending.abort();
}

/// Fails if a session has less than it was promised.
async fn assert_promises(client: &mut Client, promised: &[(String, Promised)], kill: u64) {
    for (id, promised) in promised {
        let request = v1::GetSessionRequest { session_id: id.clone() };
        let session = client.get_session(request).await.unwrap().into_inner();
        let saved = session.durable_sequence.map_or(0, |durable| durable + 1);
        let promised = promised.load(Ordering::SeqCst);
        assert!(saved >= promised, "kill {kill}: {id} has {saved} frames, {promised} were promised");
        assert!(session.damage.is_none(), "kill {kill}: {session:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes: fifty kills"]
async fn fifty_kills_under_four_streams_lose_nothing_that_was_promised() {
    let folder = tempfile::tempdir().unwrap();
    let world = SmallWorld::new(1);
    let images: Vec<_> = (0..N_IMAGES).map(|i| world.frame(i).image.unwrap()).collect();
    let images = Arc::new(images);
    let promised: Vec<(String, Promised)> =
        (0..N_STREAMS).map(|i| (format!("room-{i}"), Promised::default())).collect();
    for kill in 0..N_KILLS {
        // The server recovers its own log: nobody else touches the files in between.
        let server = ServerProcess::start(folder.path());
        let mut client = server.client().await;
        if kill == 0 {
            for (id, _) in &promised {
                create_session(&mut client, id, world.camera()).await.unwrap();
            }
        }
        assert_promises(&mut client, &promised, kill).await;
        let mut streams = Vec::new();
        for (id, promised) in &promised {
            let client = server.client().await;
            streams.push(tokio::spawn(stream(client, id.clone(), images.clone(), promised.clone())));
        }
        // At no particular moment: 0.3 to 3 s, in steps that repeat after 271 kills.
        tokio::time::sleep(Duration::from_millis(300 + kill * 997 % 2710)).await;
        server.kill();
        for stream in streams {
            stream.await.unwrap();
        }
    }
    let server = ServerProcess::start(folder.path());
    assert_promises(&mut server.client().await, &promised, N_KILLS).await;
    assert!(server.terminate());
    check(folder.path());
    let promised: Vec<u64> = promised.iter().map(|(_, promised)| promised.load(Ordering::SeqCst)).collect();
    assert!(promised.iter().all(|n| *n >= N_KILLS / 2), "hardly anything was promised: {promised:?}");
    eprintln!("{N_KILLS} kills: {promised:?} frames promised, all there");
}

/// Streams gray frames until the server refuses; how many are promised, and how it ended.
async fn stream_gray(client: &mut Client, image: &v1::Image) -> (u64, Status) {
    let mut promised = 0;
    loop {
        let mut stream = match FrameStream::open(client, open_message("s")).await {
            Ok(stream) => stream,
            Err(status) => return (promised, status),
        };
        let first = stream.opened.next_sequence;
        for sequence in first..first + 200 {
            stream.send(Request::Frame(tests::frame(sequence, image.clone()))).await;
            match stream.next().await {
                Ok(Some(Response::Result(result))) => {
                    promised = promised.max(result.durable_sequence.map_or(0, |durable| durable + 1));
                }
                Ok(other) => panic!("unexpected answer {other:?}"),
                Err(status) => return (promised, status),
            }
        }
        match stream.finish().await {
            Ok(_) => promised = promised.max(first + 200),
            Err(status) => return (promised, status),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes: a disk is filled"]
async fn a_disk_that_is_full_is_told_and_loses_nothing_that_was_promised() {
    let folder = tempfile::tempdir().unwrap();
    // Files of more bytes than an empty database and some frames have cannot be written, whatever SQLite
    // thinks.
    let server = ServerProcess::start_with(folder.path(), |command| limit_files(command, 2 << 20));
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(160, 120)).await.unwrap();
    let image = raw_gray(160, 120, &[100; 160 * 120]);
    let (promised, status) = stream_gray(&mut client, &image).await;
    assert!(["room", "database"].iter().any(|word| status.message().contains(word)), "{status}");
    let ready = tests::get(server.http_addr, "/readyz").await;
    assert!(ready.is_err(), "it says that it is ready: {ready:?}");
    server.kill();

    // With room again, all that was promised is there, and more can be added.
    let server = ServerProcess::start(folder.path());
    let mut client = server.client().await;
    let request = v1::GetSessionRequest { session_id: "s".into() };
    let session = client.get_session(request).await.unwrap().into_inner();
    assert!(session.n_frames >= promised, "{} frames of {promised} that were promised", session.n_frames);
    let mut stream = FrameStream::open(&mut client, open_message("s")).await.unwrap();
    let next = stream.opened.next_sequence;
    stream.send(Request::Frame(tests::frame(next, image))).await;
    assert!(matches!(stream.next().await, Ok(Some(Response::Result(_)))));
    stream.finish().await.unwrap();
    assert!(server.terminate());
    check(folder.path());
}

#[test]
fn a_folder_that_cannot_be_written_keeps_the_server_from_starting_and_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    // Not even who may write everywhere can make a folder in a file.
    std::fs::write(&data, "in the way").unwrap();
    let arguments = ["--grpc-addr", "127.0.0.1:0", "--http-addr", "127.0.0.1:0", "--data-dir"];
    let mut arguments: Vec<std::ffi::OsString> = arguments.map(Into::into).into();
    arguments.push(data.clone().into());
    let output = crate::program::run(&arguments);
    let said = crate::program::said(&output);
    assert!(!output.status.success());
    assert!(said.contains("cannot make the folder") && said.contains(&*data.to_string_lossy()), "{said}");
}

/// The user that owns nothing, as which the server runs where the tests may do everything.
const NOBODY: u32 = 65_534;

/// Runs a command without the right to write everywhere.
fn without_rights(command: &mut std::process::Command) {
    use std::os::unix::process::CommandExt;
    if is_root() {
        command.uid(NOBODY).gid(NOBODY);
    }
}

fn is_root() -> bool {
    // SAFETY: asks for a number.
    unsafe { libc::geteuid() == 0 }
}

fn set_mode(path: &std::path::Path, mode: u32) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
}

/// Has a folder and its files be read only, or not any more.
fn set_writable(folder: &std::path::Path, is_writable: bool) {
    let (of_folder, of_files) = if is_writable { (0o755, 0o644) } else { (0o555, 0o444) };
    for entry in std::fs::read_dir(folder).unwrap() {
        set_mode(&entry.unwrap().path(), of_files);
    }
    set_mode(folder, of_folder);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_that_becomes_read_only_loses_nothing_and_is_told_at_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    set_mode(folder.path(), 0o755);
    let data = folder.path().join("data");
    std::fs::create_dir(&data).unwrap();
    if is_root() {
        std::os::unix::fs::chown(&data, Some(NOBODY), Some(NOBODY)).unwrap();
    }
    let server = ServerProcess::start_with(&data, without_rights);
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(160, 120)).await.unwrap();
    set_writable(&data, false);
    // The files are open: what comes is saved, or refused in so many words, and never promised in vain.
    let image = raw_gray(160, 120, &[100; 160 * 120]);
    let mut stream = FrameStream::open(&mut client, open_message("s")).await.unwrap();
    let mut promised = 0;
    for sequence in 0..20 {
        stream.send(Request::Frame(tests::frame(sequence, image.clone()))).await;
        match stream.next().await {
            Ok(Some(Response::Result(result))) => {
                promised = promised.max(result.durable_sequence.map_or(0, |durable| durable + 1));
            }
            other => panic!("{other:?}"),
        }
    }
    if stream.finish().await.is_ok() {
        promised = 20;
    }
    server.kill();

    let mut command = std::process::Command::new("timeout");
    command.args(["20", crate::program::SERVER, "--grpc-addr", "127.0.0.1:0", "--http-addr", "127.0.0.1:0"]);
    without_rights(command.arg("--data-dir").arg(&data));
    let output = command.output().unwrap();
    let said = crate::program::said(&output);
    assert!(!output.status.success() && said.contains(&*data.to_string_lossy()), "{said}");

    set_writable(&data, true);
    let server = ServerProcess::start_with(&data, without_rights);
    let mut client = server.client().await;
    let request = v1::GetSessionRequest { session_id: "s".into() };
    let session = client.get_session(request).await.unwrap().into_inner();
    assert!(session.n_frames >= promised, "{} frames of {promised} that were promised", session.n_frames);
    assert!(server.terminate());
}
