//! The servers that share a database of PostgreSQL: where each is, how busy it is, and who has a session.
//!
//! Each reports itself every few seconds ([`Store::report`]); a row lasts as long as a lease, by the
//! database's clock. In a file of SQLite the server is alone, and all of this is empty.

use crate::engine::{Row, query};
use crate::number::{from_column, to_column};
use crate::{Owner, Store, StoreError};

/// How busy a server is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Load {
    /// Sessions in memory.
    pub n_loaded: u64,
    /// Of these, how many a client streams into.
    pub n_streams: u64,
    /// Streams it takes beyond these.
    pub n_free: u64,
    /// It is about to stop: it takes no further sessions and hands over those it has.
    pub is_leaving: bool,
}

/// A server as it reported itself last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerRecord {
    /// What it is called and where it is.
    pub server: Owner,
    /// Its version.
    pub version: String,
    /// How busy it is.
    pub load: Load,
}

/// Who has a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// The server.
    pub server: Owner,
    /// It is about to stop and hands its sessions over.
    pub is_leaving: bool,
}

impl Store {
    /// Reports this server to the others.
    ///
    /// # Errors
    /// If the database cannot be written.
    pub async fn report(&self, version: &str, load: &Load) -> Result<(), StoreError> {
        let Some((own, lasts)) = self.own() else { return Ok(()) };
        let mut transaction = self.begin_write().await?;
        // What was not heard of for a day is gone for good: its row is only in the way.
        query("DELETE FROM servers WHERE expires_at < clock_timestamp() - interval '1 day'")
            .execute(&mut transaction)
            .await?;
        query(
            "INSERT INTO servers (name, grpc_url, http_url, version, n_loaded, n_streams, n_free, is_leaving, expires_at)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, clock_timestamp() + $9 * interval '1 second')
             ON CONFLICT (name) DO UPDATE SET grpc_url = excluded.grpc_url, http_url = excluded.http_url,
             version = excluded.version, n_loaded = excluded.n_loaded, n_streams = excluded.n_streams,
             n_free = excluded.n_free, is_leaving = excluded.is_leaving, expires_at = excluded.expires_at",
        )
        .bind(&own.name)
        .bind(&own.grpc_url)
        .bind(&own.http_url)
        .bind(version)
        .bind(to_column("n_loaded", load.n_loaded)?)
        .bind(to_column("n_streams", load.n_streams)?)
        .bind(to_column("n_free", load.n_free)?)
        .bind(load.is_leaving)
        .bind(lasts.as_secs_f64())
        .execute(&mut transaction)
        .await?;
        transaction.commit().await
    }

    /// Takes this server off the list.
    ///
    /// # Errors
    /// If the database cannot be written; then it is left out once its row expires.
    pub async fn withdraw(&self) -> Result<(), StoreError> {
        let Some((own, _)) = self.own() else { return Ok(()) };
        let mut transaction = self.begin_write().await?;
        query("DELETE FROM servers WHERE name = $1").bind(&own.name).execute(&mut transaction).await?;
        transaction.commit().await
    }

    /// The servers that are there, in the order of their names.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn servers(&self) -> Result<Vec<ServerRecord>, StoreError> {
        if self.own().is_none() {
            return Ok(Vec::new());
        }
        let mut reader = self.reader().await?;
        let rows = query("SELECT * FROM servers WHERE expires_at > clock_timestamp() ORDER BY name")
            .fetch_all(&mut reader)
            .await?;
        rows.iter().map(parse).collect()
    }

    /// The server that works with a session at present; `None` if none does, or there is no such session.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn holder(&self, id: &str) -> Result<Option<Holder>, StoreError> {
        if self.own().is_none() {
            return Ok(None);
        }
        let mut reader = self.reader().await?;
        let row = query(
            "SELECT l.owner, l.grpc_url, l.http_url, COALESCE(v.is_leaving, FALSE)
             FROM sessions s LEFT JOIN sessions m ON m.id = s.map
             JOIN leases l ON l.session = COALESCE(m.number, s.number) AND l.expires_at > clock_timestamp()
             LEFT JOIN servers v ON v.name = l.owner WHERE s.id = $1",
        )
        .bind(id)
        .fetch_optional(&mut reader)
        .await?;
        row.map(|row| {
            let server =
                Owner { name: row.try_get(0)?, grpc_url: row.try_get(1)?, http_url: row.try_get(2)? };
            Ok(Holder { server, is_leaving: row.try_get(3)? })
        })
        .transpose()
    }

    /// What servers of this database, and nobody else, can sign with; `None` in a file.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn fleet_secret(&self) -> Result<Option<Vec<u8>>, StoreError> {
        if self.own().is_none() {
            return Ok(None);
        }
        let mut reader = self.reader().await?;
        let secret: Option<Vec<u8>> = query("SELECT secret FROM fleet_key").scalar(&mut reader).await?;
        secret.map(Some).ok_or_else(|| StoreError::Corrupt("the key of the fleet is missing".to_owned()))
    }
}

fn parse(row: &Row) -> Result<ServerRecord, StoreError> {
    let number = |column: &'static str| from_column(column, row.try_get(column)?);
    let server = Owner {
        name: row.try_get("name")?,
        grpc_url: row.try_get("grpc_url")?,
        http_url: row.try_get("http_url")?,
    };
    let load = Load {
        n_loaded: number("n_loaded")?,
        n_streams: number("n_streams")?,
        n_free: number("n_free")?,
        is_leaving: row.try_get("is_leaving")?,
    };
    Ok(ServerRecord { server, version: row.try_get("version")?, load })
}
