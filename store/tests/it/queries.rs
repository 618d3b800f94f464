use crate::world::*;
use futures_util::TryStreamExt;
use nalgebra::Vector3;
use slam::MapUpdate;
use slam::map::{MapChanges, MapParts, PointId, PointLandmark, SubmapId};
use store::{Bounds, KeyframeImage, PlacedPoint, PointQuery, Store};

const LARGE: Size = Size { n_keyframes: 30, n_keypoints: 300, n_points: 1500 };

/// A store whose points have moved after they were first saved, some little and some far, beside another
/// session.
async fn moved_world(home: &Home) -> (Store, MapParts) {
    let store = home.store_with_session().await;
    store.create_session(&new_session("other")).await.unwrap();
    store.save_update("other", &first_update(&parts(5, SMALL)), TRACKED, &[]).await.unwrap();
    let mut world = parts(21, LARGE);
    store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();
    let mut numbers = Numbers(22);
    for point in &mut world.points {
        let step = if point.id.get() % 3 == 0 { 2.0 } else { 0.02 };
        point.position += numbers.vector(step);
        point.submap = SubmapId((point.id.get() % 2) as u32);
    }
    let points = world.points.iter().map(|point| point.id).collect();
    let changes = MapChanges { points, ..MapChanges::default() };
    store
        .save_update("s", &MapUpdate { map: map(&world), changes, frames: vec![] }, TRACKED, &[])
        .await
        .unwrap();
    assert_eq!(store.check().await.unwrap(), []);
    (store, world)
}

fn holds(query: &PointQuery, point: &PointLandmark) -> bool {
    let p = point.position;
    query
        .bounds
        .is_none_or(|bounds| (0..3).all(|axis| p[axis] >= bounds.min[axis] && p[axis] <= bounds.max[axis]))
        && query
            .near
            .is_none_or(|(center, radius)| (p - center).norm_squared() <= radius * radius && radius >= 0.0)
        && point.observations.len() >= query.min_observations as usize
        && query.submap.is_none_or(|submap| point.submap == submap)
}

/// Whole points; where they are alone must be the same.
async fn streamed(store: &Store, query: PointQuery) -> Vec<PointLandmark> {
    let points: Vec<PointLandmark> = store.points("s", query).await.unwrap().try_collect().await.unwrap();
    let placed: Vec<PlacedPoint> =
        store.placed_points("s", query).await.unwrap().try_collect().await.unwrap();
    let place = |point: &PointLandmark| PlacedPoint {
        id: point.id,
        submap: point.submap,
        position: point.position,
        n_observations: point.observations.len() as u32,
    };
    assert_eq!(placed, points.iter().map(place).collect::<Vec<_>>());
    points
}

async fn paged(store: &Store, query: &PointQuery, page_size: u32) -> Vec<PointLandmark> {
    let (mut points, mut after): (Vec<_>, Option<PointId>) = (Vec::new(), None);
    loop {
        let page = store.points_page("s", query, after, page_size).await.unwrap();
        assert!(page.items.len() <= page_size as usize);
        points.extend(page.items);
        after = page.next;
        if after.is_none() {
            return points;
        }
    }
}

async fn spatial_queries_find_what_looking_at_every_point_finds(home: Home) {
    let (store, world) = moved_world(&home).await;
    let mut numbers = Numbers(23);
    let mut n_found = 0;
    for round in 0..40 {
        let corner = numbers.vector(5.0);
        let size = numbers.vector(4.0).abs();
        let query = PointQuery {
            bounds: (round % 4 != 0).then_some(Bounds { min: corner, max: corner + size }),
            near: (round % 3 == 0).then(|| (numbers.vector(4.0), 3.0 * numbers.signed().abs())),
            min_observations: (round % 5) as u32,
            submap: (round % 7 == 6).then_some(SubmapId(1)),
        };
        let expected: Vec<_> = world.points.iter().filter(|point| holds(&query, point)).cloned().collect();
        n_found += expected.len();
        assert_eq!(streamed(&store, query).await, expected, "{query:?}");
        assert_eq!(paged(&store, &query, 64).await, expected, "{query:?}");
    }
    assert!(n_found > 1000, "the queries found only {n_found} points");
}

async fn a_query_without_conditions_gives_every_point(home: Home) {
    let (store, world) = moved_world(&home).await;
    assert_eq!(streamed(&store, PointQuery::default()).await, world.points);
    assert_eq!(paged(&store, &PointQuery::default(), 700).await, world.points);
    assert_eq!(paged(&store, &PointQuery::default(), 1500).await, world.points);
}

async fn points_on_the_faces_of_a_box_are_in_it_and_nonsense_finds_nothing(home: Home) {
    let (store, world) = moved_world(&home).await;
    let place = world.points[17].position;
    let exact = PointQuery { bounds: Some(Bounds { min: place, max: place }), ..PointQuery::default() };
    assert_eq!(streamed(&store, exact).await, [world.points[17].clone()]);
    let at = PointQuery { near: Some((place, 0.0)), ..PointQuery::default() };
    assert_eq!(paged(&store, &at, 10).await, [world.points[17].clone()]);

    let nan = Vector3::repeat(f64::NAN);
    for query in [
        PointQuery { bounds: Some(Bounds { min: nan, max: nan }), ..PointQuery::default() },
        PointQuery { near: Some((nan, 1.0)), ..PointQuery::default() },
        PointQuery { near: Some((place, -1.0)), ..PointQuery::default() },
        PointQuery {
            bounds: Some(Bounds { min: place, max: place - Vector3::x() }),
            ..PointQuery::default()
        },
    ] {
        assert_eq!(streamed(&store, query).await, [], "{query:?}");
        assert_eq!(paged(&store, &query, 10).await, [], "{query:?}");
    }
    let everywhere = Bounds { min: Vector3::repeat(f64::NEG_INFINITY), max: Vector3::repeat(f64::INFINITY) };
    let query = PointQuery { bounds: Some(everywhere), ..PointQuery::default() };
    assert_eq!(streamed(&store, query).await, world.points);
}

async fn key_frames_come_in_pages_and_alone(home: Home) {
    let store = home.store_with_session().await;
    let world = parts(24, SMALL);
    let image = KeyframeImage { keyframe: kf(2), media_type: "image/jpeg".into(), bytes: vec![9; 30_000] };
    let unknown = KeyframeImage { keyframe: kf(77), ..image.clone() };
    store.save_update("s", &first_update(&world), TRACKED, &[image.clone(), unknown]).await.unwrap();

    let first = store.keyframes("s", None, 4).await.unwrap();
    let second = store.keyframes("s", first.next, 4).await.unwrap();
    assert_eq!((first.items.len(), second.items.len(), second.next), (4, 2, None));
    for (record, keyframe) in first.items.iter().chain(&second.items).zip(&world.keyframes) {
        assert_eq!(
            (record.id, record.submap, record.sequence),
            (keyframe.id, keyframe.submap, keyframe.sequence)
        );
        assert_eq!((record.timestamp_ns, record.parent), (keyframe.timestamp_ns, keyframe.parent));
        assert_eq!(record.camera_from_world, keyframe.camera_from_world);
        assert_eq!((record.n_keypoints as usize, record.n_points as usize), (80, keyframe.n_points()));
        assert_eq!(record.has_image, record.id == kf(2));
        assert_eq!(store.keyframe("s", record.id).await.unwrap().as_ref(), Some(record));
    }
    let stored = store.keyframe_image("s", kf(2)).await.unwrap().unwrap();
    assert_eq!((stored.media_type, stored.bytes), (image.media_type, image.bytes));
    assert_eq!(store.keyframe_image("s", kf(1)).await.unwrap(), None);
    assert_eq!(store.keyframe("s", kf(77)).await.unwrap(), None);
}

on_either_engine! {
    spatial_queries_find_what_looking_at_every_point_finds,
    a_query_without_conditions_gives_every_point,
    points_on_the_faces_of_a_box_are_in_it_and_nonsense_finds_nothing,
    key_frames_come_in_pages_and_alone,
}
