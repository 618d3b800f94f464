//! What is PostgreSQL's own: the index of places, servers that stop, several programs on one database.

use crate::world::*;
use nalgebra::Vector3;
use std::time::Duration;
use store::{
    Bounds, Copied, Holder, KeyframeImage, LineQuery, Load, MotionReading, Owner, PointQuery, ServerRecord,
    SessionChanges, Store, StoreError, StoreOptions,
};
use testkit::postgres::{Cluster, shared_database};

mod postgres {
    use super::*;

    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn places_are_found_by_the_index() {
        let home = Home::postgres();
        let store = home.store_with_session().await;
        let large = Size { n_keyframes: 60, n_keypoints: 1200, n_points: 12_000 };
        let world = parts(1, large);
        store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();
        let Home::Postgres(url) = &home else { unreachable!("it was made so") };
        let beside = sqlx::PgPool::connect(url).await.unwrap();
        sqlx::query("ANALYZE").execute(&beside).await.unwrap();

        let center = world.points[0].position;
        let bounds = Bounds { min: center - Vector3::repeat(0.05), max: center + Vector3::repeat(0.05) };
        let query = PointQuery { bounds: Some(bounds), ..PointQuery::default() };
        let found = store.points_page("s", &query, None, 100).await.unwrap().items;
        assert!(found.iter().any(|point| point.id == world.points[0].id));
        let lines = LineQuery { bounds: Some(bounds), ..LineQuery::default() };
        store.lines_page("s", &lines, None, 100).await.unwrap();

        // The condition as the store writes it.
        let plan: Vec<String> = sqlx::query_scalar(
            "EXPLAIN SELECT key FROM point_cells WHERE
             cube(ARRAY[session_min, x_min, y_min, z_min], ARRAY[session_max, x_max, y_max, z_max])
             && cube(ARRAY[1, 0.1, 0.1, 0.1], ARRAY[1, 0.2, 0.2, 0.2]) AND key > 0",
        )
        .fetch_all(&beside)
        .await
        .unwrap();
        let plan = plan.join("\n");
        assert!(plan.contains("point_cells_by_place"), "{plan}");
        // And that it was used: a connection's counts are there once it has ended.
        store.close().await.unwrap();
        let scans = "SELECT idx_scan FROM pg_stat_user_indexes WHERE indexrelname = 'point_cells_by_place'";
        let mut n_scans = 0;
        for _ in 0..100 {
            n_scans = number(&home, scans).await;
            if n_scans > 0 {
                break;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        assert!(n_scans > 0, "the store asks in another way than the index answers");
    }

    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn a_server_that_is_away_is_told_and_what_waits_is_saved_when_it_is_back() {
        let mut cluster = Cluster::start();
        let options = StoreOptions { connect_timeout: Duration::from_secs(1), ..StoreOptions::default() };
        let store = Store::connect(&cluster.url(), options).await.unwrap();
        store.create_session(&new_session("s")).await.unwrap();
        let world = parts(1, SMALL);
        let update = first_update(&world);
        cluster.stop();
        for _ in 0..2 {
            let error = store.save_update("s", &update, TRACKED, &[]).await.unwrap_err();
            assert!(matches!(error, StoreError::Unreachable(_)), "{error:?}");
            assert!(matches!(store.check_saving(), Err(StoreError::Failing(_))));
            assert!(matches!(store.get_session("s").await, Err(StoreError::Unreachable(_))));
        }
        cluster.start_again();
        store.save_update("s", &update, TRACKED, &[]).await.unwrap();
        store.check_saving().unwrap();
        // Whoever lost the answer to a commit does it again: nothing is there twice.
        store.save_update("s", &update, TRACKED, &[]).await.unwrap();
        assert_same_parts(&load(&store).await, &world);
        assert_eq!(store.check().await.unwrap(), []);
    }

    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn two_programs_write_one_session_in_turn() {
        let home = Home::postgres();
        let (one, other) = (home.store_with_session().await, home.open().await);
        let world = parts(3, SMALL);
        let update = first_update(&world);
        for _ in 0..10 {
            let (a, b) = tokio::join!(
                one.save_update("s", &update, TRACKED, &[]),
                other.save_update("s", &update, TRACKED, &[]),
            );
            assert_eq!(a.unwrap(), b.unwrap());
        }
        assert_same_parts(&load(&one).await, &world);
        assert_eq!(other.check().await.unwrap(), []);
    }

    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn a_schema_of_a_later_version_and_addresses_that_are_none_are_refused() {
        let url = shared_database();
        Store::connect(&url, StoreOptions::default()).await.unwrap().close().await.unwrap();
        let beside = sqlx::PgPool::connect(&url).await.unwrap();
        let newer = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time)
                     VALUES (9999, 'from the future', TRUE, ''::bytea, 0)";
        sqlx::query(newer).execute(&beside).await.unwrap();
        let error = Store::connect(&url, StoreOptions::default()).await.unwrap_err();
        assert!(matches!(error, StoreError::NewerSchema { found: 9999, .. }), "{error:?}");

        let options = || StoreOptions { connect_timeout: Duration::from_secs(1), ..StoreOptions::default() };
        for address in ["postgres://me:secret@127.0.0.1:1/maps", "postgres://me:secret@127.0.0.1:port/maps"] {
            let error = Store::connect(address, options()).await.unwrap_err();
            assert!(matches!(error, StoreError::Unreachable(_) | StoreError::Address(_)), "{error:?}");
            assert!(!format!("{error} {error:?}").contains("secret"), "{error:?}");
        }
    }

    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn the_same_updates_have_the_same_digest_in_either_database() {
        let (file, server) = (Home::file(), Home::postgres());
        let world = structured(51, SMALL);
        let mut digests = Vec::new();
        for home in [&file, &server] {
            let store = home.store_with_session().await;
            store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();
            digests.push(store.digest("s").await.unwrap());
        }
        assert_eq!(digests[0].to_string(), digests[1].to_string());
    }

    fn owner(name: &str) -> Owner {
        let [grpc_url, http_url] = [50051, 8080].map(|port| format!("http://{name}:{port}"));
        Owner { name: name.to_owned(), grpc_url, http_url }
    }

    /// Two servers on one database with a session `s`.
    async fn two_servers(home: &Home, lasts: Duration) -> [Store; 2] {
        home.store_with_session().await;
        let (one, other) = (home.open().await, home.open().await);
        [one.owned_by(owner("one"), lasts), other.owned_by(owner("other"), lasts)]
    }

    const LONG: Duration = Duration::from_secs(60);

    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn servers_know_each_other_for_as_long_as_they_report_themselves() {
        let home = Home::postgres();
        let [one, other] = two_servers(&home, LONG).await;
        assert_eq!(one.servers().await.unwrap(), []);
        let busy = Load { n_loaded: 3, n_streams: 2, n_free: 7, is_leaving: false };
        one.report("1.2.3", &busy).await.unwrap();
        other.report("1.2.3", &Load::default()).await.unwrap();
        let servers = one.servers().await.unwrap();
        assert_eq!(servers[0], ServerRecord { server: owner("one"), version: "1.2.3".into(), load: busy });
        assert_eq!(servers[1].server.name, "other");

        assert_eq!(other.holder("s").await.unwrap(), None);
        one.take("s").await.unwrap();
        let held = |is_leaving| Some(Holder { server: owner("one"), is_leaving });
        assert_eq!(other.holder("s").await.unwrap(), held(false));
        one.report("1.2.3", &Load { is_leaving: true, ..busy }).await.unwrap();
        assert_eq!(other.holder("s").await.unwrap(), held(true));
        one.give_back("s").await;
        assert_eq!(other.holder("s").await.unwrap(), None);

        one.withdraw().await.unwrap();
        assert_eq!(other.servers().await.unwrap().len(), 1);
        number(&home, "UPDATE servers SET expires_at = now() - interval '1 s' RETURNING 1::bigint").await;
        assert_eq!(other.servers().await.unwrap(), []);
        let secret = one.fleet_secret().await.unwrap().unwrap();
        assert_eq!((secret.len(), Some(&secret)), (32, other.fleet_secret().await.unwrap().as_ref()));
    }

    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn a_session_is_one_servers_until_it_is_given_back() {
        let home = Home::postgres();
        let [one, other] = two_servers(&home, LONG).await;
        let update = first_update(&parts(1, SMALL));
        one.take("s").await.unwrap();
        one.save_update("s", &update, TRACKED, &[]).await.unwrap();
        let digest = one.digest("s").await.unwrap();
        let scale = SessionChanges { metres_per_unit: Some(Some(2.0)), ..SessionChanges::default() };
        for refused in [
            other.take("s").await,
            other.save_update("s", &update, TRACKED, &[]).await.map(drop),
            other.update_session("s", &scale).await.map(drop),
            other.set_mask("s", None).await,
            other.begin_segment("s", 99, 1).await,
            other.delete_session("s").await,
        ] {
            let Err(StoreError::OwnedElsewhere { owner: named, .. }) = refused else { panic!("{refused:?}") };
            assert_eq!(named, owner("one"));
        }
        assert_eq!(
            other.digest("s").await.unwrap(),
            digest,
            "reading is everybody's, and nothing was written"
        );
        one.give_back("s").await;
        other.take("s").await.unwrap();
        other.save_update("s", &update, TRACKED, &[]).await.unwrap();
        assert!(matches!(one.take("s").await, Err(StoreError::OwnedElsewhere { .. })));
        assert!(matches!(one.take("t").await, Err(StoreError::SessionNotFound { .. })));
    }

    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn who_stood_still_writes_nothing_into_what_another_has_taken() {
        let home = Home::postgres();
        let [one, other] = two_servers(&home, LONG).await;
        let update = first_update(&parts(1, SMALL));
        one.take("s").await.unwrap();
        // For the database one's lease has ended, while one, whose clock stood still, believes that it goes
        // on.
        assert_eq!(
            number(&home, "UPDATE leases SET expires_at = now() - interval '1 s' RETURNING 1::bigint").await,
            1
        );
        other.take("s").await.unwrap();
        let before = other.digest("s").await.unwrap();
        assert!(one.keeps("s"), "it does not know yet");
        let refused = one.save_update("s", &update, TRACKED, &[]).await;
        assert!(matches!(refused, Err(StoreError::LeaseLost { .. })), "{refused:?}");
        assert!(matches!(one.delete_session("s").await, Err(StoreError::LeaseLost { .. })));
        assert_eq!(other.digest("s").await.unwrap(), before);
        // Nor when nobody has it any more: its map may be another by now.
        other.save_update("s", &update, TRACKED, &[]).await.unwrap();
        other.give_back("s").await;
        assert!(matches!(
            one.save_update("s", &update, TRACKED, &[]).await,
            Err(StoreError::LeaseLost { .. })
        ));
        // It learns of it when it renews.
        assert_eq!(one.lost(Duration::ZERO), [""; 0]);
        one.renew().await.unwrap();
        assert_eq!(one.lost(Duration::ZERO), ["s"]);
        assert!(!one.keeps("s"));
        one.give_back("s").await;
        one.take("s").await.unwrap();
        one.save_update("s", &update, TRACKED, &[]).await.unwrap();
    }

    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn a_lease_that_is_renewed_lasts_and_one_that_is_not_ends_for_its_server_first() {
        let home = Home::postgres();
        let [one, other] = two_servers(&home, Duration::from_millis(1500)).await;
        let update = first_update(&parts(1, SMALL));
        one.take("s").await.unwrap();
        for _ in 0..8 {
            tokio::time::sleep(Duration::from_millis(300)).await;
            one.renew().await.unwrap();
            assert!(matches!(other.take("s").await, Err(StoreError::OwnedElsewhere { .. })));
        }
        let begun = std::time::Instant::now();
        while let Err(StoreError::OwnedElsewhere { .. }) = other.take("s").await {
            assert!(begun.elapsed() < Duration::from_secs(20), "the lease does not end");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        // Nobody asked the database here.
        assert!(!one.keeps("s") && one.lost(Duration::ZERO) == ["s"]);
        assert!(matches!(
            one.save_update("s", &update, TRACKED, &[]).await,
            Err(StoreError::LeaseLost { .. })
        ));
        other.save_update("s", &update, TRACKED, &[]).await.unwrap();
    }

    /// There and back: every session is the same in each database, and an interrupted copy is finished.
    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn sessions_move_between_databases_row_by_row() {
        let homes = [Home::file(), Home::postgres(), Home::file()];
        let [file, server, again] =
            [homes[0].store_with_session().await, homes[1].open().await, homes[2].open().await];
        // A number that sessions of the other databases do not have.
        server.create_session(&new_session("before")).await.unwrap();
        let update = first_update(&structured(51, SMALL));
        let image = KeyframeImage { keyframe: kf(1), media_type: "image/png".into(), bytes: vec![7; 1000] };
        file.save_update("s", &update, TRACKED, &[image]).await.unwrap();
        file.begin_segment("s", 500, -3).await.unwrap();
        let reading = MotionReading {
            timestamp_ns: 5,
            angular_velocity: [0.1, 0.2, 0.3],
            acceleration: [0.0, -9.8, 0.5],
        };
        file.add_motion("s", &[reading]).await.unwrap();
        file.create_session(&new_session("empty")).await.unwrap();
        let scale = SessionChanges { metres_per_unit: Some(Some(0.25)), ..SessionChanges::default() };
        file.update_session("s", &scale).await.unwrap();
        for (from, to) in [(&file, &server), (&server, &again)] {
            for id in ["s", "empty"] {
                assert_eq!(to.copy_session(from, id).await.unwrap(), Copied::Whole);
                assert_eq!(to.copy_session(from, id).await.unwrap(), Copied::Before);
                assert_eq!(to.digest(id).await.unwrap(), from.digest(id).await.unwrap());
                assert_eq!(to.get_session(id).await.unwrap(), from.get_session(id).await.unwrap());
            }
            assert_same_parts(&load(to).await, &load(&file).await);
            assert_eq!(
                to.motion_after("s", None).await.unwrap(),
                from.motion_after("s", None).await.unwrap()
            );
            assert_eq!(
                to.keyframe_image("s", kf(1)).await.unwrap(),
                from.keyframe_image("s", kf(1)).await.unwrap()
            );
            assert_eq!(to.check().await.unwrap(), []);
        }
        // What a copy that was interrupted leaves behind has no name and goes when the database is opened.
        let unfinished = "INSERT INTO sessions (camera, options, created_at_ns, state) VALUES ('', '', 0, 1) RETURNING number";
        number(&homes[1], unfinished).await;
        homes[1].open().await;
        assert_eq!(number(&homes[1], "SELECT count(*) FROM sessions").await, 3);
        // Another session of the same name stays what it is.
        again.update_session("s", &SessionChanges { metres_per_unit: Some(None), ..scale }).await.unwrap();
        let refused = again.copy_session(&server, "s").await;
        assert!(matches!(refused, Err(StoreError::SessionExists { .. })), "{refused:?}");
    }

    /// What is copied is every column there is, but the session's number and name, and which server has it.
    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn both_databases_have_the_same_columns() {
        let homes = [Home::file(), Home::postgres()];
        for home in &homes {
            home.open().await.close().await.unwrap();
        }
        let [Home::File(folder), Home::Postgres(url)] = &homes else { unreachable!("they were made so") };
        let file = sqlx::SqlitePool::connect(folder.path().join("maps.db").to_str().unwrap()).await.unwrap();
        let of_file: Vec<String> = sqlx::query_scalar(
            "SELECT t.name || '.' || c.name FROM sqlite_schema t, pragma_table_info(t.name) c
             WHERE t.type = 'table' AND t.name NOT LIKE '%\\_%cells\\_%' ESCAPE '\\' AND t.name NOT LIKE '\\_%' ESCAPE '\\'
             AND t.name NOT LIKE '%cells\\_%' ESCAPE '\\' ORDER BY 1",
        )
        .fetch_all(&file)
        .await
        .unwrap();
        let server = sqlx::PgPool::connect(url).await.unwrap();
        let mut of_server: Vec<String> = sqlx::query_scalar(
            "SELECT table_name || '.' || column_name FROM information_schema.columns WHERE table_schema = 'public'
             AND table_name NOT LIKE '\\_%' AND table_name NOT IN ('leases', 'servers', 'fleet_key')",
        )
        .fetch_all(&server)
        .await
        .unwrap();
        of_server.retain(|column| column != "sessions.epoch");
        of_server.sort();
        assert_eq!(of_file, of_server);
    }
}
