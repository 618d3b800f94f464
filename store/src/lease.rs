//! Who works with a session: of several servers on one database of PostgreSQL, one at a time.
//!
//! A server that has named itself ([`Store::owned_by`]) takes a session before it loads it ([`Store::take`]),
//! renews what it has taken ([`Store::renew`]), and gives it back ([`Store::give_back`]). Each time a session
//! is taken its epoch rises. Every transaction that writes into a session locks its row and compares: who has
//! taken it writes only with the newest epoch, who has not only while nobody else has. A taker waits for that
//! lock. So whatever a server believes after it stood still, it writes nothing into what another has taken.
//!
//! Times are the database's. Each server counts its own lease from before it asked for it, by its own clock
//! that only goes on, so that it ends for the server before it does for the database, however the clocks are
//! set.

use crate::engine::{Connection, Row, query};
use crate::open::WriteTransaction;
use crate::session::parse_session;
use crate::{SessionRecord, Store, StoreError};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A server as the others know it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Owner {
    /// No two that run at the same time have the same.
    pub name: String,
    /// Where clients reach its gRPC.
    pub grpc_url: String,
    /// Where clients reach its HTTP.
    pub http_url: String,
}

/// What this server has taken. Clones of a store share it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Leases(Option<Arc<Ours>>);

#[derive(Debug)]
struct Ours {
    owner: Owner,
    lasts: Duration,
    taken: Mutex<BTreeMap<String, Taken>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Taken {
    session: i64,
    epoch: i64,
    /// Until when nobody else can have taken it.
    until: Instant,
}

impl Ours {
    fn taken(&self) -> MutexGuard<'_, BTreeMap<String, Taken>> {
        // No code that can panic runs while it is locked.
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whose a session is at present; nothing if nobody's. Parameter 1 is the session's number.
const SELECT_OWNER: &str =
    "SELECT owner, grpc_url, http_url FROM leases WHERE session = $1 AND expires_at > clock_timestamp()";

impl WriteTransaction {
    /// A session with its number, in a transaction that is going to write it: who else would waits for its
    /// end.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], and [`StoreError::OwnedElsewhere`] or
    /// [`StoreError::LeaseLost`] if another server works with it.
    pub async fn hold(&mut self, id: &str) -> Result<(i64, SessionRecord), StoreError> {
        let sql = self.either(
            "SELECT * FROM sessions WHERE id = $1",
            "SELECT * FROM sessions WHERE id = $1 FOR NO KEY UPDATE",
        );
        let row = query(sql).bind(id).fetch_optional(self).await?;
        let row = row.ok_or_else(|| StoreError::SessionNotFound { id: id.to_owned() })?;
        // One server uses a file, which it locks.
        if let Connection::Postgres(..) = **self {
            let leases = self.leases().clone();
            leases.check(self, id, &row).await?;
        }
        parse_session(&row)
    }
}

impl Leases {
    /// Fails if this server must not write into the session, whose row, locked, is given.
    pub async fn check(&self, connection: &mut Connection, id: &str, row: &Row) -> Result<(), StoreError> {
        let taken = self.0.as_ref().and_then(|ours| ours.taken().get(id).copied());
        if let Some(taken) = taken {
            let newest: (i64, i64) = (row.try_get("number")?, row.try_get("epoch")?);
            let is_ours = (taken.session, taken.epoch) == newest && Instant::now() < taken.until;
            return if is_ours { Ok(()) } else { Err(StoreError::LeaseLost { id: id.to_owned() }) };
        }
        let own_name = self.0.as_ref().map(|ours| ours.owner.name.as_str());
        match read_owner(connection, row.try_get("number")?).await? {
            Some(owner) if Some(owner.name.as_str()) != own_name => {
                Err(StoreError::OwnedElsewhere { id: id.to_owned(), owner })
            }
            _ => Ok(()),
        }
    }
}

async fn read_owner(connection: &mut Connection, session: i64) -> Result<Option<Owner>, StoreError> {
    let row = query(SELECT_OWNER).bind(session).fetch_optional(connection).await?;
    row.map(|row| Ok(Owner { name: row.try_get(0)?, grpc_url: row.try_get(1)?, http_url: row.try_get(2)? }))
        .transpose()
}

impl Store {
    /// As a server among others: sessions it takes are its own for `lasts` unless it renews them. With SQLite
    /// nothing changes: the server there is alone.
    pub fn owned_by(self, owner: Owner, lasts: Duration) -> Self {
        if self.path().is_some() {
            return self;
        }
        let ours = Ours { owner, lasts, taken: Mutex::default() };
        self.with_leases(Leases(Some(Arc::new(ours))))
    }

    /// This server among others, and for how long it stands for something without saying so again.
    pub(crate) fn own(&self) -> Option<(&Owner, Duration)> {
        self.leases().0.as_ref().map(|ours| (&ours.owner, ours.lasts))
    }

    /// What this server is called among others; `None` if it is alone.
    pub fn own_name(&self) -> Option<&str> {
        self.own().map(|(owner, _)| owner.name.as_str())
    }

    /// Takes a session, before it is loaded. Nothing happens in a store that nobody owns.
    ///
    /// # Errors
    /// [`StoreError::OwnedElsewhere`] if another server has it, and [`StoreError::SessionNotFound`].
    pub async fn take(&self, id: &str) -> Result<(), StoreError> {
        let Some(ours) = &self.leases().0 else { return Ok(()) };
        let begun = Instant::now();
        let mut transaction = self.begin_write().await?;
        let lock = "SELECT number, epoch FROM sessions WHERE id = $1 FOR NO KEY UPDATE";
        let row = query(lock).bind(id).fetch_optional(&mut transaction).await?;
        let row = row.ok_or_else(|| StoreError::SessionNotFound { id: id.to_owned() })?;
        let (session, before): (i64, i64) = (row.try_get(0)?, row.try_get(1)?);
        if let Some(owner) = read_owner(&mut transaction, session).await?
            && owner.name != ours.owner.name
        {
            return Err(StoreError::OwnedElsewhere { id: id.to_owned(), owner });
        }
        let epoch = before + 1;
        query("UPDATE sessions SET epoch = $2 WHERE number = $1")
            .bind(session)
            .bind(epoch)
            .execute(&mut transaction)
            .await?;
        query(
            "INSERT INTO leases (session, epoch, owner, grpc_url, http_url, expires_at)
             VALUES ($1, $2, $3, $4, $5, clock_timestamp() + $6 * interval '1 second')
             ON CONFLICT (session) DO UPDATE SET epoch = excluded.epoch, owner = excluded.owner,
             grpc_url = excluded.grpc_url, http_url = excluded.http_url, expires_at = excluded.expires_at",
        )
        .bind(session)
        .bind(epoch)
        .bind(&ours.owner.name)
        .bind(&ours.owner.grpc_url)
        .bind(&ours.owner.http_url)
        .bind(ours.lasts.as_secs_f64())
        .execute(&mut transaction)
        .await?;
        transaction.commit().await?;
        ours.taken().insert(id.to_owned(), Taken { session, epoch, until: begun + ours.lasts });
        Ok(())
    }

    /// Renews what this server has taken, all in one statement. What it has lost meanwhile [`Self::lost`]
    /// tells.
    ///
    /// # Errors
    /// If the database cannot be reached; what was taken stays so until its lease ends.
    pub async fn renew(&self) -> Result<(), StoreError> {
        let Some(ours) = &self.leases().0 else { return Ok(()) };
        let (begun, before) = (Instant::now(), ours.taken().clone());
        if before.is_empty() {
            return Ok(());
        }
        let mut transaction = self.begin_write().await?;
        let sessions: Vec<i64> = before.values().map(|taken| taken.session).collect();
        // In the order of the sessions, so that two that renew do not wait for each other.
        let renewed = query(
            "WITH mine AS (SELECT session FROM leases WHERE session IN IDS($1) AND owner = $2 ORDER BY session FOR UPDATE)
             UPDATE leases l SET expires_at = clock_timestamp() + $3 * interval '1 second' FROM mine
             WHERE l.session = mine.session RETURNING l.session, l.epoch",
        )
        .bind(sessions)
        .bind(&ours.owner.name)
        .bind(ours.lasts.as_secs_f64())
        .fetch_all(&mut transaction)
        .await?;
        transaction.commit().await?;
        let rows = renewed.iter().map(|row| Ok((row.try_get(0)?, row.try_get(1)?)));
        let renewed = rows.collect::<Result<BTreeMap<i64, i64>, StoreError>>()?;
        for (id, was) in before {
            let mut taken = ours.taken();
            let Some(now) = taken.get_mut(&id).filter(|now| **now == was) else { continue };
            if renewed.get(&was.session) == Some(&was.epoch) {
                now.until = begun + ours.lasts;
            } else {
                // Another has it.
                now.until = begun;
            }
        }
        Ok(())
    }

    /// Whether a session is this server's, as far as it can know; always in a store that nobody owns.
    pub fn keeps(&self, id: &str) -> bool {
        let Some(ours) = &self.leases().0 else { return true };
        ours.taken().get(id).is_some_and(|taken| Instant::now() < taken.until)
    }

    /// The sessions this server took and whose lease has ended, or will within `margin`: they must not be
    /// gone on with.
    pub fn lost(&self, margin: Duration) -> Vec<String> {
        let Some(ours) = &self.leases().0 else { return Vec::new() };
        let end = Instant::now() + margin;
        ours.taken().iter().filter(|(_, taken)| taken.until <= end).map(|(id, _)| id.clone()).collect()
    }

    /// Gives a session back, once nothing more is written into it, so that another server can take it at
    /// once. One that was lost, or that the database does not hear of, is given back by its lease's end.
    pub async fn give_back(&self, id: &str) {
        let Some(ours) = &self.leases().0 else { return };
        let Some(taken) = ours.taken().remove(id) else { return };
        let given = async {
            let mut transaction = self.begin_write().await?;
            query("DELETE FROM leases WHERE session = $1 AND owner = $2 AND epoch = $3")
                .bind(taken.session)
                .bind(&ours.owner.name)
                .bind(taken.epoch)
                .execute(&mut transaction)
                .await?;
            transaction.commit().await
        };
        if let Err(error) = given.await {
            tracing::warn!(session.id = id, "a session is given back only when its lease ends: {error}");
        }
    }
}
