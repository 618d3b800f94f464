//! Other systems' figures on the same recordings, measured elsewhere and kept in a table.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::Serialize;

/// One system on one recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Peer {
    /// The recording's name.
    pub sequence: String,
    /// The system.
    pub name: String,
    /// Runs.
    pub runs: Option<f64>,
    /// Share of frames with a pose, median of the runs.
    pub coverage: Option<f64>,
    /// ATE RMSE of the runs: median, least and greatest.
    pub ate_rmse: [Option<f64>; 3],
    /// Processor time of the tracking thread per frame, milliseconds: median and 95th percentile.
    pub tracking_cpu_ms: [Option<f64>; 2],
    /// Peak of resident memory, MB.
    pub peak_memory_mb: Option<f64>,
    /// Keyframes.
    pub keyframes: Option<f64>,
    /// Points.
    pub points: Option<f64>,
}

/// Reads the table: comma-separated, its columns named in the first line, empty where nothing was measured.
pub fn read(path: &Path) -> Result<Vec<Peer>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    parse(&text).with_context(|| format!("{} cannot be used", path.display()))
}

fn parse(text: &str) -> Result<Vec<Peer>> {
    let mut lines = text.lines();
    let columns: Vec<&str> = lines.next().context("the table is empty")?.split(',').map(str::trim).collect();
    let column = |name: &str| {
        columns
            .iter()
            .position(|column| *column == name)
            .with_context(|| format!("there is no column `{name}`"))
    };
    let mut peers = Vec::new();
    for line in lines.filter(|line| !line.trim().is_empty()) {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        ensure!(cells.len() == columns.len(), "`{line}` has {} columns, not {}", cells.len(), columns.len());
        let word = |name: &str| anyhow::Ok(cells[column(name)?].to_owned());
        let number = |name: &str| match cells[column(name)?] {
            "" => anyhow::Ok(None),
            cell => Ok(Some(cell.parse().with_context(|| format!("`{cell}` in `{line}` is not a number"))?)),
        };
        peers.push(Peer {
            sequence: word("sequence")?,
            name: word("peer")?,
            runs: number("runs")?,
            coverage: number("coverage_median")?,
            ate_rmse: [number("ate_rmse_median_m")?, number("ate_rmse_min_m")?, number("ate_rmse_max_m")?],
            tracking_cpu_ms: [number("tracking_cpu_ms_median")?, number("tracking_cpu_ms_p95")?],
            peak_memory_mb: number("peak_rss_mb")?,
            keyframes: number("key_frames")?,
            points: number("map_points")?,
        });
    }
    Ok(peers)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "sequence,peer,runs,crashes,coverage_min,coverage_median,coverage_max,ate_rmse_min_m,\
        ate_rmse_median_m,ate_rmse_max_m,tracking_cpu_ms_median,tracking_cpu_ms_p95,peak_rss_mb,key_frames,map_points";

    #[test]
    fn columns_are_found_by_name_and_may_be_empty() {
        let peers =
            parse(&format!("{HEAD}\nroom,other,4,1,0.1,0.5,0.9,0.01,0.02,0.03,,,287,66,2412\n")).unwrap();
        assert_eq!(peers[0].coverage, Some(0.5));
        assert_eq!(peers[0].ate_rmse, [Some(0.02), Some(0.01), Some(0.03)]);
        assert_eq!((peers[0].tracking_cpu_ms, peers[0].points), ([None, None], Some(2412.0)));
    }

    #[test]
    fn mistakes_are_named() {
        let message = |text: &str| format!("{:#}", parse(text).unwrap_err());
        assert_eq!(message("sequence,peer\nroom,other"), "there is no column `runs`");
        assert_eq!(message("sequence,peer\nroom"), "`room` has 1 columns, not 2");
        let wrong = format!("{HEAD}\nroom,other,4,1,0.1,half,0.9,0.01,0.02,0.03,,,287,66,2412\n");
        assert!(message(&wrong).contains("`half`"));
    }
}
