//! Frames over a WebSocket, as a page in a browser sends them.

use futures_util::SinkExt;
use serde_json::Value;
use tests::{Client, SmallWorld, TestServer, create_session, jpeg};
use tokio::net::TcpStream;
use tokio_stream::StreamExt;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

/// Frames of the room that are streamed: five seconds.
const N_FRAMES: usize = 50;

struct Socket(WebSocketStream<MaybeTlsStream<TcpStream>>);

impl Socket {
    async fn open(server: &TestServer, query: &str) -> Self {
        Self(connect_async(address(server, "room", query)).await.expect("the socket opens").0)
    }

    async fn send(&mut self, sequence: u64, timestamp_ns: i64, image: &[u8]) {
        let head = [sequence.to_le_bytes(), timestamp_ns.to_le_bytes()].concat();
        self.0.send(Message::binary([&head, image].concat())).await.expect("the server reads");
    }

    /// The next message but pings; `None` once the server has closed the socket.
    async fn next(&mut self) -> Option<Value> {
        loop {
            match self.0.next().await? {
                Ok(Message::Text(text)) => return Some(serde_json::from_str(&text).expect("JSON")),
                Ok(Message::Close(_)) | Err(_) => return None,
                Ok(_) => {}
            }
        }
    }

    async fn next_type(&mut self) -> String {
        self.next().await.map_or_else(|| "closed".into(), |message| message["type"].as_str().unwrap().into())
    }
}

fn address(server: &TestServer, session: &str, query: &str) -> String {
    format!("ws://{}/v1/sessions/{session}/stream{query}", server.running().http_addr)
}

/// A frame of the world as a JPEG file.
fn image(world: &SmallWorld, i: usize) -> Vec<u8> {
    let raw = world.frame(i).image.expect("a frame has an image");
    jpeg(raw.width, raw.height, &raw.data).data.to_vec()
}

async fn room(world: &SmallWorld) -> (TestServer, Client) {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "room", world.camera()).await.unwrap();
    (server, client)
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_from_a_browser_become_a_map() {
    let world = SmallWorld::new(1);
    let (server, _client) = room(&world).await;
    let mut socket = Socket::open(&server, "?policy=lossless").await;
    let opened = socket.next().await.unwrap();
    assert_eq!((&opened["type"], &opened["session"]["next_sequence"]), (&"opened".into(), &0.into()));
    let mut n_tracked = 0;
    for i in 0..N_FRAMES {
        socket.send(i as u64, world.frame(i).timestamp_ns, &image(&world, i)).await;
        let answer = socket.next().await.unwrap();
        assert_eq!((&answer["type"], &answer["sequence"]), (&"result".into(), &i.into()), "{answer}");
        n_tracked += usize::from(answer["state"] == "tracked" && answer["world_from_camera"]["qw"].is_f64());
    }
    assert!(n_tracked > N_FRAMES / 2, "{n_tracked} of {N_FRAMES} were tracked");
    // Sent once more, as after a broken connection: not tracked twice.
    socket.send(3, world.frame(3).timestamp_ns, &image(&world, 3)).await;
    assert_eq!(socket.next_type().await, "repeated");
    socket.0.send(Message::text("finish")).await.unwrap();
    assert_eq!(socket.next_type().await, "closed");
    let session = server.get_json("/v1/sessions/room").await;
    assert_eq!(
        session["durable_sequence"],
        N_FRAMES as u64 - 1,
        "everything is saved before the socket closes"
    );
    assert_eq!(session["n_frames"], N_FRAMES);
    assert!(session["n_points"].as_u64().unwrap() > 50, "{session}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_cannot_be_used_is_answered_and_a_message_that_is_none_ends_the_stream() {
    let world = SmallWorld::new(1);
    let (server, _client) = room(&world).await;
    let mut socket = Socket::open(&server, "").await;
    assert_eq!(socket.next_type().await, "opened");
    socket.send(0, 1, b"no image").await;
    let rejected = socket.next().await.unwrap();
    assert_eq!(
        (&rejected["type"], &rejected["code"]),
        (&"rejected".into(), &"UNKNOWN_FORMAT".into()),
        "{rejected}"
    );
    socket.send(u64::MAX, 1, &image(&world, 0)).await;
    assert_eq!(socket.next().await.unwrap()["code"], "SEQUENCE_OUT_OF_RANGE");
    socket.send(0, 1, &image(&world, 0)).await;
    assert_eq!(socket.next_type().await, "result");
    for (message, sentence) in [
        (Message::text("more"), "message: a text message can only be `finish`"),
        (Message::binary(vec![0; 15]), "message: a frame begins with 16 bytes, its number and its time"),
    ] {
        socket.0.send(message).await.unwrap();
        let error = socket.next().await.unwrap();
        assert_eq!((&error["type"], &error["problem"]["detail"]), (&"error".into(), &sentence.into()));
        assert_eq!((&error["problem"]["status"], socket.next_type().await.as_str()), (&400.into(), "closed"));
        socket = Socket::open(&server, "").await;
        assert_eq!(socket.next_type().await, "opened");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_browser_writes_at_a_time_and_another_may_take_over() {
    let world = SmallWorld::new(1);
    let (server, _client) = room(&world).await;
    let mut first = Socket::open(&server, "").await;
    assert_eq!(first.next_type().await, "opened");
    let mut second = Socket::open(&server, "").await;
    let refused = second.next().await.unwrap();
    assert_eq!(
        (&refused["type"], &refused["problem"]["code"]),
        (&"error".into(), &"WRITER_CONNECTED".into())
    );
    assert_eq!(second.next_type().await, "closed");
    let mut third = Socket::open(&server, "?take_over=true").await;
    assert_eq!(third.next_type().await, "opened");
    assert_eq!(first.next().await.unwrap()["problem"]["code"], "TAKEN_OVER");
    // A browser that is gone leaves room for the next.
    drop(third);
    for _ in 0..200 {
        let mut next = Socket::open(&server, "").await;
        if next.next_type().await == "opened" {
            return;
        }
        tokio::time::sleep(std::time::Duration::from_millis(50)).await;
    }
    panic!("the session still has the writer that left");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_stream_of_ours_is_refused_by_status() {
    let (server, _client) = room(&SmallWorld::new(1)).await;
    let status = |error: Error| match error {
        Error::Http(response) => response.status().as_u16(),
        other => panic!("{other}"),
    };
    let nobody = connect_async(address(&server, "nobody", "")).await.unwrap_err();
    assert_eq!(status(nobody), 404);
    let unknown = connect_async(address(&server, "room", "?speed=9")).await.unwrap_err();
    assert_eq!(status(unknown), 400);
    let mut foreign = address(&server, "room", "").into_client_request().unwrap();
    foreign.headers_mut().insert("origin", "http://evil.example".parse().unwrap());
    assert_eq!(status(connect_async(foreign).await.unwrap_err()), 403);
    let plain = format!("http://{}/v1/sessions/room/stream", server.running().http_addr);
    let plain = reqwest::get(plain).await.unwrap();
    assert_eq!(plain.status(), 400);
    let problem: Value = plain.json().await.unwrap();
    assert_eq!(problem["violations"][0]["field"], "upgrade");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_stops_says_so_and_saves_what_it_was_sent() {
    let world = SmallWorld::new(1);
    let (server, client) = room(&world).await;
    let mut socket = Socket::open(&server, "").await;
    assert_eq!(socket.next_type().await, "opened");
    socket.send(0, world.frame(0).timestamp_ns, &image(&world, 0)).await;
    assert_eq!(socket.next_type().await, "result");
    drop(client);
    let restarting = tokio::spawn(server.restart());
    let error = socket.next().await.unwrap();
    assert_eq!((&error["type"], &error["problem"]["code"]), (&"error".into(), &"SHUTTING_DOWN".into()));
    assert_eq!(socket.next_type().await, "closed");
    let server = restarting.await.expect("it shuts down in order, with nothing abandoned, and starts again");
    assert_eq!(server.get_json("/v1/sessions/room").await["durable_sequence"], 0);
}
