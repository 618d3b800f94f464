use crate::world::*;
use slam::MapUpdate;
use slam::map::{MapChanges, SubmapId};

async fn primitives_come_alone_and_in_pages_with_their_lines_counted(home: Home) {
    let store = home.store_with_session().await;
    let mut world = structured(81, SMALL);
    world.primitives[1].submap = SubmapId(5);
    store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();

    let first = store.primitives_page("s", None, None, 3).await.unwrap();
    let second = store.primitives_page("s", None, first.next, 3).await.unwrap();
    assert_eq!((first.items.len(), second.items.len(), second.next), (3, 1, None));
    for (record, primitive) in first.items.iter().chain(&second.items).zip(&world.primitives) {
        assert_eq!(record.primitive, *primitive);
        let n_lines = world.lines.iter().filter(|line| line.primitive == Some(primitive.id)).count();
        assert_eq!(record.n_lines, n_lines as u64);
        assert_eq!(store.primitive("s", primitive.id).await.unwrap().as_ref(), Some(record));
    }
    assert!(first.items[0].n_lines > 0 && !first.items[0].primitive.observations.is_empty());
    let of_submap = store.primitives_page("s", Some(SubmapId(5)), None, 10).await.unwrap();
    assert_eq!(of_submap.items, [first.items[1].clone()]);
    assert_eq!(store.primitive("s", pr(9)).await.unwrap(), None);
}

async fn joined_and_removed_primitives_are_stored_as_the_map_has_them(home: Home) {
    let store = home.store_with_session().await;
    let mut world = structured(82, SMALL);
    store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();

    // Primitive 2 turns out to be primitive 1 where keyframes see it alone, and is forgotten elsewhere.
    let gone = world.primitives.remove(1);
    let kept = &mut world.primitives[0];
    for seen in gone.observations {
        let keyframe = &mut world.keyframes[seen.keyframe.get() as usize - 1];
        let slot = &mut keyframe.vanishing[seen.vanishing_idx as usize].primitive;
        *slot = kept.observation_in(seen.keyframe).is_none().then_some(kept.id);
        if slot.is_some() {
            kept.observations.push(seen);
            kept.observations.sort_unstable();
        }
    }
    world
        .lines
        .iter_mut()
        .filter(|line| line.primitive == Some(pr(2)))
        .for_each(|line| line.primitive = None);
    // A keyframe's vanishing points were found anew.
    world.keyframes[5].vanishing.iter().filter_map(|seen| seen.primitive).for_each(|id| {
        let primitive = world.primitives.iter_mut().find(|primitive| primitive.id == id).unwrap();
        primitive.observations.retain(|seen| seen.keyframe != kf(6));
    });
    world.keyframes[5].vanishing.clear();

    let changes = MapChanges {
        keyframes: [kf(6)].into(),
        lines: all_new(&world).lines,
        primitives: all_new(&world).primitives,
        removed_primitives: [pr(2)].into(),
        ..MapChanges::default()
    };
    let update = MapUpdate { map: map(&world), changes, frames: vec![] };
    assert_eq!(store.save_update("s", &update, TRACKED, &[]).await.unwrap().counts.n_primitives, 3);
    assert_same_parts(&load(&store).await, &world);
    assert_eq!(store.check().await.unwrap(), []);
}

on_either_engine! {
    primitives_come_alone_and_in_pages_with_their_lines_counted,
    joined_and_removed_primitives_are_stored_as_the_map_has_them,
}
