//! What is not the scene: found or given, told, shown, and kept across a restart.

use bytes::Bytes;
use proto::v1;
use proto::v1::stream_frames_response::Message as Response;
use tests::{FrameStream, SmallWorld, TestServer, create_session, open_message, png};

/// Frames of the room that are streamed: enough for a border to be found.
const N_FRAMES: usize = 30;
/// Width of the black frame about the images, pixels.
const BORDER_PX: usize = 40;

/// A frame of the world with a black border painted over it.
fn framed(world: &SmallWorld, sequence: usize) -> v1::Frame {
    let camera = world.camera();
    let (width, height) = (camera.width as usize, camera.height as usize);
    let mut pixels = world.pixels(sequence);
    for (at, pixel) in pixels.iter_mut().enumerate() {
        if is_border(at % width, at / width, width, height) {
            *pixel = 0;
        }
    }
    v1::Frame { image: Some(png(camera.width, camera.height, &pixels)), ..world.frame(sequence) }
}

fn is_border(x: usize, y: usize, width: usize, height: usize) -> bool {
    let inside = BORDER_PX..width - BORDER_PX;
    !inside.contains(&x) || !(BORDER_PX..height - BORDER_PX).contains(&y)
}

/// A picture of that border, as a mask.
fn border_picture(camera: &v1::Camera) -> Bytes {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let pixel = |at: usize| if is_border(at % width, at / width, width, height) { 0 } else { 255 };
    png(camera.width, camera.height, &(0..width * height).map(pixel).collect::<Vec<u8>>()).data
}

fn border_share(camera: &v1::Camera) -> f64 {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let border = 2.0 * BORDER_PX as f64;
    1.0 - (width - border) * (height - border) / (width * height)
}

#[tokio::test]
async fn a_black_border_is_found_told_shown_and_kept() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    let world = SmallWorld::new(1);
    create_session(&mut client, "room", world.camera()).await.unwrap();
    assert!(server.get_json("/v1/sessions/room").await["mask"].is_null());
    let mut stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    for sequence in 0..N_FRAMES {
        assert!(stream.send_frame(framed(&world, sequence)).await);
        assert!(matches!(stream.next().await.unwrap(), Some(Response::Result(_))));
    }
    stream.finish().await.unwrap();
    let told = server.get_json("/v1/sessions/room").await["mask"].clone();
    let share = told["share"].as_f64().expect("a border is found");
    assert!((share - border_share(&world.camera())).abs() < 0.03, "{share}");
    assert_eq!(told["given"], false);

    let server = server.restart().await;
    assert_eq!(server.get_json("/v1/sessions/room").await["mask"], told);
    let url = format!("http://{}/v1/sessions/room/mask", server.running().http_addr);
    let response = reqwest::get(&url).await.unwrap();
    assert_eq!(response.headers()["content-type"], "image/png");
    let picture = image::load_from_memory(&response.bytes().await.unwrap()).unwrap().into_luma8();
    assert_eq!((picture.get_pixel(10, 100).0, picture.get_pixel(240, 180).0), ([0], [255]));
}

#[tokio::test]
async fn a_mask_that_is_given_is_taken_as_it_is() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    let world = SmallWorld::new(1);
    let camera = world.camera();
    let request = |session_id: &str, mask: Vec<u8>| v1::CreateSessionRequest {
        session_id: session_id.to_owned(),
        camera: Some(world.camera()),
        options: None,
        mask,
        ..v1::CreateSessionRequest::default()
    };
    let made = client.create_session(request("room", border_picture(&camera).to_vec())).await.unwrap();
    let mask = made.into_inner().mask.expect("a mask was given");
    assert!(mask.given && (mask.share - border_share(&camera)).abs() < 1e-6, "{mask:?}");

    let small = png(320, 240, &[255; 320 * 240]).data.to_vec();
    let refused = client.create_session(request("small", small)).await.unwrap_err();
    assert!(refused.message().contains("must be the same"), "{refused}");
    let black = png(camera.width, camera.height, &vec![0; (camera.width * camera.height) as usize]);
    let refused = client.create_session(request("black", black.data.to_vec())).await.unwrap_err();
    assert!(refused.message().contains("white where the scene is"), "{refused}");

    // Over HTTP, to a session that is there.
    create_session(&mut client, "other", world.camera()).await.unwrap();
    let url = format!("http://{}/v1/sessions/other/mask", server.running().http_addr);
    let http = reqwest::Client::new();
    assert_eq!(http.get(&url).send().await.unwrap().status(), 404, "nothing is left out yet");
    let put = http.put(&url).body(border_picture(&camera)).send().await.unwrap();
    assert_eq!(put.status(), 200);
    assert_eq!(server.get_json("/v1/sessions/other").await["mask"]["given"], true);
    assert_eq!(http.delete(&url).send().await.unwrap().status(), 200);
    assert!(server.get_json("/v1/sessions/other").await["mask"].is_null());
}
