//! Any server of a fleet can be asked: what another must answer is passed on to it.

use crate::crash::stream;
use crate::fleet::{Pair, reason, server_with};
use futures_util::{SinkExt, StreamExt};
use proto::v1;
use proto::v1::session_event::Event;
use std::time::{Duration, Instant};
use testkit::postgres::shared_database;
use tests::{FrameStream, SmallWorld, create_session, open_message};
use tokio_tungstenite::tungstenite::Message;
use tonic::Code;
use tonic_types::StatusExt;

/// How many bytes of a stream may wait on the way to a server that reads nothing: the windows of two
/// connections and what the kernel keeps for them.
const MAX_UNDER_WAY_BYTES: usize = 32 << 20;

/// The next event of a stream of server-sent events, by its name.
async fn next_named(events: &mut reqwest::Response, name: &str) -> String {
    let mut text = String::new();
    let found = async {
        loop {
            let chunk = events.chunk().await.unwrap().expect("the events go on");
            text.push_str(&String::from_utf8_lossy(&chunk));
            let event = text.split("\n\n").find(|event| event.contains(&format!("event: {name}\n")));
            if let Some(event) = event.filter(|event| text.contains(&format!("{event}\n\n"))) {
                return event.to_owned();
            }
        }
    };
    tokio::time::timeout(Duration::from_secs(20), found).await.unwrap_or_else(|_| panic!("no event {name}"))
}

mod postgres {
    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn calls_and_streams_are_passed_on_to_the_sessions_server() {
        let mut pair = Pair::start().await;
        let (frames, _) = pair.stream(3).await;
        let Pair { other, client_of_other, world, .. } = &mut pair;

        // Who watches by one server sees what another does.
        let request = v1::WatchMapRequest { session_id: "room".into() };
        let mut events = client_of_other.watch_map(request).await.unwrap().into_inner();
        let http = reqwest::Client::new();
        let address = |path: &str| format!("http://{}/v1/sessions/room{path}", other.http_addr);
        let mut sse = http.get(address("/events")).send().await.unwrap();
        assert_eq!(sse.status(), 200);
        assert!(next_named(&mut sse, "session").await.contains("\"room\""));

        // What its server refuses is refused in its words.
        let request = v1::DeleteSessionRequest { session_id: "room".into() };
        let status = client_of_other.delete_session(request.clone()).await.unwrap_err();
        assert_eq!(
            (status.code(), reason(&status).0.as_str()),
            (Code::FailedPrecondition, "WRITER_CONNECTED")
        );
        assert_eq!(http.delete(address("")).send().await.unwrap().status(), 409);
        let status = FrameStream::open(client_of_other, open_message("room")).await.err().unwrap();
        assert_eq!(reason(&status).0, "WRITER_CONNECTED");
        let taking_over = v1::OpenStream { take_over: true, ..open_message("room") };
        let mut passed = FrameStream::open(client_of_other, taking_over).await.unwrap();
        drop(frames);
        let next = passed.opened.next_sequence as usize;
        let answers = stream(&mut passed, world, next, 40).await;
        assert!(answers.iter().any(|answer| answer.state() == v1::TrackingState::Tracked));
        let seen = async {
            loop {
                if let Some(Event::Frame(frame)) = events.message().await.unwrap().unwrap().event
                    && frame.sequence as usize >= next
                {
                    return;
                }
            }
        };
        tokio::time::timeout(Duration::from_secs(10), seen).await.unwrap();
        assert!(next_named(&mut sse, "frame").await.contains("\"sequence\""));
        passed.finish().await.unwrap();

        // Changes, with a body and without.
        let scaled = http.post(address("/scale")).json(&serde_json::json!({ "metres_per_unit": 2.5 }));
        assert_eq!(scaled.send().await.unwrap().status(), 200);
        let scene = http.get(address("/scene")).send().await.unwrap();
        assert_eq!(scene.status(), 200);
        let scene = scene.text().await.unwrap();
        assert!(scene.contains("keyframes") && scene.len() > 1000, "{scene}");
        let begun = client_of_other.optimize_map(v1::OptimizeMapRequest { session_id: "room".into() }).await;
        let operation = begun.unwrap().into_inner();
        // Asked of a server that does not know it.
        let request = v1::GetOperationRequest { operation_id: operation.id.clone() };
        let known = client_of_other.get_operation(request).await.unwrap().into_inner();
        assert_eq!(known.id, operation.id);
        let found =
            http.get(format!("http://{}/v1/operations/{}", other.http_addr, operation.id)).send().await;
        assert_eq!(found.unwrap().status(), 200);
        let done = async {
            while client_of_other.delete_session(request_to_delete()).await.is_err() {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(30), done).await.expect("the session can be deleted");
        let request = v1::GetSessionRequest { session_id: "room".into() };
        assert_eq!(pair.client.get_session(request).await.unwrap_err().code(), Code::NotFound);
        assert!(pair.one.terminate() && pair.other.terminate());
    }

    fn request_to_delete() -> v1::DeleteSessionRequest {
        v1::DeleteSessionRequest { session_id: "room".into() }
    }

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn a_web_socket_is_passed_on_and_a_marked_request_is_not() {
        let mut pair = Pair::start().await;
        let (frames, _) = pair.stream(3).await;
        frames.finish().await.unwrap();
        let address = format!("ws://{}/v1/sessions/room/stream?policy=lossless", pair.other.http_addr);
        let (mut socket, _) = tokio_tungstenite::connect_async(&address).await.unwrap();
        let opened = socket.next().await.unwrap().unwrap().into_text().unwrap();
        let opened: serde_json::Value = serde_json::from_str(&opened).unwrap();
        assert_eq!(opened["type"], "opened");
        let first = opened["session"]["next_sequence"].as_u64().unwrap();
        for sequence in first..first + 5 {
            let frame = pair.world.frame(sequence as usize);
            let raw = frame.image.unwrap();
            let image = tests::jpeg(raw.width, raw.height, &raw.data).data;
            let head = [sequence.to_le_bytes(), frame.timestamp_ns.to_le_bytes()].concat();
            socket.send(Message::binary([&head, &image[..]].concat())).await.unwrap();
            let answer = socket.next().await.unwrap().unwrap().into_text().unwrap();
            let answer: serde_json::Value = serde_json::from_str(&answer).unwrap();
            assert_eq!(
                (&answer["type"], &answer["sequence"]),
                (&"result".into(), &sequence.into()),
                "{answer}"
            );
        }
        socket.send(Message::text("finish")).await.unwrap();
        while let Some(Ok(message)) = socket.next().await {
            assert!(matches!(message, Message::Close(_) | Message::Ping(_)), "{message}");
        }
        // A mark keeps a request from being passed on, whoever made it.
        let marked = reqwest::Client::new()
            .delete(format!("http://{}/v1/sessions/room", pair.other.http_addr))
            .header("monoslam-passed", "127.0.0.1 plain AAAA");
        let marked = marked.send().await.unwrap();
        assert_eq!(marked.status(), 409);
        assert_eq!(marked.headers()["monoslam-owner"], format!("http://{}", pair.one.http_addr).as_str());
        assert!(pair.one.terminate() && pair.other.terminate());
    }

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn a_stream_to_a_server_that_reads_nothing_is_held_back_and_ends() {
        let mut pair = Pair::start().await;
        let (frames, _) = pair.stream(3).await;
        frames.finish().await.unwrap();
        let mut passed = FrameStream::open(&mut pair.client_of_other, open_message("room")).await.unwrap();
        let next = passed.opened.next_sequence;
        pair.one.signal(libc::SIGSTOP);
        let image = tests::raw_gray(1024, 1024, &vec![0; 1 << 20]);
        let (sender, begun, mut n_bytes) = (passed.sender(), Instant::now(), 0);
        for sequence in next.. {
            let frame = tests::frame(sequence, image.clone());
            let message = Some(v1::stream_frames_request::Message::Frame(frame));
            let sent = sender.send(v1::StreamFramesRequest { message });
            if tokio::time::timeout(Duration::from_millis(500), sent).await.is_err() {
                break;
            }
            n_bytes += 1 << 20;
            assert!(n_bytes < MAX_UNDER_WAY_BYTES, "nobody holds it back");
        }
        // Within the lease another server could not take the session; then the stream ends.
        let status = loop {
            if let Err(status) = passed.next().await {
                break status;
            }
        };
        assert_eq!((status.code(), reason(&status).0.as_str()), (Code::Unavailable, "LEASE_LOST"));
        assert!(begun.elapsed() < Duration::from_secs(6), "{:?}", begun.elapsed());
        eprintln!("{} MiB were under way", n_bytes >> 20);
        pair.one.signal(libc::SIGCONT);
        assert!(pair.one.terminate() && pair.other.terminate());
    }

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn a_session_goes_to_the_server_that_has_room() {
        let mut pair = Pair::start_with(&[("MONOSLAM_LIMITS__MAX_LOADED_SESSIONS", "1")]).await;
        let (frames, _) = pair.stream(3).await;
        create_session(&mut pair.client, "hall", pair.world.camera()).await.unwrap();
        create_session(&mut pair.client, "attic", pair.world.camera()).await.unwrap();
        // Reported every third of a lease.
        tokio::time::sleep(Duration::from_secs(1)).await;
        let mut placed = FrameStream::open(&mut pair.client, open_message("hall")).await.unwrap();
        stream(&mut placed, &pair.world, 0, 3).await;
        tokio::time::sleep(Duration::from_secs(1)).await;
        let fleet = reqwest::get(format!("http://{}/v1/fleet", pair.one.http_addr)).await.unwrap();
        let fleet: serde_json::Value = fleet.json().await.unwrap();
        let servers = fleet["servers"].as_array().unwrap();
        assert_eq!(servers.len(), 2, "{fleet}");
        for server in servers {
            assert_eq!((&server["n_streams"], &server["n_free_streams"]), (&1.into(), &0.into()), "{fleet}");
        }
        let status = FrameStream::open(&mut pair.client, open_message("attic")).await.err().unwrap();
        assert_eq!(reason(&status).0, "TOO_MANY_LOADED_SESSIONS");
        frames.finish().await.unwrap();
        placed.finish().await.unwrap();
        assert!(pair.one.terminate() && pair.other.terminate());
    }

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "needs PostgreSQL"]
    async fn servers_that_encrypt_are_believed_by_their_certificates() {
        let (url, files) = (shared_database(), tempfile::tempdir().unwrap());
        let certified = rcgen::generate_simple_self_signed(["127.0.0.1".to_owned()]).unwrap();
        let write = |name: &str, text: String| {
            let path = files.path().join(name);
            std::fs::write(&path, text).unwrap();
            path.to_str().unwrap().to_owned()
        };
        let cert = write("cert.pem", certified.cert.pem());
        let key = write("key.pem", certified.signing_key.serialize_pem());
        let folders = [(); 3].map(|()| tempfile::tempdir().unwrap());
        let full = ("MONOSLAM_LIMITS__MAX_LOADED_SESSIONS", "1");
        let encrypted = [("MONOSLAM_TLS__CERT", cert.as_str()), ("MONOSLAM_TLS__KEY", key.as_str())];
        let roomy = server_with(&url, folders[0].path(), &encrypted);
        let trusting = server_with(&url, folders[1].path(), &[full, ("MONOSLAM_FLEET__CA", &cert)]);
        let wary = server_with(&url, folders[2].path(), &[full]);

        let (mut client, mut client_of_wary) = (trusting.client().await, wary.client().await);
        let world = SmallWorld::new(1);
        for id in ["room", "hall", "attic"] {
            create_session(&mut client, id, world.camera()).await.unwrap();
        }
        let frames = FrameStream::open(&mut client, open_message("room")).await.unwrap();
        let wary_frames = FrameStream::open(&mut client_of_wary, open_message("attic")).await.unwrap();
        tokio::time::sleep(Duration::from_secs(1)).await;
        // Both are full: the session goes to the server that encrypts.
        let mut placed = FrameStream::open(&mut client, open_message("hall")).await.unwrap();
        stream(&mut placed, &world, 0, 3).await;
        let taking_over = v1::OpenStream { take_over: true, ..open_message("hall") };
        let status = FrameStream::open(&mut client_of_wary, taking_over).await.err().unwrap();
        assert_eq!((status.code(), reason(&status).0.as_str()), (Code::Unavailable, "OWNER_UNREACHABLE"));
        let told = status.get_error_details();
        assert!(told.retry_info().is_some_and(|info| info.retry_delay.is_some()), "{told:?}");
        let deleted = reqwest::Client::new().delete(format!("http://{}/v1/sessions/hall", wary.http_addr));
        let deleted = deleted.send().await.unwrap();
        assert_eq!(deleted.status(), 503);
        assert_eq!(deleted.headers()["retry-after"], "1");
        for stream in [placed, frames, wary_frames] {
            stream.finish().await.unwrap();
        }
        assert!(roomy.terminate() && trusting.terminate() && wary.terminate());
    }

    /// Median time from a frame of 640 × 480 pixels to its answer, where that is only that it is of another
    /// camera.
    async fn median_exchange(stream: &mut FrameStream) -> Duration {
        let image = tests::raw_gray(640, 480, &vec![0; 640 * 480]);
        let mut times = Vec::new();
        for sequence in 0..200 {
            let begun = Instant::now();
            stream.exchange(tests::frame(1000 + sequence, image.clone())).await.unwrap();
            times.push(begun.elapsed());
        }
        times.sort();
        times[times.len() / 2]
    }

    #[tokio::test(flavor = "multi_thread")]
    #[ignore = "measures: the way through a second server; needs PostgreSQL"]
    async fn what_passing_on_costs_a_frame() {
        let mut pair = Pair::start().await;
        let mut frames = FrameStream::open(&mut pair.client, open_message("room")).await.unwrap();
        let direct = median_exchange(&mut frames).await;
        frames.finish().await.unwrap();
        let mut frames = FrameStream::open(&mut pair.client_of_other, open_message("room")).await.unwrap();
        let passed = median_exchange(&mut frames).await;
        frames.finish().await.unwrap();
        eprintln!("a frame of 307 kB and its answer: {direct:.2?} directly, {passed:.2?} passed on");
        assert!(passed < direct + Duration::from_millis(100));
        assert!(pair.one.terminate() && pair.other.terminate());
    }
}
