//! Tokens: who may use the server, kept as hashes.

use crate::engine::{Row, query};
use crate::number::{from_column, to_column};
use crate::{Store, StoreError};

/// Bytes of a token's hash, SHA-256.
pub const TOKEN_HASH_BYTES: usize = 32;

/// What a token allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum TokenRole {
    /// To read its owner's sessions.
    Reader,
    /// To make, change, stream into and delete its owner's sessions as well.
    Writer,
    /// Everything, with all sessions.
    Admin,
}

/// What a token may use at most; what is `None` is left to the server's configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TokenQuotas {
    /// Sessions of its owner.
    pub max_sessions: Option<u64>,
    /// Streams open at the same time.
    pub max_streams: Option<u64>,
    /// Frames a second, all streams together.
    pub max_frames_per_s: Option<f64>,
    /// Bytes of images and features that its owner's sessions keep.
    pub max_stored_bytes: Option<u64>,
}

/// A token to be kept.
#[derive(Clone, Debug, PartialEq)]
pub struct NewToken {
    /// What people call it.
    pub name: String,
    /// SHA-256 of the token.
    pub hash: [u8; TOKEN_HASH_BYTES],
    /// What it allows.
    pub role: TokenRole,
    /// Whose sessions it is for; `None` for administrators and nobody else.
    pub owner: Option<String>,
    /// Wall-clock time of creation, nanoseconds since 1970.
    pub created_at_ns: i64,
    /// Wall-clock time from which on it is good for nothing; `None` is never.
    pub expires_at_ns: Option<i64>,
    /// What it may use.
    pub quotas: TokenQuotas,
}

/// A token that is kept.
#[derive(Clone, Debug, PartialEq)]
pub struct TokenRecord {
    /// Its number.
    pub id: i64,
    /// What it was made with.
    pub token: NewToken,
    /// Wall-clock time at which it was revoked, nanoseconds since 1970; `None` while it is good.
    pub revoked_at_ns: Option<i64>,
}

impl Store {
    /// Keeps a token.
    ///
    /// # Errors
    /// [`StoreError::TokenExists`] if there is one of this name, also a revoked one.
    pub async fn create_token(&self, new: &NewToken) -> Result<i64, StoreError> {
        let mut transaction = self.begin_write().await?;
        let number = |what, value: Option<u64>| value.map(|value| to_column(what, value)).transpose();
        let id: Option<i64> = query(
            "INSERT INTO tokens (name, hash, role, owner, created_at_ns, expires_at_ns, max_sessions, max_streams,
             max_frames_per_s, max_stored_bytes) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10)
             ON CONFLICT (name) DO NOTHING RETURNING id",
        )
        .bind(&new.name)
        .bind(&new.hash[..])
        .bind(role_column(new.role))
        .bind(&new.owner)
        .bind(new.created_at_ns)
        .bind(new.expires_at_ns)
        .bind(number("max_sessions", new.quotas.max_sessions)?)
        .bind(number("max_streams", new.quotas.max_streams)?)
        .bind(new.quotas.max_frames_per_s)
        .bind(number("max_stored_bytes", new.quotas.max_stored_bytes)?).scalar(&mut transaction).await?;
        let id = id.ok_or_else(|| StoreError::TokenExists { name: new.name.clone() })?;
        transaction.commit().await?;
        Ok(id)
    }

    /// All tokens in the order they were made, revoked ones too.
    pub async fn tokens(&self) -> Result<Vec<TokenRecord>, StoreError> {
        let mut reader = self.reader().await?;
        let rows = query("SELECT * FROM tokens ORDER BY id").fetch_all(&mut reader).await?;
        rows.iter().map(parse).collect()
    }

    /// Makes a token good for nothing; whether it was good until now.
    ///
    /// # Errors
    /// [`StoreError::TokenNotFound`] if there is none of this name.
    pub async fn revoke_token(&self, name: &str, now_ns: i64) -> Result<bool, StoreError> {
        let mut transaction = self.begin_write().await?;
        let revoked: Option<Option<i64>> = query("SELECT revoked_at_ns FROM tokens WHERE name = $1")
            .bind(name)
            .scalar(&mut transaction)
            .await?;
        let before = revoked.ok_or_else(|| StoreError::TokenNotFound { name: name.to_owned() })?;
        query("UPDATE tokens SET revoked_at_ns = coalesce(revoked_at_ns, $1) WHERE name = $2")
            .bind(now_ns)
            .bind(name)
            .execute(&mut transaction)
            .await?;
        transaction.commit().await?;
        Ok(before.is_none())
    }
}

fn parse(row: &Row) -> Result<TokenRecord, StoreError> {
    let number = |column: &'static str| -> Result<Option<u64>, StoreError> {
        let value: Option<i64> = row.try_get(column)?;
        value.map(|value| from_column(column, value)).transpose()
    };
    let hash: &[u8] = row.try_get("hash")?;
    let hash = hash.try_into().map_err(|_| StoreError::Corrupt("the hash of a token".to_owned()))?;
    let token = NewToken {
        name: row.try_get("name")?,
        hash,
        role: parse_role(row.try_get("role")?)?,
        owner: row.try_get("owner")?,
        created_at_ns: row.try_get("created_at_ns")?,
        expires_at_ns: row.try_get("expires_at_ns")?,
        quotas: TokenQuotas {
            max_sessions: number("max_sessions")?,
            max_streams: number("max_streams")?,
            max_frames_per_s: row.try_get("max_frames_per_s")?,
            max_stored_bytes: number("max_stored_bytes")?,
        },
    };
    Ok(TokenRecord { id: row.try_get("id")?, token, revoked_at_ns: row.try_get("revoked_at_ns")? })
}

fn role_column(role: TokenRole) -> i64 {
    match role {
        TokenRole::Reader => 1,
        TokenRole::Writer => 2,
        TokenRole::Admin => 3,
    }
}

fn parse_role(value: i64) -> Result<TokenRole, StoreError> {
    match value {
        1 => Ok(TokenRole::Reader),
        2 => Ok(TokenRole::Writer),
        3 => Ok(TokenRole::Admin),
        _ => Err(StoreError::Corrupt(format!("a token has the unknown role {value}"))),
    }
}
