//! What is PostgreSQL's own: the index of places, servers that stop, several programs on one database.

use crate::world::*;
use nalgebra::Vector3;
use store::{Bounds, LineQuery, PointQuery, Store, StoreError, StoreOptions};
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
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
        assert!(n_scans > 0, "the store asks in another way than the index answers");
    }

    #[tokio::test]
    #[ignore = "needs PostgreSQL"]
    async fn a_server_that_is_away_is_told_and_what_waits_is_saved_when_it_is_back() {
        let mut cluster = Cluster::start();
        let options =
            StoreOptions { connect_timeout: std::time::Duration::from_secs(1), ..StoreOptions::default() };
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

        let options =
            || StoreOptions { connect_timeout: std::time::Duration::from_secs(1), ..StoreOptions::default() };
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
}
