use crate::world::*;
use futures_util::TryStreamExt;
use geometry::Line3;
use nalgebra::Vector3;
use slam::MapUpdate;
use slam::map::{LineId, LineLandmark, MapChanges, MapParts, RemovedKeyframe, SubmapId};
use store::{Bounds, LineQuery, Store, StoreError};

/// Takes a line out of the parts.
fn remove_line(parts: &mut MapParts, id: LineId) {
    parts.lines.retain(|line| line.id != id);
    for slot in parts.keyframes.iter_mut().flat_map(|keyframe| &mut keyframe.lines) {
        if *slot == Some(id) {
            *slot = None;
        }
    }
}

/// Takes keyframe 3 out of the parts, with everything it alone kept alive; what changed thereby.
fn remove_keyframe_3(parts: &mut MapParts) -> MapChanges {
    let pose_of = |id: u64| parts.keyframes[id as usize - 1].camera_from_world;
    let camera_from_anchor = pose_of(3) * pose_of(2).inverse();
    parts.removed_keyframes.push(RemovedKeyframe { id: kf(3), anchor: kf(2), camera_from_anchor });
    parts.keyframes.retain(|keyframe| keyframe.id != kf(3));
    parts.keyframes[2].parent = Some(kf(2));
    parts.points.iter_mut().for_each(|point| point.observations.retain(|seen| seen.keyframe != kf(3)));
    parts.lines.iter_mut().for_each(|line| line.observations.retain(|seen| seen.keyframe != kf(3)));
    for primitive in &mut parts.primitives {
        primitive.observations.retain(|seen| seen.keyframe != kf(3));
    }
    let mut changes = all_new(parts);
    changes.removed_keyframes.insert(kf(3));
    let points: Vec<_> =
        parts.points.iter().filter(|point| point.observations.len() < 2).map(|p| p.id).collect();
    for id in points {
        remove_point(parts, id);
        changes.points.remove(&id);
        changes.removed_points.insert(id);
    }
    let lines: Vec<_> = parts.lines.iter().filter(|line| line.observations.len() < 2).map(|l| l.id).collect();
    assert!(!lines.is_empty(), "some line should have hung on keyframe 3");
    for id in lines {
        remove_line(parts, id);
        changes.lines.remove(&id);
        changes.removed_lines.insert(id);
    }
    changes
}

async fn removed_lines_vanish_and_removed_key_frames_leave_lines_and_primitives_whole(home: Home) {
    let store = home.store_with_session().await;
    let mut world = structured(71, SMALL);
    store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();

    remove_line(&mut world, ln(4));
    let changes = MapChanges { removed_lines: [ln(4)].into(), ..MapChanges::default() };
    let changes = MapChanges { keyframes: all_new(&world).keyframes, ..changes };
    let update = MapUpdate { map: map(&world), changes, frames: vec![] };
    assert_eq!(store.save_update("s", &update, TRACKED, &[]).await.unwrap().counts.n_lines, 24);
    assert_same_parts(&load(&store).await, &world);
    assert_eq!(store.check().await.unwrap(), []);

    let changes = remove_keyframe_3(&mut world);
    let update = MapUpdate { map: map(&world), changes, frames: vec![] };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();
    assert_same_parts(&load(&store).await, &world);
    assert_eq!(store.check().await.unwrap(), []);
}

async fn only_lines_named_in_the_changes_are_written(home: Home) {
    let store = home.store_with_session().await;
    let before = structured(72, SMALL);
    store.save_update("s", &first_update(&before), TRACKED, &[]).await.unwrap();
    let mut after = before.clone();
    after.lines.iter_mut().for_each(|line| move_line(line, Vector3::new(0.5, -0.001, 4.0)));
    let changes = MapChanges { lines: [ln(5), ln(25)].into(), ..MapChanges::default() };
    store
        .save_update("s", &MapUpdate { map: map(&after), changes, frames: vec![] }, TRACKED, &[])
        .await
        .unwrap();
    let mut expected = before;
    for idx in [4, 24] {
        expected.lines[idx] = after.lines[idx].clone();
    }
    assert_same_parts(&load(&store).await, &expected);
    assert_eq!(store.check().await.unwrap(), []);
}

async fn a_line_that_went_before_it_was_stored_is_not_stored(home: Home) {
    let store = home.store_with_session().await;
    let world = parts(73, SMALL);
    let changes = MapChanges {
        lines: [ln(1)].into(),
        primitives: [pr(1)].into(),
        removed_lines: [ln(2)].into(),
        removed_primitives: [pr(2)].into(),
        ..all_new(&world)
    };
    let update = MapUpdate { map: map(&world), changes, frames: vec![] };
    let counts = store.save_update("s", &update, TRACKED, &[]).await.unwrap().counts;
    assert_eq!((counts.n_lines, counts.n_primitives), (0, 0));
    assert_same_parts(&load(&store).await, &world);
    assert_eq!(store.check().await.unwrap(), []);
}

async fn a_deleted_session_takes_its_lines_and_primitives_along(home: Home) {
    let store = home.store_with_session().await;
    store.create_session(&new_session("other")).await.unwrap();
    for id in ["s", "other"] {
        store.save_update(id, &first_update(&structured(74, SMALL)), TRACKED, &[]).await.unwrap();
    }
    let kept = store.digest("other").await.unwrap();
    store.delete_session("s").await.unwrap();
    assert_eq!(store.digest("other").await.unwrap(), kept);
    assert_eq!(store.check().await.unwrap(), []);
    for rows in [
        "SELECT count(*) FROM keyframe_vanishing WHERE session = 1",
        "SELECT count(*) FROM lines WHERE session = 1",
        "SELECT count(*) FROM primitives WHERE session = 1",
        "SELECT count(*) FROM line_cells WHERE session_min <= 1",
    ] {
        assert_eq!(number(&home, rows).await, 0, "{rows}");
    }
    let error = store.lines_page("s", &LineQuery::default(), None, 10).await.unwrap_err();
    assert!(matches!(error, StoreError::SessionNotFound { .. }));
}

/// A store with many lines of all lengths in its session, some of which have moved, beside another session.
async fn world_of_lines(home: &Home) -> (Store, MapParts) {
    let store = home.store_with_session().await;
    store.create_session(&new_session("other")).await.unwrap();
    store.save_update("other", &first_update(&structured(5, SMALL)), TRACKED, &[]).await.unwrap();
    let mut world = structured(75, Size { n_keyframes: 120, n_keypoints: 20, n_points: 50 });
    let mut numbers = Numbers(76);
    for id in N_LINES + 1..=500 {
        let mut line = line(&mut numbers, &mut world.keyframes, ln(id));
        let length = 5.0 * numbers.signed().abs().powi(3) + 1e-3;
        line.endpoints[1] = line.endpoints[0] + numbers.vector(length);
        line.line = Line3::from_points(&line.endpoints[0], &line.endpoints[1]).unwrap();
        line.submap = SubmapId((id % 2) as u32);
        world.lines.push(line);
    }
    world.last_ids.line = 500;
    store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();
    for line in &mut world.lines {
        let step = if line.id.get() % 3 == 0 { 2.0 } else { 0.02 };
        move_line(line, numbers.vector(step));
    }
    let lines = world.lines.iter().map(|line| line.id).collect();
    let changes = MapChanges { lines, ..MapChanges::default() };
    store
        .save_update("s", &MapUpdate { map: map(&world), changes, frames: vec![] }, TRACKED, &[])
        .await
        .unwrap();
    assert_eq!(store.check().await.unwrap(), []);
    (store, world)
}

/// Whether a query holds, by walking along the line in small steps: never wrong where it says yes, and where
/// the part that is inside is shorter than a step, `None`.
fn surely_holds(query: &LineQuery, line: &LineLandmark) -> Option<bool> {
    if line.observations.len() < query.min_observations as usize
        || query.submap.is_some_and(|submap| line.submap != submap)
        || query.primitive.is_some_and(|primitive| line.primitive != Some(primitive))
    {
        return Some(false);
    }
    let [start, end] = line.endpoints;
    let slack = (end - start).norm() / 1000.0;
    let mut answers = [query.bounds.is_none(), query.near.is_none()];
    let mut nearly = answers;
    for step in 0..=1000 {
        let place = start + (end - start) * (f64::from(step) / 1000.0);
        if let Some(Bounds { min, max }) = query.bounds {
            let depth = (place - min).inf(&(max - place)).min();
            answers[0] |= depth >= 0.0;
            nearly[0] |= depth >= -slack;
        }
        if let Some((center, radius)) = query.near {
            let depth = radius - (place - center).norm();
            answers[1] |= depth >= 0.0;
            nearly[1] |= depth >= -slack;
        }
    }
    match (answers == [true; 2], nearly == [true; 2]) {
        (true, _) => Some(true),
        (false, false) => Some(false),
        (false, true) => None,
    }
}

async fn paged(store: &Store, query: &LineQuery, page_size: u32) -> Vec<LineLandmark> {
    let (mut lines, mut after): (Vec<_>, Option<LineId>) = (Vec::new(), None);
    loop {
        let page = store.lines_page("s", query, after, page_size).await.unwrap();
        assert!(page.items.len() <= page_size as usize);
        lines.extend(page.items);
        after = page.next;
        if after.is_none() {
            return lines;
        }
    }
}

async fn spatial_queries_find_the_lines_that_walking_along_each_finds(home: Home) {
    let (store, world) = world_of_lines(&home).await;
    let mut numbers = Numbers(77);
    let (mut n_found, mut n_unsure) = (0, 0);
    for round in 0..40 {
        let corner = numbers.vector(5.0);
        let size = numbers.vector(4.0).abs();
        let query = LineQuery {
            bounds: (round % 4 != 0).then_some(Bounds { min: corner, max: corner + size }),
            near: (round % 3 == 0).then(|| (numbers.vector(4.0), 3.0 * numbers.signed().abs())),
            min_observations: (round % 5) as u32,
            submap: (round % 7 == 6).then_some(SubmapId(1)),
            primitive: (round % 5 == 3).then_some(pr(2)),
        };
        let found = store.lines("s", query).await.unwrap().try_collect::<Vec<_>>().await.unwrap();
        assert_eq!(paged(&store, &query, 16).await, found, "{query:?}");
        let mut rest = found.iter().peekable();
        for line in &world.lines {
            let is_found = rest.next_if(|found| *found == line).is_some();
            match surely_holds(&query, line) {
                Some(expected) => assert_eq!(is_found, expected, "{query:?} {line:?}"),
                None => n_unsure += 1,
            }
        }
        assert!(rest.next().is_none(), "lines that are not there, or out of order");
        n_found += found.len();
    }
    assert!(n_found > 400 && n_unsure < n_found / 10, "{n_found} found, {n_unsure} too close to say");
}

async fn a_query_without_conditions_gives_every_line_and_nonsense_none(home: Home) {
    let (store, world) = world_of_lines(&home).await;
    assert_eq!(paged(&store, &LineQuery::default(), 200).await, world.lines);
    assert_eq!(paged(&store, &LineQuery::default(), 500).await, world.lines);
    let everywhere = Bounds { min: Vector3::repeat(f64::NEG_INFINITY), max: Vector3::repeat(f64::INFINITY) };
    let query = LineQuery { bounds: Some(everywhere), ..LineQuery::default() };
    assert_eq!(paged(&store, &query, 499).await, world.lines);

    let end = world.lines[17].endpoints[1];
    let exact = LineQuery { bounds: Some(Bounds { min: end, max: end }), ..LineQuery::default() };
    assert_eq!(paged(&store, &exact, 9).await, [world.lines[17].clone()]);
    let nan = Vector3::repeat(f64::NAN);
    for query in [
        LineQuery { bounds: Some(Bounds { min: nan, max: nan }), ..LineQuery::default() },
        LineQuery { near: Some((nan, 1.0)), ..LineQuery::default() },
        LineQuery { near: Some((end, -1.0)), ..LineQuery::default() },
        LineQuery { bounds: Some(Bounds { min: end, max: end - Vector3::x() }), ..LineQuery::default() },
    ] {
        assert_eq!(paged(&store, &query, 10).await, [], "{query:?}");
    }
}

on_either_engine! {
    removed_lines_vanish_and_removed_key_frames_leave_lines_and_primitives_whole,
    only_lines_named_in_the_changes_are_written,
    a_line_that_went_before_it_was_stored_is_not_stored,
    a_deleted_session_takes_its_lines_and_primitives_along,
    spatial_queries_find_the_lines_that_walking_along_each_finds,
    a_query_without_conditions_gives_every_line_and_nonsense_none,
}
