//! Several servers on one database of PostgreSQL: a session is one server's, and another's when that is gone.
//! What stood still writes nothing.

use crate::crash::{Answers, stream};
use crate::program::ServerProcess;
use proto::v1;
use std::path::Path;
use std::time::{Duration, Instant};
use store::{Digest, Store, StoreOptions};
use tempfile::TempDir;
use testkit::postgres::shared_database;
use tests::{Client, FrameStream, SmallWorld, create_session, open_message};
use tonic::{Code, Status};
use tonic_types::StatusExt;

/// How long a session stays a server's that is not heard of, in these tests.
pub const LEASE: Duration = Duration::from_secs(2);
/// Longer than it may take until another has the session.
const PATIENCE: Duration = Duration::from_secs(30);

/// Starts a server of a fleet, in a folder of its own.
pub fn server_of_fleet(url: &str, folder: &Path) -> ServerProcess {
    server_with(url, folder, &[])
}

/// As [`server_of_fleet`], with another environment.
pub fn server_with(url: &str, folder: &Path, variables: &[(&str, &str)]) -> ServerProcess {
    ServerProcess::start_with(folder, |command| {
        command.env("MONOSLAM_STORAGE__URL", url).env("MONOSLAM_FLEET__LEASE_S", LEASE.as_secs().to_string());
        command.envs(variables.iter().copied());
    })
}

/// Two servers on one new database, and a session `room` that the first made.
pub struct Pair {
    pub url: String,
    pub one: ServerProcess,
    pub other: ServerProcess,
    pub client: Client,
    pub client_of_other: Client,
    pub world: SmallWorld,
    _folders: [TempDir; 2],
}

impl Pair {
    pub async fn start() -> Self {
        Self::start_with(&[]).await
    }

    /// As [`Self::start`], with another environment.
    pub async fn start_with(variables: &[(&str, &str)]) -> Self {
        let (url, folders) = (shared_database(), [(); 2].map(|()| tempfile::tempdir().unwrap()));
        let [one, other] = [0, 1].map(|idx| server_with(&url, folders[idx].path(), variables));
        let (mut client, client_of_other) = (one.client().await, other.client().await);
        let world = SmallWorld::new(1);
        create_session(&mut client, "room", world.camera()).await.unwrap();
        Self { url, one, other, client, client_of_other, world, _folders: folders }
    }

    /// A stream into `room` by the first server, with so many frames answered.
    pub async fn stream(&mut self, n_frames: usize) -> (FrameStream, Answers) {
        let mut frames = FrameStream::open(&mut self.client, open_message("room")).await.unwrap();
        let answers = stream(&mut frames, &self.world, 0, n_frames).await;
        (frames, answers)
    }
}

/// What an error of the server is called, and where it says the session's server is.
pub fn reason(status: &Status) -> (String, Option<String>) {
    let details = status.get_error_details();
    let info = details.error_info().unwrap_or_else(|| panic!("not the server's: {status:?}"));
    (info.reason.clone(), info.metadata.get("grpc_url").cloned())
}

/// Opens a stream as soon as the server may; what it was refused with before, and how long that took.
async fn open_in_time(client: &mut Client, id: &str) -> (FrameStream, Vec<String>, Duration) {
    let (begun, mut refused) = (Instant::now(), Vec::new());
    loop {
        match FrameStream::open(client, open_message(id)).await {
            Ok(stream) => return (stream, refused, begun.elapsed()),
            Err(status) => {
                assert!(begun.elapsed() < PATIENCE, "{status:?}");
                assert_eq!(status.code(), Code::Unavailable, "{status:?}");
                refused.push(reason(&status).0);
            }
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

async fn digest(url: &str, id: &str) -> Digest {
    let store = Store::connect_beside(url, StoreOptions::default()).await.unwrap();
    let digest = store.digest(id).await.unwrap();
    assert_eq!(store.check().await.unwrap(), []);
    store.close().await.unwrap();
    digest
}

mod postgres {
    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn without_passing_on_a_client_is_told_where_a_session_is() {
        let mut pair = Pair::start_with(&[("MONOSLAM_FLEET__PASS_ON", "false")]).await;
        let (frames, _) = pair.stream(10).await;
        let Pair { one, other, client_of_other, .. } = &mut pair;

        let status = FrameStream::open(client_of_other, open_message("room")).await.err().unwrap();
        let place = format!("http://{}", one.grpc_addr);
        assert_eq!(status.code(), Code::Unavailable);
        assert_eq!(reason(&status), ("OWNED_ELSEWHERE".to_owned(), Some(place.clone())));
        assert!(status.message().contains(&place), "{status}");
        let request = v1::DeleteSessionRequest { session_id: "room".into() };
        let status = client_of_other.delete_session(request.clone()).await.unwrap_err();
        assert_eq!(reason(&status).0, "OWNED_ELSEWHERE");
        let gone =
            reqwest::Client::new().delete(format!("http://{}/v1/sessions/room", other.http_addr)).send();
        let gone = gone.await.unwrap();
        assert_eq!(gone.status(), 409);
        assert_eq!(gone.headers()["monoslam-owner"], format!("http://{}", one.http_addr).as_str());
        // What is stored is everybody's to read.
        let request = v1::GetSessionRequest { session_id: "room".into() };
        client_of_other.get_session(request).await.unwrap();

        // A server that ends gives its sessions back: the next has them at once.
        frames.finish().await.unwrap();
        assert!(pair.one.terminate());
        let frames = FrameStream::open(&mut pair.client_of_other, open_message("room")).await.unwrap();
        frames.finish().await.unwrap();
        assert!(pair.other.terminate());
    }

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn cameras_of_one_map_are_one_servers() {
        let (url, folders) = (shared_database(), [(); 2].map(|()| tempfile::tempdir().unwrap()));
        let [one, other] = [0, 1].map(|idx| server_of_fleet(&url, folders[idx].path()));
        let (mut client, mut client_of_other) = (one.client().await, other.client().await);
        let world = SmallWorld::new(1);
        create_session(&mut client, "room", world.camera()).await.unwrap();
        let mut frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
        stream(&mut frames, &world, 0, 40).await;
        // Made at any server, served by the map's.
        let added = v1::CreateSessionRequest {
            session_id: "second".into(),
            map: "room".into(),
            ..v1::CreateSessionRequest::default()
        };
        client_of_other.create_session(added).await.unwrap();
        let mut second = FrameStream::open(&mut client_of_other, open_message("second")).await.unwrap();
        let answers = stream(&mut second, &world, 0, 30).await;
        let promised = answers.last().and_then(|answer| answer.durable_sequence);
        let metrics = reqwest::get(format!("http://{}/metrics", other.http_addr)).await.unwrap();
        let metrics = metrics.text().await.unwrap();
        let none_in_memory =
            |line: &str| line.starts_with("monoslam_sessions_loaded") && line.ends_with(" 0");
        assert!(metrics.lines().any(none_in_memory), "it was passed on to the map's server: {metrics}");

        // When it is gone, another has the map and whoever extends it.
        one.kill();
        let (mut second, _, _) = open_in_time(&mut client_of_other, "second").await;
        assert!(second.opened.durable_sequence >= promised, "what it was told is stored");
        let next = second.opened.next_sequence as usize;
        let answers = stream(&mut second, &world, next, 40 - next).await;
        assert!(answers.iter().any(|answer| answer.state() == v1::TrackingState::Tracked));
        let (frames, _, _) = open_in_time(&mut client_of_other, "room").await;
        frames.finish().await.unwrap();
        second.finish().await.unwrap();
        for id in ["room", "second"] {
            digest(&url, id).await;
        }
        assert!(other.terminate());
    }

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn a_killed_servers_session_goes_on_elsewhere() {
        let mut pair = Pair::start().await;
        let (_, answers) = pair.stream(40).await;
        let promised = answers.last().and_then(|answer| answer.durable_sequence);
        assert!(promised.is_some());
        let Pair { url, one, other, mut client_of_other, world, .. } = pair;
        let request = v1::WatchMapRequest { session_id: "room".into() };
        let mut events = client_of_other.watch_map(request).await.unwrap().into_inner();
        one.kill();
        let status = loop {
            if let Err(status) = events.message().await {
                break status;
            }
        };
        assert_eq!((status.code(), reason(&status).0.as_str()), (Code::Unavailable, "OWNER_UNREACHABLE"));
        let (mut frames, refused, waited) = open_in_time(&mut client_of_other, "room").await;
        assert!(
            !refused.is_empty() && refused.iter().all(|reason| reason == "OWNER_UNREACHABLE"),
            "{refused:?}"
        );
        assert!(frames.opened.durable_sequence >= promised, "{promised:?} was promised");
        let next = frames.opened.next_sequence as usize;
        let answers = stream(&mut frames, &world, next, 60).await;
        let is_tracked = |answer: &&v1::FrameResult| answer.state() == v1::TrackingState::Tracked;
        assert!(answers.iter().filter(is_tracked).count() > 30, "it does not find its place again");
        frames.finish().await.unwrap();
        eprintln!("another server has a killed one's session after {waited:.1?}");
        assert!(other.terminate());
        digest(&url, "room").await;
    }

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn a_server_that_stood_still_writes_nothing_and_answers_nothing() {
        let mut pair = Pair::start().await;
        let (mut still, answers) = pair.stream(40).await;
        let promised = answers.last().and_then(|answer| answer.durable_sequence);
        let Pair { url, one, other, mut client, mut client_of_other, world, .. } = pair;
        one.signal(libc::SIGSTOP);
        // Frames are on their way to it.
        for number in 48..52 {
            still.send_frame(world.frame(number)).await;
        }
        let (mut frames, _, _) = open_in_time(&mut client_of_other, "room").await;
        assert!(frames.opened.durable_sequence >= promised);
        let next = frames.opened.next_sequence as usize;
        stream(&mut frames, &world, next, 30).await;
        frames.finish().await.unwrap();
        let before = digest(&url, "room").await;

        one.signal(libc::SIGCONT);
        // Frames that it had answered before may still arrive, then the stream ends with why.
        let last = answers.last().map(|answer| answer.sequence).unwrap();
        let status = loop {
            match still.next().await {
                Ok(Some(v1::stream_frames_response::Message::Result(result))) => {
                    assert!(
                        result.sequence <= last + 9,
                        "it answered frame {} after it stood still",
                        result.sequence
                    );
                }
                Ok(other) => panic!("unexpected answer {other:?}"),
                Err(status) => break status,
            }
        };
        assert_eq!(
            (status.code(), reason(&status).0.as_str()),
            (Code::Unavailable, "LEASE_LOST"),
            "{status}"
        );
        tokio::time::sleep(LEASE).await;
        assert_eq!(digest(&url, "room").await.to_string(), before.to_string(), "it wrote");
        // It serves on, that session by passing it on.
        let frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
        assert!(frames.opened.next_sequence as usize >= next + 30);
        frames.finish().await.unwrap();
        create_session(&mut client, "hall", world.camera()).await.unwrap();
        let mut frames = FrameStream::open(&mut client, open_message("hall")).await.unwrap();
        stream(&mut frames, &world, 0, 5).await;
        frames.finish().await.unwrap();
        assert!(one.terminate() && other.terminate());
    }
}
