//! Figures as a document.

use std::fmt::Write;

use client::Distribution;

use super::ablation;
use super::machine::Machine;
use super::peers::Peer;
use super::statistics::{Row, Spread};
use super::{Configuration, Pace};

/// What stands above figures that must not be quoted.
const UNOPTIMIZED: &str = "**This was not a release build: its times say nothing.**\n\n";

/// The whole document. It has no date: the same figures give the same bytes.
pub fn document(command: &str, machine: &Machine, pace: Pace, rows: &[Row], peers: &[Peer]) -> String {
    let pace = match pace {
        Pace::Fast => "Frames are sent as fast as every one is tracked (lossless).",
        Pace::Realtime => {
            "Frames are sent as recorded; the server drops those it has no time for (realtime)."
        }
    };
    format!(
        "# Results\n\n\
         Written by\n\n```\n{command}\n```\n\n\
         on {cores} cores of {cpu}. Each run is a process of its own with a new server: frames go in by gRPC over a \
         socket, the trajectory of all frames comes out by HTTP, and is compared with the ground truth after \
         similarity alignment (the figure of `evo_ape tum TRUTH ESTIMATE -as`). {pace}\n\n\
         Read ATE only beside coverage, the share of all frames with a pose: a short trajectory flatters it. Scale \
         drift is the local scale of the second half of the trajectory over that of the first. Memory is the peak \
         of server and client together.\n\n{warning}{tables}",
        warning = if cfg!(debug_assertions) { UNOPTIMIZED } else { "" },
        cores = machine.cores,
        cpu = machine.cpu,
        tables = tables(rows, peers),
    )
}

/// The ablation if it is one, accuracy with the peers' figures, time, and time by stage.
pub fn tables(rows: &[Row], peers: &[Peer]) -> String {
    let mut text = String::new();
    text.push_str(&ablation::table(rows));
    text.push_str(&accuracy(rows, peers));
    text.push_str(&time(rows));
    text.push_str(&stages(rows));
    text
}

/// Ours first, then the peers' on the same recording.
fn accuracy(rows: &[Row], peers: &[Peer]) -> String {
    let mut table = Table::new(
        "Accuracy",
        &[
            "sequence",
            "system",
            "runs",
            "coverage",
            "ATE RMSE, median (min–max)",
            "scale drift",
            "keyframes",
            "points",
            "lines",
            "primitives",
            "tracking CPU ms, median / p95",
            "peak MiB",
        ],
    );
    for (i, row) in rows.iter().enumerate() {
        table.row(&[
            row.sequence.clone(),
            system_name(row),
            row.runs.len().to_string(),
            spread(row.coverage, 3),
            row.ate_rmse.map_or("-".into(), |s| format!("{:.4} ({:.4}–{:.4})", s.median, s.min, s.max)),
            spread(row.scale_drift, 3),
            spread(row.keyframes, 0),
            spread(row.points, 0),
            spread(row.lines, 0),
            spread(row.primitives, 0),
            distribution(row.tracking_cpu_ms),
            spread(row.peak_memory_mib, 0),
        ]);
        if rows.get(i + 1).is_none_or(|next| next.sequence != row.sequence) {
            for peer in peers.iter().filter(|peer| peer.sequence == row.sequence) {
                table.row(&peer_cells(peer));
            }
        }
    }
    table.finish()
}

fn peer_cells(peer: &Peer) -> [String; 12] {
    let [median, min, max] = peer.ate_rmse;
    let ate = match (median, min, max) {
        (Some(median), Some(min), Some(max)) => format!("{median:.4} ({min:.4}–{max:.4})"),
        _ => "-".to_owned(),
    };
    let [cpu_median, cpu_p95] = peer.tracking_cpu_ms;
    let cpu = cpu_median.zip(cpu_p95).map(|(median, p95)| Distribution { median, p95 });
    [
        peer.sequence.clone(),
        peer.name.clone(),
        number(peer.runs, 0),
        number(peer.coverage, 3),
        ate,
        "-".to_owned(),
        number(peer.keyframes, 0),
        number(peer.points, 0),
        "-".to_owned(),
        "-".to_owned(),
        distribution(cpu),
        number(peer.peak_memory_mb, 0),
    ]
}

fn time(rows: &[Row]) -> String {
    let mut table = Table::new(
        "Time per frame",
        &[
            "sequence",
            "system",
            "wall ms, median / p95",
            "tracking CPU ms, median / p95",
            "x real time",
            "dropped",
        ],
    );
    for row in rows {
        table.row(&[
            row.sequence.clone(),
            system_name(row),
            distribution(row.wall_ms),
            distribution(row.tracking_cpu_ms),
            spread(row.realtime_factor, 2),
            row.dropped.map_or("-".into(), |s| format!("{:.1} %", 100.0 * s.median)),
        ]);
    }
    table.finish()
}

fn stages(rows: &[Row]) -> String {
    let head = ["sequence", "system", "stage", "frames", "wall ms, median / p95"];
    let mut table = Table::new("Time by stage, over the frames in which it ran", &head);
    for row in rows {
        for stage in &row.stages {
            table.row(&[
                row.sequence.clone(),
                system_name(row),
                stage.name.clone(),
                stage.frames.to_string(),
                distribution(Some(stage.ms)),
            ]);
        }
    }
    table.finish()
}

fn system_name(row: &Row) -> String {
    if row.configuration == Configuration::Default.name() {
        "**monoslam**".to_owned()
    } else {
        format!("**monoslam {}**", row.configuration)
    }
}

fn spread(spread: Option<Spread>, digits: usize) -> String {
    number(spread.map(|spread| spread.median), digits)
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.digits$}"))
}

fn distribution(distribution: Option<Distribution>) -> String {
    distribution.map_or("-".to_owned(), |d| format!("{:.2} / {:.2}", d.median, d.p95))
}

/// A table of a document.
pub struct Table(String);

impl Table {
    /// A table without rows under its title.
    pub fn new(title: &str, columns: &[&str]) -> Self {
        let mut table = Self(format!("## {title}\n\n"));
        table.cells(columns.iter());
        table.cells(columns.iter().enumerate().map(|(i, _)| if i < 2 { "---" } else { "---:" }));
        table
    }

    /// Adds a row.
    pub fn row(&mut self, cells: &[String]) {
        self.cells(cells.iter());
    }

    fn cells(&mut self, cells: impl Iterator<Item: std::fmt::Display>) {
        for cell in cells {
            // Writing to a string cannot fail.
            let _ = write!(self.0, "| {cell} ");
        }
        self.0.push_str("|\n");
    }

    /// The table with an empty line after it.
    pub fn finish(mut self) -> String {
        self.0.push('\n');
        self.0
    }
}
