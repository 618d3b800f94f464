//! `monoslam-server`: serves until told to stop, or checks or compacts a database.

use anyhow::Context;
use clap::{Parser, Subcommand};
use server::{Config, ConfigArgs, Hangups, QuickShare, Server, TokenCommand};
use std::io::IsTerminal;

/// Monocular SLAM as a service: frames in over gRPC, maps and trajectories out over gRPC and HTTP
#[derive(Debug, Parser)]
#[command(name = "monoslam-server", version)]
struct Args {
    #[command(flatten)]
    config: ConfigArgs,
    /// Let a phone in the same network map: encrypted, with a certificate made for it, and the address of its
    /// page as a QR code
    #[arg(long)]
    quick_share: bool,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Checks that the database is whole and that its maps make sense; exits with 1 if not
    Check,
    /// Makes, lists and revokes tokens, also while a server runs
    #[command(subcommand)]
    Token(TokenCommand),
    /// Gives the room of deleted sessions back to the file system, while no server runs; needs as much room
    /// beside the database as it has of data
    Compact,
}

fn main() -> anyhow::Result<()> {
    let Args { config, quick_share, command } = Args::parse();
    let config = Config::load(config)?;
    server::start_log(config.log);
    let runtime = tokio::runtime::Runtime::new().context("cannot start the runtime")?;
    let outcome = match command {
        None => runtime.block_on(serve(config, quick_share)),
        Some(Command::Check) => runtime.block_on(check(config)),
        Some(Command::Token(command)) => runtime.block_on(command.run(&config, &mut std::io::stdout())),
        Some(Command::Compact) => runtime.block_on(compact(config)),
    };
    // A session that was abandoned at the end of the grace period must not hold the process up.
    runtime.shutdown_background();
    outcome
}

async fn serve(mut config: Config, quick_share: bool) -> anyhow::Result<()> {
    let share = quick_share.then(|| QuickShare::prepare(&mut config)).transpose()?;
    // From now on: a hang-up while the database is opened must not end the process.
    let mut hangups = Hangups::new().context("SIGHUP cannot be listened for")?;
    let running = Server::start_with_guest(config, share.as_ref().map(QuickShare::guest)).await?;
    if let Some(share) = share {
        println!("{}", share.invitation(running.http_addr, std::io::stdout().is_terminal())?);
    }
    let requested = server::shutdown_requested();
    tokio::pin!(requested);
    loop {
        tokio::select! {
            requested = requested.as_mut() => break requested?,
            () = hangups.next() => running.reload().await,
        }
    }
    running.shutdown().await;
    Ok(())
}

async fn check(config: Config) -> anyhow::Result<()> {
    let file = config.data_dir.join(server::DATABASE_FILE);
    anyhow::ensure!(file.exists(), "there is no database at {}", file.display());
    let (store, is_unwritable) = server::open_store_to_read(&config).await?;
    if is_unwritable {
        let log = config.data_dir.join(format!("{}-wal", server::DATABASE_FILE));
        let n_bytes = log.metadata().map_or(0, |log| log.len());
        let left_out =
            if n_bytes > 0 { format!(", without the {n_bytes} bytes in its log") } else { String::new() };
        println!("{} cannot be written and is read as it is{left_out}", file.display());
    }
    let problems = store.check().await.context("the database cannot be checked")?;
    if !is_unwritable {
        store.close().await?;
    }
    for problem in &problems {
        println!("{problem}");
    }
    anyhow::ensure!(problems.is_empty(), "{} problems found in {}", problems.len(), file.display());
    println!("{} is whole", file.display());
    Ok(())
}

async fn compact(config: Config) -> anyhow::Result<()> {
    let file = config.data_dir.join(server::DATABASE_FILE);
    anyhow::ensure!(file.exists(), "there is no database at {}", file.display());
    let [before, after] = server::compact(&config).await?;
    let mb = |bytes: u64| bytes as f64 * 1e-6;
    println!("{}: {:.1} MB before, {:.1} MB now", file.display(), mb(before), mb(after));
    Ok(())
}
