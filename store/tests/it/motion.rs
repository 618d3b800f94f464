//! Readings of motion sensors.

use crate::world::*;
use store::{MotionReading, StoreError};

fn reading(timestamp_ns: i64) -> MotionReading {
    MotionReading { timestamp_ns, angular_velocity: [0.1, 0.2, 0.3], acceleration: [0.0, -9.8, 0.5] }
}

async fn motion_is_kept_once_in_the_order_of_its_times_and_goes_with_its_session(home: Home) {
    let store = home.store_with_session().await;
    let batches = [vec![reading(2_000), reading(2_500)], vec![reading(-5), reading(1_000)]];
    for batch in batches.iter().chain(&batches[..1]) {
        store.add_motion("s", batch).await.unwrap();
    }
    store.add_motion("s", &[]).await.unwrap();
    let (first_ns, early) = store.motion_after("s", None).await.unwrap().expect("the first");
    assert_eq!((first_ns, &early), (-5, &batches[1]));
    let (first_ns, late) = store.motion_after("s", Some(first_ns)).await.unwrap().expect("the second");
    assert_eq!((first_ns, &late), (2_000, &batches[0]));
    assert_eq!(store.motion_after("s", Some(first_ns)).await.unwrap(), None);
    assert!(store.stored_bytes_of("").await.unwrap() >= 4 * 32);
    let missing = store.add_motion("nobody", &batches[0]).await.unwrap_err();
    assert!(matches!(missing, StoreError::SessionNotFound { .. }), "{missing}");
    store.delete_session("s").await.unwrap();
    assert_eq!(number(&home, "SELECT count(*) FROM motion").await, 0);
}

on_either_engine!(motion_is_kept_once_in_the_order_of_its_times_and_goes_with_its_session);
