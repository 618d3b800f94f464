//! Figures as sections of a document and as tables.

use client::Distribution;

use super::ablation;
use super::machine::Machine;
use super::peers::Peer;
use super::setup::Configuration;
use super::statistics::{Row, Spread};
use super::table::{Place, Table};

/// What stands above figures that must not be quoted.
const UNOPTIMIZED: &str = "**This was not a release build: its times say nothing.**\n\n";

/// What a command measured, as the section of that name of a document: the command, the machine, and the
/// tables. It has no date: the same figures give the same bytes.
pub fn section(name: &str, command: &str, machine: &Machine, rows: &[Row], peers: &[Peer]) -> String {
    format!(
        "Written by\n\n```sh\n{command}\n```\n\non {cores} cores of {cpu}; the reference job took {before:.0} ms before and {after:.0} ms after.\n\n{warning}{tables}",
        warning = if cfg!(debug_assertions) { UNOPTIMIZED } else { "" },
        cores = machine.cores,
        cpu = machine.cpu,
        before = machine.reference_ms[0],
        after = machine.reference_ms[1],
        tables = tables(Place::Section(name), rows, peers),
    )
}

/// The ablation if it is one, accuracy with the peers' figures, time, and time by stage.
pub fn tables(place: Place<'_>, rows: &[Row], peers: &[Peer]) -> String {
    let mut text = String::new();
    text.push_str(&ablation::table(place, rows));
    text.push_str(&accuracy(place, rows, peers));
    text.push_str(&time(place, rows));
    text.push_str(&stages(place, rows));
    text
}

/// Ours first, then the peers' on the same recording.
fn accuracy(place: Place<'_>, rows: &[Row], peers: &[Peer]) -> String {
    let mut table = Table::new(
        place,
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

fn time(place: Place<'_>, rows: &[Row]) -> String {
    let mut table = Table::new(
        place,
        "Time per frame",
        &[
            "sequence",
            "system",
            "wall ms, median / p95",
            "tracking CPU ms, median / p95",
            "process CPU ms a frame",
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
            spread(row.process_cpu_ms, 1),
            spread(row.realtime_factor, 2),
            row.dropped.map_or("-".into(), |s| format!("{:.1} %", 100.0 * s.median)),
        ]);
    }
    table.finish()
}

fn stages(place: Place<'_>, rows: &[Row]) -> String {
    let head = ["sequence", "system", "stage", "frames", "wall ms, median / p95"];
    let mut table = Table::new(place, "Time by stage", &head);
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
