//! The schema's history, embedded.

use std::borrow::Cow;
use std::sync::LazyLock;

use sqlx::SqlSafeStr;
use sqlx::migrate::{Migration, MigrationType, Migrator};

/// Version, description and SQL of each migration, as `build.rs` found them in a folder.
type Files = &'static [(i64, &'static str, &'static str)];

/// Those in `migrations/`.
const SQLITE_FILES: Files = &include!(concat!(env!("OUT_DIR"), "/migrations.rs"));

/// Those in `migrations/postgres/`.
const POSTGRES_FILES: Files = &include!(concat!(env!("OUT_DIR"), "/migrations_postgres.rs"));

/// The migrations of SQLite files, in the order they are run.
pub static SQLITE_MIGRATIONS: LazyLock<Migrator> = LazyLock::new(|| migrator(SQLITE_FILES));

/// The migrations of PostgreSQL databases, in the order they are run.
pub static POSTGRES_MIGRATIONS: LazyLock<Migrator> = LazyLock::new(|| migrator(POSTGRES_FILES));

fn migrator(files: Files) -> Migrator {
    let migration = |(version, description, sql): &(i64, &'static str, &'static str)| {
        let sql = (*sql).into_sql_str();
        Migration::new(*version, Cow::Borrowed(*description), MigrationType::Simple, sql, false)
    };
    Migrator::with_migrations(files.iter().map(migration).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn migrations_are_numbered_without_a_gap_and_not_empty() {
        for files in [SQLITE_FILES, POSTGRES_FILES] {
            let versions: Vec<i64> = migrator(files).iter().map(|migration| migration.version).collect();
            assert!(!versions.is_empty());
            assert_eq!(versions, (1..=versions.len() as i64).collect::<Vec<_>>());
            let has_text =
                |(_, description, sql): &(i64, &str, &str)| !description.is_empty() && !sql.trim().is_empty();
            assert!(files.iter().all(has_text));
        }
    }
}
