//! The store from outside: what is saved comes back, and nothing else changes.

/// Makes of each test that takes a [`world::Home`] one in a file of SQLite and one in a database of
/// PostgreSQL.
macro_rules! on_either_engine {
    ($($name:ident),* $(,)?) => {
        mod sqlite {$(
            #[tokio::test]
            async fn $name() {
                super::$name(crate::world::Home::file()).await;
            }
        )*}

        mod postgres {$(
            #[tokio::test]
            #[ignore = "needs PostgreSQL"]
            async fn $name() {
                super::$name(crate::world::Home::postgres()).await;
            }
        )*}
    };
}

mod backup;
mod cameras;
mod check;
mod durability;
mod graph;
mod lines;
mod motion;
mod objects;
mod on_postgres;
mod primitives;
mod queries;
mod save_load;
mod schema;
mod sessions;
mod tokens;
mod trajectory;
mod viewing;

/// Maps made by hand, and databases of them.
mod world {
    pub use testkit::stored::*;
    pub use testkit::world::*;

    /// The number that a statement answers, asked beside the store.
    pub async fn number(home: &Home, sql: &'static str) -> i64 {
        match home {
            Home::File(folder) => {
                let file = folder.path().join("maps.db");
                let database = sqlx::SqlitePool::connect(file.to_str().unwrap()).await.unwrap();
                let number = sqlx::query_scalar(sql).fetch_one(&database).await.unwrap();
                database.close().await;
                number
            }
            Home::Postgres(url) => {
                let database = sqlx::PgPool::connect(url).await.unwrap();
                let number = sqlx::query_scalar(sql).fetch_one(&database).await.unwrap();
                database.close().await;
                number
            }
        }
    }
}
