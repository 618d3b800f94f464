//! How long it takes to find, among a hundred maps, the one that an image shows.

use proto::v1;
use std::time::{Duration, Instant};
use testkit::stored::{TRACKED, new_session};
use testkit::world::{Size, first_update, structured};
use tests::{FrameStream, SmallWorld, TestServer, create_session, open_message};

const N_MAPS: u64 = 100;
const LARGE: Size = Size { n_keyframes: 150, n_keypoints: 1000, n_points: 12_000 };
const N_FRAMES: usize = 60;

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes: prints the figures of docs/performance.md"]
async fn an_image_is_found_among_a_hundred_maps() {
    let world = SmallWorld::new(1);
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "room", world.camera()).await.unwrap();
    let mut stream = FrameStream::open(&mut client, open_message("room")).await.unwrap();
    for i in 0..N_FRAMES {
        stream.track(world.frame(i)).await.unwrap();
    }
    stream.finish().await.unwrap();
    let store = server.running().store();
    for i in 1..N_MAPS {
        let id = format!("map{i:03}");
        store.create_session(&new_session(&id)).await.unwrap();
        store.save_update(&id, &first_update(&structured(i, LARGE)), TRACKED, &[]).await.unwrap();
    }
    let ask = async |client: &mut tests::Client, i: usize| {
        let image = world.frame(i).image;
        let request = v1::LocalizeRequest { all_sessions: true, image, ..Default::default() };
        let begin = Instant::now();
        let answer = client.localize(request).await.unwrap().into_inner();
        let elapsed = begin.elapsed();
        println!(
            "{:.0} ms ({:.0} to search and load, {:.0} to locate), {} searched, {} tried",
            elapsed.as_secs_f64() * 1e3,
            answer.load_ms,
            answer.locate_ms,
            answer.n_sessions_searched,
            answer.n_sessions_tried
        );
        assert_eq!(answer.session_id, "room", "{answer:?}");
        elapsed
    };
    println!("first image, nothing indexed:");
    ask(&mut client, 50).await;
    println!("further images:");
    let mut times = Vec::new();
    for i in [40, 45, 50, 55, 35] {
        times.push(ask(&mut client, i).await);
    }
    times.sort();
    assert!(times[times.len() / 2] < Duration::from_secs(1), "{times:?}");
}
