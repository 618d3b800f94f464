//! `monoslam optimize`, `merge` and `operations`: what takes long on the server, and goes on there.

use std::io::{IsTerminal, stderr};
use std::time::Duration;

use anyhow::{Result, bail};
use clap::{Args, Subcommand};
use client::SlamClient;
use indicatif::{ProgressBar, ProgressStyle};
use proto::v1;
use proto::v1::operation::Result as Outcome;
use serde_json::{Value, json};

use super::{ServerArgs, session_id};

/// How often the server is asked how far it is.
const ASK_EVERY: Duration = Duration::from_millis(250);
/// Steps of the bar.
const N_STEPS: u64 = 1000;

/// Which map.
#[derive(Debug, Args)]
pub struct OptimizeArgs {
    /// The session
    #[arg(value_name = "NAME", value_parser = session_id)]
    session: String,
    #[command(flatten)]
    wait: WaitArgs,
}

/// Which maps.
#[derive(Debug, Args)]
pub struct MergeArgs {
    /// The session that takes the other one in
    #[arg(value_name = "INTO", value_parser = session_id)]
    into: String,
    /// The session that is taken in; it stays as it is
    #[arg(value_name = "FROM", value_parser = session_id)]
    from: String,
    #[command(flatten)]
    wait: WaitArgs,
}

#[derive(Debug, Args)]
struct WaitArgs {
    #[command(flatten)]
    server: ServerArgs,
    /// Do not wait for the end; `monoslam operations` tells how far it is
    #[arg(long)]
    detach: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// What to do with which operations.
#[derive(Debug, Args)]
pub struct OperationsArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// List operations, the newest first
    List {
        /// Those on this session only
        #[arg(long, value_name = "NAME", value_parser = session_id)]
        session: Option<String>,
        #[command(flatten)]
        server: ServerArgs,
        /// Print one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Show one operation
    Show {
        /// The operation
        #[arg(value_name = "ID")]
        operation: String,
        #[command(flatten)]
        server: ServerArgs,
    },
    /// Wait for an operation to end
    Wait {
        /// The operation
        #[arg(value_name = "ID")]
        operation: String,
        #[command(flatten)]
        wait: WaitArgs,
    },
    /// Ask an operation to end without a result
    Cancel {
        /// The operation
        #[arg(value_name = "ID")]
        operation: String,
        #[command(flatten)]
        server: ServerArgs,
    },
}

/// Adjusts a map.
pub async fn optimize(args: OptimizeArgs) -> Result<()> {
    let mut client = args.wait.server.connect().await?;
    let begun = client.optimize_map(&args.session).await?;
    follow(&mut client, begun, &args.wait).await
}

/// Joins two maps.
pub async fn merge(args: MergeArgs) -> Result<()> {
    let mut client = args.wait.server.connect().await?;
    let begun = client.merge_sessions(&args.into, &args.from).await?;
    follow(&mut client, begun, &args.wait).await
}

/// Tells of operations.
pub async fn run(args: OperationsArgs) -> Result<()> {
    match args.action {
        Action::List { session, server, json } => {
            let operations = server.connect().await?.operations(session.as_deref()).await?;
            if json {
                let operations: Vec<Value> = operations.iter().map(as_json).collect();
                println!("{}", json!({ "operations": operations }));
            } else {
                print!("{}", table(&operations));
            }
        }
        Action::Show { operation, server } => {
            println!("{:#}", as_json(&server.connect().await?.operation(&operation).await?));
        }
        Action::Wait { operation, wait } => {
            let mut client = wait.server.connect().await?;
            let found = client.operation(&operation).await?;
            follow(&mut client, found, &wait).await?;
        }
        Action::Cancel { operation, server } => {
            let operation = server.connect().await?.cancel_operation(&operation).await?;
            println!("{}: {}", operation.id, state_name(&operation));
        }
    }
    Ok(())
}

/// Shows how far an operation is until it has ended.
async fn follow(client: &mut SlamClient, mut operation: v1::Operation, wait: &WaitArgs) -> Result<()> {
    let bar = (stderr().is_terminal() && !wait.detach).then(|| {
        let template = "{bar:40} {percent}%, {elapsed}, {msg}";
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        ProgressBar::new(N_STEPS).with_style(style)
    });
    while !wait.detach && operation.ended_at_ns.is_none() {
        if let Some(bar) = &bar {
            bar.set_position((operation.progress * N_STEPS as f64) as u64);
            bar.set_message(format!("{}, {} iterations", state_name(&operation), operation.n_iterations));
        }
        tokio::select! {
            () = tokio::time::sleep(ASK_EVERY) => {}
            _ = tokio::signal::ctrl_c() => {
                if let Some(bar) = &bar {
                    bar.finish_and_clear();
                }
                let id = &operation.id;
                eprintln!("it goes on; `monoslam operations wait {id}` waits for it, and `operations cancel {id}` ends it");
                return Ok(());
            }
        }
        operation = client.operation(&operation.id).await?;
    }
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    if wait.json {
        println!("{}", as_json(&operation));
    } else if operation.ended_at_ns.is_none() {
        println!("{}", operation.id);
    } else if operation.state() == v1::OperationState::Done {
        print!("{}", told(&operation));
    }
    match operation.state() {
        v1::OperationState::Failed | v1::OperationState::Cancelled => bail!("{}", operation.message),
        _ => Ok(()),
    }
}

fn told(operation: &v1::Operation) -> String {
    let mut text = format!("{}\n", operation.message);
    match &operation.result {
        Some(Outcome::Optimized(result)) if result.cost_before > 0.0 => {
            let share = 100.0 * (1.0 - result.cost_after / result.cost_before);
            text += &format!("{share:.2} % less in {} iterations\n", operation.n_iterations);
        }
        Some(Outcome::Merged(result)) => {
            for place in &result.places {
                text += &format!(
                    "keyframe {} of {} shows what keyframe {} of {} shows: {} points, scale {:.4}\n",
                    place.from_keyframe,
                    operation.from_session_id,
                    place.into_keyframe,
                    operation.session_id,
                    place.n_matches,
                    place.scale
                );
            }
        }
        _ => {}
    }
    text
}

fn state_name(operation: &v1::Operation) -> &'static str {
    match operation.state() {
        v1::OperationState::Unspecified => "unknown",
        v1::OperationState::Queued => "queued",
        v1::OperationState::Running => "running",
        v1::OperationState::Done => "done",
        v1::OperationState::Failed => "failed",
        v1::OperationState::Cancelled => "cancelled",
    }
}

fn kind_name(operation: &v1::Operation) -> &'static str {
    match operation.kind() {
        v1::OperationKind::Unspecified => "unknown",
        v1::OperationKind::Optimize => "optimize",
        v1::OperationKind::Merge => "merge",
    }
}

fn table(operations: &[v1::Operation]) -> String {
    let head = format!(
        "{:<20} {:<9} {:<24} {:<10} {:>5}  {}\n",
        "operation", "kind", "session", "state", "%", "message"
    );
    let row = |o: &v1::Operation| {
        format!(
            "{:<20} {:<9} {:<24} {:<10} {:>5.1}  {}\n",
            o.id,
            kind_name(o),
            o.session_id,
            state_name(o),
            100.0 * o.progress,
            o.message
        )
    };
    operations.iter().fold(head, |text, operation| text + &row(operation))
}

fn as_json(o: &v1::Operation) -> Value {
    let (mut optimized, mut merged) = (Value::Null, Value::Null);
    match &o.result {
        Some(Outcome::Optimized(result)) => {
            optimized = json!({
                "cost_before": result.cost_before, "cost_after": result.cost_after,
                "n_keyframes": result.n_keyframes, "n_points": result.n_points, "n_lines": result.n_lines,
            });
        }
        Some(Outcome::Merged(result)) => {
            let places: Vec<Value> = result
                .places
                .iter()
                .map(|place| {
                    json!({
                        "from_keyframe": place.from_keyframe, "into_keyframe": place.into_keyframe,
                        "n_matches": place.n_matches, "scale": place.scale,
                    })
                })
                .collect();
            merged = json!({
                "found": result.found, "places": places, "n_keyframes": result.n_keyframes,
                "n_frames": result.n_frames, "sequence_shift": result.sequence_shift,
                "timestamp_shift_ns": result.timestamp_shift_ns, "n_loops": result.n_loops,
                "cost_before": result.cost_before, "cost_after": result.cost_after,
            });
        }
        None => {}
    }
    let from = Some(&o.from_session_id).filter(|id| !id.is_empty());
    let error_code = Some(&o.error_code).filter(|code| !code.is_empty());
    json!({
        "id": o.id, "kind": kind_name(o), "session_id": o.session_id, "from_session_id": from,
        "state": state_name(o), "progress": o.progress, "n_iterations": o.n_iterations,
        "message": o.message, "error_code": error_code, "created_at_ns": o.created_at_ns,
        "ended_at_ns": o.ended_at_ns, "optimized": optimized, "merged": merged,
    })
}
