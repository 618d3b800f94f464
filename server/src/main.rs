//! `monoslam-server`: serves until told to stop, or checks a database.

use anyhow::Context;
use clap::{Parser, Subcommand};
use server::{Config, ConfigArgs, Server};

/// Monocular SLAM as a service: frames in over gRPC, maps and trajectories out over gRPC and HTTP
#[derive(Debug, Parser)]
#[command(name = "monoslam-server", version)]
struct Args {
    #[command(flatten)]
    config: ConfigArgs,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Checks that the database is whole and that its maps make sense; exits with 1 if not
    Check,
}

fn main() -> anyhow::Result<()> {
    let Args { config, command } = Args::parse();
    let config = Config::load(config)?;
    server::start_log(config.log);
    let runtime = tokio::runtime::Runtime::new().context("cannot start the runtime")?;
    let outcome = match command {
        None => runtime.block_on(serve(config)),
        Some(Command::Check) => runtime.block_on(check(config)),
    };
    // A session that was abandoned at the end of the grace period must not hold the process up.
    runtime.shutdown_background();
    outcome
}

async fn serve(config: Config) -> anyhow::Result<()> {
    let running = Server::start(config).await?;
    server::shutdown_requested().await?;
    running.shutdown().await;
    Ok(())
}

async fn check(config: Config) -> anyhow::Result<()> {
    let file = config.data_dir.join(server::DATABASE_FILE);
    anyhow::ensure!(file.exists(), "there is no database at {}", file.display());
    let store = server::open_store(&config).await?;
    let problems = store.check().await.context("the database cannot be checked")?;
    store.close().await?;
    for problem in &problems {
        println!("{problem}");
    }
    anyhow::ensure!(problems.is_empty(), "{} problems found in {}", problems.len(), file.display());
    println!("{} is whole", file.display());
    Ok(())
}
