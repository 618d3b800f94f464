//! Readings of motion sensors: sent, sent again, kept across a restart, and given out as they came.

use tests::{SmallWorld, TestServer, create_session};

const FIRST: &str = "1000,0.1,0.2,0.3,0,-9.81,0.5\n2000,0.1,0.25,0.3,0,-9.8,0.5\n";
const SECOND: &str = "3000,0,0,0,1,2,3\n";

async fn post(server: &TestServer, session: &str, body: &str) -> (u16, String) {
    let url = format!("http://{}/v1/sessions/{session}/motion", server.running().http_addr);
    let request = reqwest::Client::new().post(url).header("content-type", "text/csv");
    let answer = request.body(body.to_owned()).send().await.unwrap();
    (answer.status().as_u16(), answer.text().await.unwrap())
}

async fn get(server: &TestServer, session: &str) -> (u16, String) {
    let url = format!("http://{}/v1/sessions/{session}/motion", server.running().http_addr);
    let answer = reqwest::get(url).await.unwrap();
    (answer.status().as_u16(), answer.text().await.unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn readings_of_motion_sensors_are_kept_once_and_given_out() {
    let server = TestServer::start().await;
    let mut client = server.client().await;
    create_session(&mut client, "room", SmallWorld::new(1).camera()).await.unwrap();
    assert_eq!(post(&server, "room", SECOND).await, (200, r#"{"n_readings":1}"#.to_owned()));
    for _ in 0..2 {
        assert_eq!(post(&server, "room", FIRST).await, (200, r#"{"n_readings":2}"#.to_owned()));
    }
    let (status, refused) = post(&server, "room", "1000,0.1\n").await;
    assert!(status == 400 && refused.contains("line 1"), "{status} {refused}");
    assert_eq!(post(&server, "nobody", FIRST).await.0, 404);
    assert_eq!(get(&server, "nobody").await.0, 404);

    drop(client);
    let server = server.restart().await;
    let (status, text) = get(&server, "room").await;
    let (head, lines) = text.split_once('\n').unwrap();
    assert!(status == 200 && head.starts_with("#timestamp [ns],w_x"), "{status} {head}");
    assert_eq!(lines, format!("{FIRST}{SECOND}"), "in the order of their times, each once");
}
