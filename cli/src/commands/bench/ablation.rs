//! Points, points and lines, and global primitives side by side, as the ablation table of Jiang et al. has
//! them.

use super::setup::Configuration;
use super::statistics::Row;
use super::table::{Place, Table};

/// One recording in the configurations of an ablation.
struct Sequence<'a> {
    name: &'a str,
    /// In the order of [`Configuration::ABLATION`]; `None` where there is no row.
    rows: [Option<&'a Row>; 3],
}

/// ATE RMSE (median over the runs), its change in per cent, and coverage, by recording; empty unless the rows
/// are an ablation's.
pub fn table(place: Place<'_>, rows: &[Row]) -> String {
    let sequences = sequences(rows);
    if sequences.is_empty() {
        return String::new();
    }
    let mut table = Table::new(
        place,
        "Change by feature",
        &["sequence", "runs", "P", "LP", "GP", "LP against P", "GP against LP", "coverage P / LP / GP"],
    );
    let mut changes: [Vec<f64>; 2] = Default::default();
    for sequence in &sequences {
        let ate = sequence.rows.map(|row| Some(row?.ate_rmse?.median));
        let of_sequence = [change(ate[0], ate[1]), change(ate[1], ate[2])];
        changes.iter_mut().zip(of_sequence).for_each(|(all, change)| all.extend(change));
        let figure = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.4}"));
        let coverage = sequence.rows.map(|row| {
            let median = row.and_then(|row| row.coverage).map(|coverage| coverage.median);
            median.map_or("-".to_owned(), |median| format!("{median:.3}"))
        });
        table.row(&[
            sequence.name.to_owned(),
            sequence.rows.iter().flatten().map(|row| row.runs.len()).max().unwrap_or(0).to_string(),
            figure(ate[0]),
            figure(ate[1]),
            figure(ate[2]),
            per_cent(of_sequence[0]),
            per_cent(of_sequence[1]),
            coverage.join(" / "),
        ]);
    }
    let mean =
        |changes: &[f64]| (!changes.is_empty()).then(|| changes.iter().sum::<f64>() / changes.len() as f64);
    let blank = String::new;
    let means = [per_cent(mean(&changes[0])), per_cent(mean(&changes[1]))];
    let [lp, gp] = means;
    table.row(&["mean change".to_owned(), blank(), blank(), blank(), blank(), lp, gp, blank()]);
    table.finish()
}

/// The recordings that were measured in more than one configuration, in the order of the rows.
fn sequences(rows: &[Row]) -> Vec<Sequence<'_>> {
    let mut sequences: Vec<Sequence> = Vec::new();
    for row in rows {
        let configuration = Configuration::ABLATION
            .iter()
            .position(|configuration| configuration.name() == row.configuration);
        let Some(configuration) = configuration else { continue };
        let position =
            sequences.iter().position(|sequence| sequence.name == row.sequence).unwrap_or_else(|| {
                sequences.push(Sequence { name: &row.sequence, rows: [None; 3] });
                sequences.len() - 1
            });
        sequences[position].rows[configuration] = Some(row);
    }
    sequences
}

/// By how much a figure changes, in per cent of what it was: below zero is better.
fn change(before: Option<f64>, after: Option<f64>) -> Option<f64> {
    let change = 100.0 * (after? / before? - 1.0);
    change.is_finite().then_some(change)
}

fn per_cent(change: Option<f64>) -> String {
    change.map_or("-".to_owned(), |change| format!("{change:+.1} %"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::bench::statistics::Spread;

    fn row(sequence: &str, configuration: &'static str, ate: Option<f64>) -> Row {
        let spread = |median: f64| Spread { median, min: median, max: median };
        Row {
            sequence: sequence.into(),
            configuration,
            coverage: Some(spread(0.9)),
            ate_rmse: ate.map(spread),
            scale_drift: None,
            keyframes: None,
            points: None,
            lines: None,
            primitives: None,
            wall_ms: None,
            tracking_cpu_ms: None,
            stages: Vec::new(),
            realtime_factor: None,
            dropped: None,
            peak_memory_mib: None,
            process_cpu_ms: None,
            runs: Vec::new(),
        }
    }

    #[test]
    fn changes_are_told_by_sequence_and_in_the_mean() {
        let rows = [
            row("room", "P", Some(0.04)),
            row("room", "LP", Some(0.03)),
            row("room", "GP", Some(0.036)),
            row("hall", "P", None),
            row("hall", "LP", Some(0.2)),
            row("hall", "GP", Some(0.1)),
        ];
        let text = table(Place::Alone, &rows);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(
            lines[4],
            "| room | 0 | 0.0400 | 0.0300 | 0.0360 | -25.0 % | +20.0 % | 0.900 / 0.900 / 0.900 |"
        );
        assert_eq!(lines[5], "| hall | 0 | - | 0.2000 | 0.1000 | - | -50.0 % | 0.900 / 0.900 / 0.900 |");
        assert_eq!(lines[6], "| mean change |  |  |  |  | -25.0 % | -15.0 % |  |");
    }

    #[test]
    fn one_configuration_is_no_ablation() {
        assert_eq!(table(Place::Alone, &[row("room", "default", Some(0.1))]), "");
    }
}
