//! `monoslam sessions`: lists, shows and deletes sessions.

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use proto::v1;
use serde_json::{Value, json};

use super::{ServerArgs, session_id};

/// What to do with which sessions.
#[derive(Debug, Args)]
pub struct SessionsArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// List all sessions
    List {
        #[command(flatten)]
        server: ServerArgs,
        /// Print one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Show one session
    Show {
        /// The session
        #[arg(value_name = "NAME", value_parser = session_id)]
        session: String,
        #[command(flatten)]
        server: ServerArgs,
        /// Print one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Delete a session with its map
    Delete {
        /// The session
        #[arg(value_name = "NAME", value_parser = session_id)]
        session: String,
        #[command(flatten)]
        server: ServerArgs,
    },
}

/// Does it.
pub async fn run(args: SessionsArgs) -> Result<()> {
    match args.action {
        Action::List { server, json } => {
            let sessions = server.connect().await?.sessions().await?;
            if json {
                let sessions: Vec<Value> = sessions.iter().map(as_json).collect();
                println!("{}", json!({ "sessions": sessions }));
            } else {
                print!("{}", table(&sessions));
            }
        }
        Action::Show { session, server, json } => {
            let found = server.connect().await?.session(&session).await?;
            let found = as_json(&found.with_context(|| format!("there is no session `{session}`"))?);
            if json {
                println!("{found}");
            } else {
                println!("{found:#}");
            }
        }
        Action::Delete { session, server } => {
            server.connect().await?.delete_session(&session).await?;
            println!("deleted {session}");
            eprintln!(
                "the database file stays as large; new sessions fill the room, and `monoslam-server compact` gives it \
                 back while no server runs"
            );
        }
    }
    Ok(())
}

fn table(sessions: &[v1::Session]) -> String {
    let head = format!(
        "{:<24} {:<12} {:>9} {:>10} {:>9} {:>8} {:>10} {:>8} {:>7}\n",
        "session", "state", "frames", "keyframes", "points", "lines", "primitives", "submaps", "writer"
    );
    let row = |s: &v1::Session| {
        format!(
            "{:<24} {:<12} {:>9} {:>10} {:>9} {:>8} {:>10} {:>8} {:>7}\n",
            s.id,
            state_name(s),
            s.n_frames,
            s.n_keyframes,
            s.n_points,
            s.n_lines,
            s.n_primitives,
            s.n_submaps,
            if s.has_writer { "yes" } else { "no" }
        )
    };
    sessions.iter().fold(head, |text, session| text + &row(session))
}

fn state_name(session: &v1::Session) -> &'static str {
    if session.damage.is_some() {
        return "damaged";
    }
    match session.state() {
        v1::TrackingState::Unspecified => "new",
        v1::TrackingState::Initialising => "initialising",
        v1::TrackingState::Tracked => "tracked",
        v1::TrackingState::Weak => "weak",
        v1::TrackingState::Lost => "lost",
    }
}

fn as_json(session: &v1::Session) -> Value {
    let [camera, refined_camera] = [&session.camera, &session.refined_camera].map(|camera| {
        camera.as_ref().map(|c| {
            json!({
                "model": c.model().as_str_name().trim_start_matches("CAMERA_MODEL_").to_lowercase(),
                "width": c.width, "height": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy,
                "distortion": c.distortion,
            })
        })
    });
    let options = session.options.as_ref().map(|o| {
        json!({
            "deterministic": o.deterministic, "seed": o.seed, "n_features": o.n_features, "points": o.points,
            "lines": o.lines, "global_primitives": o.global_primitives, "loop_closing": o.loop_closing,
            "max_keyframes": o.max_keyframes, "refine_calibration": o.refine_calibration,
            "give_up_calibration": o.give_up_calibration, "find_mask": o.find_mask, "readout_ms": o.readout_ms,
        })
    });
    json!({
        "id": session.id, "map": session.map, "camera": camera, "refined_camera": refined_camera, "options": options, "created_at_ns": session.created_at_ns,
        "state": state_name(session), "frames": session.n_frames, "keyframes": session.n_keyframes,
        "points": session.n_points, "lines": session.n_lines, "primitives": session.n_primitives,
        "submaps": session.n_submaps, "durable_sequence": session.durable_sequence,
        "next_sequence": session.next_sequence, "last_timestamp_ns": session.last_timestamp_ns,
        "last_timestamp_ns_text": session.last_timestamp_ns.map(|ns| ns.to_string()),
        "metres_per_unit": session.metres_per_unit, "loaded": session.loaded, "has_writer": session.has_writer,
        "damage": session.damage,
        "found_readout": session.found_readout.as_ref().map(|found| json!({ "readout_ms": found.readout_ms, "sigma_ms": found.sigma_ms })),
    })
}
