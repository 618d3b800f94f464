//! `monoslam-server token`: tokens made, listed and revoked, also while the server runs.

use crate::access::{Role, new_token, token_hash};
use crate::clock::since_1970_ns;
use crate::config::Config;
use crate::data::open_store_beside;
use crate::session::is_name;
use anyhow::Context;
use clap::{Args, Subcommand, ValueEnum};
use std::io::Write;
use std::time::Duration;
use store::{NewToken, Store, TokenQuotas, TokenRecord, TokenRole};

/// What to do with tokens.
#[derive(Debug, Subcommand)]
pub enum TokenCommand {
    /// Makes a token and prints it, once: the database keeps a hash of it alone
    Create(CreateArgs),
    /// Lists the tokens, revoked ones too
    List,
    /// Makes a token good for nothing; a running server notices within a second
    Revoke {
        /// Its name
        name: String,
    },
}

/// A token to be made.
#[derive(Debug, Args)]
pub struct CreateArgs {
    /// What to call it: 1 to 64 letters, digits, `-` and `_`
    #[arg(value_parser = name)]
    name: String,
    /// What it allows: to read its owner's sessions, to write them as well, or everything with all sessions
    #[arg(long, value_enum, default_value = "writer")]
    role: RoleArg,
    /// Whose sessions it is for; tokens of one owner share them [default: the token's name]
    #[arg(long, value_name = "OWNER", value_parser = name)]
    owner: Option<String>,
    /// Days until it runs out [default: never]
    #[arg(long, value_name = "DAYS")]
    days: Option<u32>,
    /// Sessions its owner may have
    #[arg(long, value_name = "N")]
    max_sessions: Option<u64>,
    /// Streams that may be open with it at the same time
    #[arg(long, value_name = "N")]
    max_streams: Option<u64>,
    /// Frames a second that may come with it
    #[arg(long, value_name = "RATE", value_parser = rate)]
    max_fps: Option<f64>,
    /// Bytes of images and features that its owner's sessions may keep
    #[arg(long, value_name = "BYTES")]
    max_bytes: Option<u64>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum RoleArg {
    Reader,
    Writer,
    Admin,
}

impl TokenCommand {
    /// Does it, and prints the outcome to `out`.
    ///
    /// # Errors
    /// A sentence that says why it cannot be done.
    pub async fn run(self, config: &Config, out: &mut impl Write) -> anyhow::Result<()> {
        let store = open_store_beside(config).await?;
        let outcome = match self {
            Self::Create(args) => create(&store, args, out).await,
            Self::List => list(&store, out).await,
            Self::Revoke { name } => revoke(&store, &name, out).await,
        };
        store.close().await?;
        outcome
    }
}

async fn create(store: &Store, args: CreateArgs, out: &mut impl Write) -> anyhow::Result<()> {
    let CreateArgs { name, role, owner, days, max_sessions, max_streams, max_fps, max_bytes } = args;
    let role = match role {
        RoleArg::Reader => TokenRole::Reader,
        RoleArg::Writer => TokenRole::Writer,
        RoleArg::Admin => TokenRole::Admin,
    };
    anyhow::ensure!(
        role != TokenRole::Admin || owner.is_none(),
        "an administrator sees everybody's sessions: --owner goes with the roles reader and writer"
    );
    let owner = (role != TokenRole::Admin).then(|| owner.unwrap_or_else(|| name.clone()));
    let created_at_ns = since_1970_ns();
    let day_ns = Duration::from_secs(24 * 3600).as_nanos() as i64;
    let expires_at_ns = days.map(|days| created_at_ns.saturating_add(i64::from(days).saturating_mul(day_ns)));
    let quotas =
        TokenQuotas { max_sessions, max_streams, max_frames_per_s: max_fps, max_stored_bytes: max_bytes };
    let token = new_token();
    let hash = token_hash(&token);
    let new = NewToken { name, hash, role, owner, created_at_ns, expires_at_ns, quotas };
    let is_first = store.tokens().await?.is_empty();
    store.create_token(&new).await?;
    record("token.create", &new.name);
    writeln!(out, "{token}")?;
    eprintln!("This is the token {:?}. It is not kept and cannot be shown again.", new.name);
    if is_first {
        eprintln!(
            "From now on everybody needs a token, also on this machine. Sessions from before belong to nobody: \
             tokens with the role admin lead to them."
        );
    }
    Ok(())
}

async fn list(store: &Store, out: &mut impl Write) -> anyhow::Result<()> {
    let tokens = store.tokens().await?;
    if tokens.is_empty() {
        eprintln!("There are no tokens: whoever is on this machine may do everything.");
        return Ok(());
    }
    writeln!(out, "{:<20} {:<7} {:<20} {:<8} made", "name", "role", "owner", "state")?;
    let now_ns = since_1970_ns();
    for TokenRecord { token, revoked_at_ns, .. } in tokens {
        let state = match (revoked_at_ns, token.expires_at_ns) {
            (Some(_), _) => "revoked",
            (None, Some(end_ns)) if end_ns <= now_ns => "run out",
            _ => "good",
        };
        let owner = token.owner.as_deref().unwrap_or("everybody's");
        let days = (now_ns - token.created_at_ns) / Duration::from_secs(24 * 3600).as_nanos() as i64;
        let (name, role) = (&token.name, Role::from(token.role).name());
        writeln!(out, "{name:<20} {role:<7} {owner:<20} {state:<8} {days} days ago")?;
    }
    Ok(())
}

async fn revoke(store: &Store, name: &str, out: &mut impl Write) -> anyhow::Result<()> {
    let was_good = store.revoke_token(name, since_1970_ns()).await.context("nothing was revoked")?;
    record("token.revoke", name);
    let outcome = if was_good { "is revoked" } else { "was revoked before" };
    writeln!(out, "{name} {outcome}")?;
    Ok(())
}

fn record(action: &'static str, name: &str) {
    tracing::info!(target: "audit", action, who = "command line", token = name, "{action} {name}");
}

fn name(text: &str) -> Result<String, String> {
    let wrong = || "1 to 64 letters, digits, `-` and `_` expected".to_owned();
    if is_name(text) { Ok(text.to_owned()) } else { Err(wrong()) }
}

fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|rate: &f64| (0.01..=1e6).contains(rate));
    rate.ok_or_else(|| "a number from 0.01 to 1000000 expected".to_owned())
}
