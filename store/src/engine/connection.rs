//! A connection to either database.

use super::postgres;
use crate::StoreError;
use sqlx::pool::PoolConnection;
use sqlx::{Database, Postgres, Sqlite, Transaction};
use std::ops::{Deref, DerefMut};
use std::time::Duration;

/// A connection to either database, alone or in a transaction that only reads.
pub(crate) enum Connection {
    Sqlite(Held<Sqlite>),
    /// With how long a statement may take.
    Postgres(Held<Postgres>, Duration),
}

/// A connection of one database.
pub(crate) enum Held<D: Database> {
    /// Each question is answered from the last commit.
    Alone(PoolConnection<D>),
    /// Every question is answered from the same commit.
    Reading(Transaction<'static, D>),
}

impl Connection {
    /// The first text for SQLite, the second for PostgreSQL.
    pub fn either(&self, sqlite: &'static str, postgres: &'static str) -> &'static str {
        match self {
            Self::Sqlite(_) => sqlite,
            Self::Postgres(..) => postgres,
        }
    }

    /// Runs a statement without values and answers, such as `COMMIT`.
    pub async fn command(&mut self, statement: &'static str) -> Result<(), StoreError> {
        match self {
            Self::Sqlite(held) => {
                sqlx::raw_sql(statement).execute(&mut **held).await?;
            }
            Self::Postgres(held, patience) => {
                let done = postgres::limited(*patience, sqlx::raw_sql(statement).execute(&mut **held)).await;
                done.inspect_err(|_| held.close_on_drop())?;
            }
        }
        Ok(())
    }

    /// Ends a transaction that only read; nothing is lost if it is dropped instead.
    pub async fn commit(self) -> Result<(), StoreError> {
        match self {
            Self::Sqlite(Held::Reading(transaction)) => transaction.commit().await?,
            Self::Postgres(Held::Reading(transaction), patience) => {
                postgres::limited(patience, transaction.commit()).await?;
            }
            Self::Sqlite(Held::Alone(_)) | Self::Postgres(Held::Alone(_), _) => {}
        }
        Ok(())
    }

    /// Ends the connection when it is dropped, and with it a transaction that was begun by hand.
    pub fn close_on_drop(&mut self) {
        match self {
            Self::Sqlite(held) => held.close_on_drop(),
            Self::Postgres(held, _) => held.close_on_drop(),
        }
    }
}

impl<D: Database> Held<D> {
    /// Ends the connection when it is dropped. One that only reads leaves nothing behind: its transaction is
    /// rolled back, and a connection that does not answer to that is closed.
    pub fn close_on_drop(&mut self) {
        if let Self::Alone(connection) = self {
            connection.close_on_drop();
        }
    }
}

impl<D: Database> Deref for Held<D> {
    type Target = D::Connection;

    fn deref(&self) -> &D::Connection {
        match self {
            Self::Alone(connection) => connection,
            Self::Reading(transaction) => transaction,
        }
    }
}

impl<D: Database> DerefMut for Held<D> {
    fn deref_mut(&mut self) -> &mut D::Connection {
        match self {
            Self::Alone(connection) => connection,
            Self::Reading(transaction) => transaction,
        }
    }
}
