use crate::world::*;
use store::{KeyframeImage, NewToken, StoreError, TokenQuotas, TokenRole};

fn token(name: &str, role: TokenRole, owner: Option<&str>) -> NewToken {
    let mut hash = [0; store::TOKEN_HASH_BYTES];
    hash[..name.len()].copy_from_slice(name.as_bytes());
    let quotas = TokenQuotas { max_sessions: Some(3), max_frames_per_s: Some(7.5), ..TokenQuotas::default() };
    let (name, owner) = (name.to_owned(), owner.map(str::to_owned));
    NewToken { name, hash, role, owner, created_at_ns: 5, expires_at_ns: Some(9), quotas }
}

async fn tokens_come_back_as_they_were_made_and_stay_when_revoked(home: Home) {
    let store = home.open().await;
    let robot = token("robot", TokenRole::Writer, Some("lab"));
    let boss = token("boss", TokenRole::Admin, None);
    store.create_token(&robot).await.unwrap();
    // By another program, while the database is in use.
    let beside = home.open().await;
    beside.create_token(&boss).await.unwrap();
    let kept: Vec<_> = store.tokens().await.unwrap().into_iter().map(|kept| kept.token).collect();
    assert_eq!(kept, [robot.clone(), boss]);

    assert!(beside.revoke_token("robot", 77).await.unwrap());
    assert!(!beside.revoke_token("robot", 99).await.unwrap(), "it was revoked before");
    assert_eq!(store.tokens().await.unwrap()[0].revoked_at_ns, Some(77));
    assert!(matches!(store.create_token(&robot).await, Err(StoreError::TokenExists { .. })));
    let unknown = store.revoke_token("nobody", 1).await.unwrap_err();
    assert_eq!(unknown.to_string(), r#"there is no token "nobody""#);
}

async fn an_owners_sessions_are_listed_counted_and_measured_alone(home: Home) {
    let store = home.store_with_session().await;
    for id in ["a~x", "a~y", "ab~x", "a", "b~s"] {
        store.create_session(&new_session(id)).await.unwrap();
    }
    let page = store.list_sessions_of("a~", None, 1).await.unwrap();
    assert_eq!((page.items[0].id.as_str(), page.next.as_deref()), ("a~x", Some("a~x")));
    let page = store.list_sessions_of("a~", page.next.as_deref(), 1).await.unwrap();
    assert_eq!((page.items[0].id.as_str(), page.next), ("a~y", None));
    assert_eq!(store.count_sessions_of("a~").await.unwrap(), 2);
    assert_eq!(store.count_sessions_of("").await.unwrap(), 6);

    let image = KeyframeImage { keyframe: kf(1), media_type: "image/png".into(), bytes: vec![0; 1000] };
    let update = first_update(&structured(51, SMALL));
    store.save_update("b~s", &update, TRACKED, &[image]).await.unwrap();
    assert!(store.stored_bytes_of("b~").await.unwrap() > 1000);
    assert_eq!(store.stored_bytes_of("a~").await.unwrap(), 0);
}

on_either_engine! {
    tokens_come_back_as_they_were_made_and_stay_when_revoked,
    an_owners_sessions_are_listed_counted_and_measured_alone,
}
