//! Scale from what was measured, and images of other cameras in one of several maps.

use crate::maps::{N_FRAMES, mapped_room, stream_frames};
use proto::v1;
use proto::v1::reference_position::Frame;
use proto::v1::scale_place::Place;
use proto::v1::set_scale_request::Reference;
use serde_json::{Value, json};
use tests::{Client, FrameStream, SmallWorld, TestServer, create_session, open_message};
use tonic::Code;

fn at(place: Place) -> Option<v1::ScalePlace> {
    Some(v1::ScalePlace { place: Some(place) })
}

fn scale_by(reference: Reference) -> v1::SetScaleRequest {
    v1::SetScaleRequest { session_id: "room".into(), metres_per_unit: None, reference: Some(reference) }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_known_distance_between_points_keyframes_or_pixels_gives_the_scale() {
    let (server, mut client) = mapped_room().await;
    let points = server.get_json("/v1/sessions/room/points?page_size=1000&min_observations=3").await;
    let points = points["points"].as_array().unwrap();
    let position = |value: &Value| [0, 1, 2].map(|axis| value[axis].as_f64().unwrap());
    let distance =
        |a: [f64; 3], b: [f64; 3]| (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
    let (first, last) = (&points[0], &points[points.len() - 1]);
    let between = distance(position(&first["position"]), position(&last["position"]));
    let known = v1::KnownDistance {
        from: at(Place::PointId(first["id"].as_u64().unwrap())),
        to: at(Place::PointId(last["id"].as_u64().unwrap())),
        metres: 3.0,
    };
    let session = client.set_scale(scale_by(Reference::Distance(known))).await.unwrap().into_inner();
    let metres = session.metres_per_unit.unwrap();
    assert!((metres * between - 3.0).abs() < 1e-9, "{metres} {between}");
    let measured = session.scale_measurement.unwrap();
    assert!((measured.map_distance.unwrap() - between).abs() < 1e-9 && measured.places.len() == 2);

    // The same two points by the pixels of a keyframe that shows them, over HTTP.
    let keyframes = server.get_json("/v1/sessions/room/keyframes").await;
    let keyframe = keyframes["keyframes"][2]["id"].as_u64().unwrap();
    let observed = server.get_json(&format!("/v1/sessions/room/keyframes/{keyframe}/observed")).await;
    let seen: Vec<(u64, [f64; 2])> = observed["point_ids"]
        .as_array()
        .unwrap()
        .iter()
        .zip(observed["keypoints"].as_array().unwrap())
        .filter_map(|(id, place)| Some((id.as_u64()?, [0, 1].map(|axis| place[axis].as_f64().unwrap()))))
        .collect();
    let factor = 480.0 / observed["width"].as_f64().unwrap();
    let pixel = |(_, place): &(u64, [f64; 2])| place.map(|length| (length + 0.5) * factor - 0.5);
    let (left, right) = (&seen[0], &seen[seen.len() - 1]);
    let body = json!({"distance": {
        "from": {"keyframe_id": keyframe, "pixel": pixel(left)},
        "to": {"keyframe_id": keyframe, "pixel": pixel(right)},
        "metres": 2.0,
    }});
    let url = format!("http://{}/v1/sessions/room/scale", server.running().http_addr);
    let post = async |body: &Value| reqwest::Client::new().post(&url).json(body).send().await.unwrap();
    let answer: Value = post(&body).await.json().await.unwrap();
    assert!(answer["scale_measurement"]["map_distance"].as_f64().unwrap() > 0.0, "{answer}");
    let metres = answer["metres_per_unit"].as_f64().unwrap();
    let told = answer["scale_measurement"]["map_distance"].as_f64().unwrap() * metres;
    assert!((told - 2.0).abs() < 1e-9, "{answer}");

    let (one, other) = (&keyframes["keyframes"][0]["id"], &keyframes["keyframes"][3]["id"]);
    let by_keyframes =
        json!({"distance": {"from": {"keyframe_id": one}, "to": {"keyframe_id": other}, "metres": 1.0}});
    assert_eq!(post(&by_keyframes).await.status(), 200);
    let frames = server.get_json("/v1/sessions/room/keyframes").await;
    let place = |idx: usize| {
        let pose = &frames["keyframes"][idx]["world_from_camera"];
        ["tx", "ty", "tz"].map(|axis| pose[axis].as_f64().unwrap())
    };
    assert!((distance(place(0), place(3)) - 1.0).abs() < 1e-9, "lengths are metres now");

    for (wrong, status) in [
        (json!({"distance": {"from": {"point_id": 999_999}, "to": {"point_id": 1}, "metres": 1.0}}), 400),
        (json!({"distance": {"from": {"keyframe_id": one}, "to": {"keyframe_id": one}, "metres": 1.0}}), 422),
        (
            json!({"distance": {"from": {"keyframe_id": one}, "to": {"keyframe_id": other}, "metres": -1.0}}),
            400,
        ),
        (json!({"distance": {"from": {}, "to": {"keyframe_id": other}, "metres": 1.0}}), 400),
        (json!({"positions": {"rows": []}}), 422),
        (json!({"metres_per_unit": 1.0, "positions": {"rows": []}}), 400),
    ] {
        let answer = post(&wrong).await;
        assert_eq!(answer.status(), status, "{wrong}: {}", answer.text().await.unwrap());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn positions_of_the_camera_give_the_scale_and_wrong_ones_are_named() {
    let world = SmallWorld::new(1);
    let (server, mut client) = mapped_room().await;
    let trajectory = server.get_json("/v1/sessions/room/trajectory?format=json").await;
    let placed: Vec<u64> = trajectory["poses"]
        .as_array()
        .unwrap()
        .iter()
        .map(|pose| pose["sequence"].as_u64().unwrap())
        .collect();
    let wrong = placed[placed.len() / 2];
    let row = |sequence: u64| {
        let [x, y, z] = world.camera_position(sequence as usize);
        let y = if sequence == wrong { y + 5.0 } else { y };
        let position = Some(v1::Vector3 { x, y, z });
        v1::ReferencePosition { frame: Some(Frame::Sequence(sequence)), position }
    };
    let mut rows: Vec<_> = placed.iter().map(|sequence| row(*sequence)).collect();
    rows.push(v1::ReferencePosition { frame: Some(Frame::Sequence(100_000)), ..row(0) });
    let positions = v1::ReferencePositions { rows, max_error_m: None };
    let session = client.set_scale(scale_by(Reference::Positions(positions))).await.unwrap().into_inner();
    let measured = session.scale_measurement.unwrap();
    assert!(measured.rms_m.unwrap() < 0.05, "{measured:?}");
    let unused: Vec<usize> =
        (0..measured.residuals.len()).filter(|idx| !measured.residuals[*idx].used).collect();
    let wrong_idx = placed.iter().position(|sequence| *sequence == wrong).unwrap();
    assert!(unused.contains(&wrong_idx) && unused.contains(&placed.len()), "{unused:?}");
    assert!(unused.len() < placed.len() / 4, "{unused:?}");
    assert!(measured.residuals[placed.len()].error_m.is_none());
    assert!(measured.residuals[wrong_idx].error_m.unwrap() > 4.0);

    // The way from the first to the last frame is as long as in the world.
    let metric = server.get_json("/v1/sessions/room/trajectory?format=json").await;
    let poses = metric["poses"].as_array().unwrap();
    let place =
        |pose: &Value| ["tx", "ty", "tz"].map(|axis| pose["world_from_camera"][axis].as_f64().unwrap());
    let distance =
        |a: [f64; 3], b: [f64; 3]| (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
    let estimated = distance(place(&poses[0]), place(&poses[poses.len() - 1]));
    let [first, last] = [placed[0], placed[placed.len() - 1]].map(|idx| world.camera_position(idx as usize));
    let expected = distance(first, last);
    assert!((estimated / expected - 1.0).abs() < 0.05, "{estimated} instead of {expected}");
}

async fn located(client: &mut Client, request: v1::LocalizeRequest) -> v1::LocalizeResponse {
    client.localize(request).await.unwrap().into_inner()
}

/// An image at half its size.
fn halved(pixels: &[u8], width: usize, height: usize) -> Vec<u8> {
    let at = |x: usize, y: usize| u32::from(pixels[y * width + x]);
    let mean = |x: usize, y: usize| (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1) + 2) / 4;
    (0..height / 2)
        .flat_map(|y| (0..width / 2).map(move |x| (2 * x, 2 * y)))
        .map(|(x, y)| mean(x, y) as u8)
        .collect()
}

/// The right two thirds of an image.
fn cropped(pixels: &[u8], width: usize) -> Vec<u8> {
    pixels.chunks(width).flat_map(|row| row[width / 3..].to_vec()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn images_of_other_cameras_are_located_where_the_maps_own_are() {
    let world = SmallWorld::new(1);
    let (_server, mut client) = mapped_room().await;
    let i = N_FRAMES - 10;
    let pixels = world.pixels(i);
    let session_id = || "room".to_owned();
    let own =
        v1::LocalizeRequest { session_id: session_id(), image: world.frame(i).image, ..Default::default() };
    let own = located(&mut client, own).await;
    let place = |answer: &v1::LocalizeResponse| {
        let pose = answer.pose_world_from_camera.unwrap_or_else(|| panic!("{answer:?}"));
        geometry::nalgebra::Vector3::new(pose.tx, pose.ty, pose.tz)
    };
    assert_eq!(own.covariance.len(), 36);
    let sigma = (0..3).map(|axis| own.covariance[axis * 7].sqrt()).fold(0.0, f64::max);
    assert!(sigma > 0.0 && sigma < 0.1, "{sigma}");
    let small = tests::raw_gray(240, 180, &halved(&pixels, 480, 360));
    let part = tests::raw_gray(320, 360, &cropped(&pixels, 480));
    let whole = world.frame(i).image.unwrap();
    let camera = |width: u32, height: u32, focal: f64, cx: f64, cy: f64| v1::Camera {
        width,
        height,
        fx: focal,
        fy: focal,
        cx,
        cy,
        ..world.camera()
    };
    let fov_deg = 2.0 * (240.0_f64 / 345.0).atan().to_degrees();
    let request = |image: &v1::Image| v1::LocalizeRequest {
        session_id: session_id(),
        image: Some(image.clone()),
        ..Default::default()
    };
    let given = |image: &v1::Image, camera| v1::LocalizeRequest { camera: Some(camera), ..request(image) };
    let near = own.pose_world_from_camera.map(|pose| v1::Vector3 { x: pose.tx, y: pose.ty, z: pose.tz });
    for (what, request) in [
        ("half", given(&small, camera(240, 180, 172.5, 119.5, 89.5))),
        ("half, unsaid", request(&small)),
        ("part", given(&part, camera(320, 360, 345.0, 79.5, 179.5))),
        ("field of view", v1::LocalizeRequest { fov_deg: Some(fov_deg), ..request(&whole) }),
        ("unknown", v1::LocalizeRequest { unknown_camera: true, ..request(&whole) }),
        ("near", v1::LocalizeRequest { near, radius: Some(0.5), ..request(&whole) }),
    ] {
        let answer = located(&mut client, request).await;
        let error = (place(&answer) - place(&own)).norm();
        assert!(error < 0.05, "{what}: {error} off, {answer:?}");
        assert_eq!(answer.session_id, "room");
        let found = answer.camera.unwrap();
        let expected = f64::from(found.width) / if what == "part" { 320.0 / 345.0 } else { 480.0 / 345.0 };
        assert!((found.fx / expected - 1.0).abs() < 0.03, "{what}: {found:?}");
    }
    // Where it is not, it is not found; what contradicts itself is refused.
    let far = v1::Vector3 { x: 1e3, y: 0.0, z: 0.0 };
    let nowhere = v1::LocalizeRequest { near: Some(far), radius: Some(1.0), ..request(&whole) };
    assert!(located(&mut client, nowhere).await.pose_world_from_camera.is_none());
    for wrong in [
        given(&small, camera(480, 360, 345.0, 239.5, 179.5)),
        v1::LocalizeRequest { fov_deg: Some(300.0), ..request(&whole) },
        v1::LocalizeRequest { fov_deg: Some(70.0), unknown_camera: true, ..request(&whole) },
        v1::LocalizeRequest { radius: Some(1.0), ..request(&whole) },
        v1::LocalizeRequest { session_ids: vec!["room".into()], ..request(&whole) },
    ] {
        assert_eq!(client.localize(wrong).await.unwrap_err().code(), Code::InvalidArgument);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn of_several_maps_the_one_that_shows_the_place_answers() {
    let worlds = [SmallWorld::new(1), SmallWorld::new(3)];
    let (server, mut client) = mapped_room().await;
    create_session(&mut client, "other", worlds[1].camera()).await.unwrap();
    let stream = FrameStream::open(&mut client, open_message("other")).await.unwrap();
    stream_frames(stream, &worlds[1], 0..40).await;
    create_session(&mut client, "empty", worlds[1].camera()).await.unwrap();
    for (world, name, i) in [(&worlds[0], "room", 40), (&worlds[1], "other", 30)] {
        let image = world.frame(i).image;
        let all = v1::LocalizeRequest { all_sessions: true, image: image.clone(), ..Default::default() };
        let answer = located(&mut client, all).await;
        assert_eq!((&answer.session_id[..], answer.n_sessions_searched), (name, 3), "{answer:?}");
        assert!(answer.pose_world_from_camera.is_some() && answer.n_sessions_tried <= 2);
        let session_ids = vec!["room".into(), "other".into()];
        let named = v1::LocalizeRequest { session_ids, image, ..Default::default() };
        assert_eq!(located(&mut client, named).await.session_id, name);
    }
    let url = format!("http://{}/v1/localize?sessions=room,other", server.running().http_addr);
    let png = tests::png(480, 360, &worlds[1].pixels(30)).data;
    let answer: Value =
        reqwest::Client::new().post(url).body(png).send().await.unwrap().json().await.unwrap();
    assert_eq!(answer["session_id"], "other", "{answer}");
    assert_eq!(answer["covariance"].as_array().unwrap().len(), 36);
    let gray = v1::LocalizeRequest {
        all_sessions: true,
        image: Some(tests::raw_gray(480, 360, &[90; 480 * 360])),
        ..Default::default()
    };
    let nowhere = located(&mut client, gray).await;
    assert_eq!((nowhere.state(), &nowhere.session_id[..]), (v1::TrackingState::Lost, ""));
    let none = v1::LocalizeRequest { session_ids: vec!["nowhere".into()], ..Default::default() };
    assert_eq!(client.localize(none).await.unwrap_err().code(), Code::InvalidArgument, "there is no image");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_trajectory_tells_what_it_leaves_out() {
    let (server, mut client) = mapped_room().await;
    let ask = async |client: &mut Client, submap_id, submaps: v1::SubmapSelection| {
        let request = v1::GetTrajectoryRequest {
            session_id: "room".into(),
            submap_id,
            submaps: submaps.into(),
            ..Default::default()
        };
        let first = client.get_trajectory(request).await?.into_inner().message().await?;
        Ok::<_, tonic::Status>(first.map_or((0, 0), |first| (first.poses.len(), first.n_poses_left_out)))
    };
    let unspecified = v1::SubmapSelection::Unspecified;
    let all = ask(&mut client, None, v1::SubmapSelection::All).await.unwrap();
    let largest = ask(&mut client, None, v1::SubmapSelection::Largest).await.unwrap();
    assert_eq!((all, largest.1), (largest, 0), "there is one submap");
    assert_eq!(ask(&mut client, Some(0), unspecified).await.unwrap(), all);
    let both = ask(&mut client, Some(0), v1::SubmapSelection::Largest).await.unwrap_err();
    assert_eq!(both.code(), Code::InvalidArgument);
    let get = async |server: &TestServer, submap: &str| {
        let url =
            format!("http://{}/v1/sessions/room/trajectory?submap={submap}", server.running().http_addr);
        let answer = reqwest::get(url).await.unwrap();
        let left_out = answer.headers().get("x-monoslam-poses-left-out").cloned();
        (answer.status().as_u16(), left_out.map(|value| value.to_str().unwrap().to_owned()))
    };
    for submap in ["all", "largest", "0"] {
        assert_eq!(get(&server, submap).await, (200, Some("0".to_owned())), "{submap}");
    }
    assert_eq!(get(&server, "7").await, (200, Some(all.0.to_string())), "all poses are elsewhere");
    assert_eq!(get(&server, "some").await.0, 400);
}
