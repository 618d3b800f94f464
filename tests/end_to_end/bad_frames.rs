//! Frames that cannot be used: each is answered by name, nothing of it is kept, and the stream goes on.

use proto::v1;
use proto::v1::stream_frames_request::Message as Request;
use proto::v1::stream_frames_response::Message as Response;
use tests::{
    FrameStream, TestServer, camera, create_session, frame, jpeg, open_message, oversized_png, png, raw_gray,
};
use tonic::Code;

const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;

fn gray(width: u32, height: u32) -> Vec<u8> {
    vec![128; (width * height) as usize]
}

fn good() -> v1::Image {
    png(WIDTH, HEIGHT, &gray(WIDTH, HEIGHT))
}

async fn opened(server: &TestServer) -> FrameStream {
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(WIDTH, HEIGHT)).await.unwrap();
    FrameStream::open(&mut client, open_message("s")).await.unwrap()
}

async fn rejection(stream: &mut FrameStream, frame: v1::Frame) -> v1::FrameRejected {
    let shown =
        format!("{} {} {:?}", frame.sequence, frame.timestamp_ns, frame.image.as_ref().map(|i| i.data.len()));
    match stream.exchange(frame).await.unwrap() {
        Response::Rejected(rejected) => rejected,
        other => panic!("frame {shown} was not rejected: {other:?}"),
    }
}

#[tokio::test]
async fn every_kind_of_bad_image_is_rejected_and_the_stream_goes_on() {
    let server = TestServer::start().await;
    let mut stream = opened(&server).await;
    let pixels = gray(WIDTH, HEIGHT);
    let whole_png = good().data;
    let whole_jpeg = jpeg(WIDTH, HEIGHT, &pixels).data;
    let file = |data: bytes::Bytes| v1::Image { data, ..v1::Image::default() };
    let raw = raw_gray(WIDTH, HEIGHT, &pixels);
    let cases = [
        ("WRONG_IMAGE_SIZE", png(WIDTH, HEIGHT - 1, &gray(WIDTH, HEIGHT - 1))),
        ("TRUNCATED_IMAGE", file(whole_png.slice(..whole_png.len() / 2))),
        ("TRUNCATED_IMAGE", file(whole_jpeg.slice(..whole_jpeg.len() / 2))),
        ("UNKNOWN_FORMAT", file(bytes::Bytes::from_static(b"certainly not an image"))),
        ("UNKNOWN_FORMAT", file(bytes::Bytes::new())),
        ("WRONG_FORMAT", v1::Image { encoding: v1::ImageEncoding::Jpeg.into(), ..good() }),
        ("UNKNOWN_FORMAT", v1::Image { encoding: 99, ..good() }),
        ("EMPTY_IMAGE", raw_gray(0, 0, &[])),
        ("EMPTY_IMAGE", oversized_png(0, 0)),
        ("IMAGE_TOO_LARGE", oversized_png(30_000, 30_000)),
        ("IMAGE_TOO_LARGE", raw_gray(u32::MAX, u32::MAX, &[])),
        ("IMAGE_TOO_SMALL", png(64, 48, &gray(64, 48))),
        ("WRONG_DATA_LENGTH", v1::Image { data: raw.data.slice(1..), ..raw.clone() }),
        ("STRIDE_TOO_SHORT", v1::Image { row_stride: 1, ..raw.clone() }),
    ];
    let n = cases.len() as u64;
    for (sequence, (code, image)) in (0..).zip(cases) {
        let rejected = rejection(&mut stream, frame(sequence, image)).await;
        // What a decoder calls a cut or an empty file is its own business, as long as it is named.
        let also = if code == "EMPTY_IMAGE" || code == "TRUNCATED_IMAGE" { "MALFORMED_IMAGE" } else { code };
        assert!(rejected.code == code || rejected.code == also, "expected {code}, got {rejected:?}");
        assert!(rejected.field.starts_with("image") && !rejected.reason.is_empty(), "{rejected:?}");
        assert_eq!(rejected.sequence, sequence);
    }
    let missing = v1::Frame { sequence: n, timestamp_ns: 0, image: None };
    assert_eq!(rejection(&mut stream, missing).await.code, "MISSING_IMAGE");

    let tracked = stream.track(frame(n, good())).await.unwrap();
    assert_eq!((tracked.sequence, tracked.state()), (n, v1::TrackingState::Initialising));
    assert!(!tracked.reason.is_empty(), "a frame without a pose says why");
    stream.finish().await.unwrap();
    let session = server.get_json("/v1/sessions/s").await;
    assert_eq!((session["n_frames"].as_u64(), session["durable_sequence"].as_u64()), (Some(1), Some(n)));
}

#[tokio::test]
async fn time_goes_on_and_numbers_are_answered_once() {
    let server = TestServer::start().await;
    let mut stream = opened(&server).await;
    stream.track(frame(5, good())).await.unwrap();
    for timestamp_ns in [frame(5, good()).timestamp_ns, 0, i64::MIN] {
        let late = v1::Frame { timestamp_ns, ..frame(6, good()) };
        let rejected = rejection(&mut stream, late).await;
        assert_eq!(
            (rejected.code.as_str(), rejected.field.as_str()),
            ("TIMESTAMP_NOT_INCREASING", "timestamp_ns")
        );
    }
    let huge = v1::Frame { sequence: u64::MAX, ..frame(6, good()) };
    assert_eq!(rejection(&mut stream, huge).await.field, "sequence");

    let next = stream.track(frame(7, good())).await.unwrap();
    assert!(!next.repeated, "a gap in the numbers is allowed");
    let repeated = stream.track(frame(5, good())).await.unwrap();
    assert!(repeated.repeated && repeated.sequence == 5, "{repeated:?}");
    assert_eq!(repeated.state(), v1::TrackingState::Initialising, "the answer is the one of before");
    stream.finish().await.unwrap();

    // Also when the session has left memory meanwhile, from the database.
    let server = server.restart().await;
    let mut client = server.client().await;
    let mut stream = FrameStream::open(&mut client, open_message("s")).await.unwrap();
    assert_eq!((stream.opened.next_sequence, stream.opened.durable_sequence), (8, Some(7)));
    let repeated = stream.track(frame(7, good())).await.unwrap();
    assert!(repeated.repeated && repeated.state() == v1::TrackingState::Initialising, "{repeated:?}");
    let next = stream.track(frame(8, good())).await.unwrap();
    assert!(!next.repeated);
    stream.finish().await.unwrap();
    assert_eq!(server.get_json("/v1/sessions/s").await["n_frames"], 3);
}

#[tokio::test]
async fn breaking_the_protocol_ends_the_stream_after_the_answers_that_are_due() {
    let server = TestServer::start().await;
    let mut stream = opened(&server).await;
    stream.send_frame(frame(0, good())).await;
    stream.send(Request::Open(open_message("s"))).await;
    let first = stream.next().await.unwrap();
    assert!(matches!(first, Some(Response::Result(_))), "{first:?}");
    let status = stream.next().await.unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument);
    // What was tracked before is saved.
    assert_eq!(server.get_json("/v1/sessions/s").await["durable_sequence"], 0);

    let mut client = server.client().await;
    let mut without_open = FrameStream::start(&mut client).await.unwrap();
    let status = without_open.exchange(frame(1, good())).await.unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument);
    assert!(status.message().contains("open"), "{status}");

    let vague = v1::OpenStream { session_id: "s".into(), ..v1::OpenStream::default() };
    let status = FrameStream::open(&mut client, vague).await.err().unwrap();
    assert_eq!(status.code(), Code::InvalidArgument);
    assert!(status.message().contains("open.mode"), "{status}");
}

#[tokio::test]
async fn realtime_answers_every_frame_in_order_and_drops_what_is_late() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "s", camera(1280, 960)).await.unwrap();
    let open = v1::OpenStream { policy: v1::StreamPolicy::Realtime.into(), ..open_message("s") };
    let mut stream = FrameStream::open(&mut client, open).await.unwrap();
    // Noise is dear to decode and to search for features, so that frames come faster than they are tracked.
    let mut state = 1_u32;
    let noise: Vec<u8> = std::iter::repeat_with(|| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    })
    .take(1280 * 960)
    .collect();
    let image = png(1280, 960, &noise);
    let sender = stream.sender();
    const N: u64 = 40;
    let sending = tokio::spawn(async move {
        for sequence in 0..N {
            let message = Some(Request::Frame(frame(sequence, image.clone())));
            sender.send(v1::StreamFramesRequest { message }).await.unwrap();
        }
    });
    let mut n_dropped = 0;
    for expected in 0..N {
        let sequence = match stream.next().await.unwrap().unwrap() {
            Response::Result(result) => result.sequence,
            Response::Dropped(dropped) => {
                n_dropped += 1;
                dropped.sequence
            }
            other => panic!("{other:?}"),
        };
        assert_eq!(sequence, expected);
    }
    sending.await.unwrap();
    assert!((1..N).contains(&n_dropped), "{n_dropped} of {N} frames were dropped");
    stream.finish().await.unwrap();
}
