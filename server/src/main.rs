//! `monoslam-server`: serves until told to stop, or looks after a database.

use anyhow::Context;
use clap::{Parser, Subcommand};
use server::{
    Config, ConfigArgs, ConfigCommand, Hangups, Manager, QuickShare, Server, TokenCommand, UpkeepCommand,
};
use std::io::IsTerminal;
use std::sync::Arc;

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
    #[command(flatten)]
    Upkeep(UpkeepCommand),
    /// Makes, lists and revokes tokens, also while a server runs
    #[command(subcommand)]
    Token(TokenCommand),
    /// Checks the configuration, or shows where each of its values comes from
    #[command(subcommand)]
    Config(ConfigCommand),
    /// Asks the server that runs with this configuration whether it is ready; exits with 1 if not
    Health,
}

fn main() -> anyhow::Result<()> {
    let Args { config: arguments, quick_share, command } = Args::parse();
    let config = Config::load(arguments.clone())?;
    let runtime = tokio::runtime::Runtime::new().context("cannot start the runtime")?;
    let traces = {
        let _within = runtime.enter();
        server::start_log(&config)?
    };
    let outcome = match command {
        None => runtime.block_on(serve(config, arguments, quick_share)),
        Some(Command::Upkeep(command)) => runtime.block_on(command.run(&config, &mut std::io::stdout())),
        Some(Command::Config(command)) => command.run(&config, &arguments, &mut std::io::stdout()),
        Some(Command::Health) => runtime.block_on(server::probe(&config, &mut std::io::stdout())),
        Some(Command::Token(command)) => runtime.block_on(command.run(&config, &mut std::io::stdout())),
    };
    drop(traces);
    // A session that was abandoned at the end of the grace period must not hold the process up.
    runtime.shutdown_background();
    outcome
}

async fn serve(mut config: Config, arguments: ConfigArgs, quick_share: bool) -> anyhow::Result<()> {
    let manager = Arc::new(Manager::of_environment());
    let (mut as_read, grace) = (config.clone(), config.shutdown_grace());
    let share = quick_share.then(|| QuickShare::prepare(&mut config)).transpose()?;
    // From now on: a hang-up while the database is opened must not end the process.
    let mut hangups = Hangups::new().context("SIGHUP cannot be listened for")?;
    let running = Server::start_with_guest(config, share.as_ref().map(QuickShare::guest)).await?;
    if let Some(share) = share {
        println!("{}", share.invitation(running.http_addr, std::io::stdout().is_terminal())?);
    }
    let status = format!("gRPC on {}, HTTP on {}", running.grpc_addr, running.http_addr);
    manager.ready(&status);
    tokio::spawn(manager.clone().beat());
    let requested = server::shutdown_requested();
    tokio::pin!(requested);
    loop {
        tokio::select! {
            requested = requested.as_mut() => break requested?,
            () = hangups.next() => {
                manager.reloading();
                running.reload().await;
                match Config::load(arguments.clone()) {
                    Ok(read) => {
                        running.reconfigure(&as_read, &read);
                        as_read = read;
                    }
                    Err(error) => tracing::error!("the configuration from before holds: {error:#}"),
                }
                manager.ready(&status);
            }
        }
    }
    manager.stopping(grace);
    running.shutdown().await;
    Ok(())
}
