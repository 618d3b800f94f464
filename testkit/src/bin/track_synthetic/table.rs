//! The tables of several seeds.

use crate::revisit::Revisit;
use synthetic::Preset;

/// What became of one sequence, for the table.
pub struct Row {
    /// Share of the frames with a pose in the largest submap.
    pub coverage: f64,
    pub n_submaps: usize,
    pub n_loops: usize,
    pub n_merges: usize,
    /// Where the camera comes back.
    pub revisit: Option<Revisit>,
    /// Of the largest submap; root mean square error as a share of the path.
    pub ate_share: Option<f64>,
    /// Turn from the first frame to the last, degrees.
    pub drift_deg: Option<f64>,
    /// What was told of the camera last: change of its focal length, as a share of it, and standard
    /// deviation.
    pub camera: Option<[f64; 2]>,
}

impl Row {
    /// Errors and coverage are the medians of several runs; what happened in them is that of the run of
    /// median error.
    pub fn median_of(mut runs: Vec<Self>) -> Self {
        let value = |of: fn(&Self) -> Option<f64>| median_known(runs.iter().map(of));
        let (ate_share, drift_deg) = (value(|run| run.ate_share), value(|run| run.drift_deg));
        let coverage = median(runs.iter().map(|run| run.coverage).collect());
        runs.sort_by(|a, b| {
            a.ate_share.unwrap_or(f64::INFINITY).total_cmp(&b.ate_share.unwrap_or(f64::INFINITY))
        });
        let middle = runs.swap_remove((runs.len() - 1) / 2);
        Self { coverage, ate_share, drift_deg, ..middle }
    }
}

/// A run without a value counts as infinitely bad.
fn median_known(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let middle = median(values.map(|value| value.unwrap_or(f64::INFINITY)).collect());
    middle.is_finite().then_some(middle)
}

/// Every seed, and how many are good.
pub fn print_table(preset: Preset, seeds: &[u64], rows: &[Row]) {
    println!(
        "\n| {}, seed | coverage | submaps | loops | mergers | seen again, tied at frame | ATE, % of the path | drift of the attitude, deg |",
        preset.name()
    );
    println!("| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.3}"));
    for (seed, row) in seeds.iter().zip(rows) {
        println!(
            "| {seed} | {:.3} | {} | {} | {} | {} | {} | {} |",
            row.coverage,
            row.n_submaps,
            row.n_loops,
            row.n_merges,
            row.revisit.as_ref().map_or("-".to_owned(), Revisit::in_table),
            number(row.ate_share.map(|share| 100.0 * share)),
            number(row.drift_deg),
        );
    }
    let mut errors: Vec<f64> = rows.iter().map(|row| row.ate_share.unwrap_or(f64::INFINITY)).collect();
    errors.sort_by(f64::total_cmp);
    println!(
        "\n{} of {} runs cover more than 95 % of the frames, {} are within 2 % of the path; median {:.3} %, worst {:.3} %.",
        rows.iter().filter(|row| row.coverage > 0.95).count(),
        rows.len(),
        errors.iter().filter(|error| **error < 0.02).count(),
        100.0 * errors[errors.len() / 2],
        100.0 * errors[errors.len() - 1],
    );
}

/// Points and lines (LP) beside points, lines and primitives (GP).
pub fn print_comparison(preset: Preset, seeds: &[u64], rows: &[[Row; 2]]) {
    println!("\n| {}, seed | ATE LP | GP | change | drift LP | GP | change |", preset.name());
    println!("| ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    let of = |row: &[Row; 2], value: fn(&Row) -> Option<f64>| {
        let [lp, gp] = [&row[0], &row[1]].map(|row| value(row).unwrap_or(f64::NAN));
        [lp, gp, 100.0 * (gp / lp - 1.0)]
    };
    let columns = |row: &[Row; 2]| {
        let ([a, b, change_a], [c, d, change_c]) =
            (of(row, |row| row.ate_share.map(|share| 100.0 * share)), of(row, |row| row.drift_deg));
        [a, b, change_a, c, d, change_c]
    };
    let print = |name: &str, [a, b, change_a, c, d, change_c]: [f64; 6]| {
        println!(
            "| {name} | {a:.3} % | {b:.3} % | {change_a:+.0} % | {c:.2}° | {d:.2}° | {change_c:+.0} % |"
        );
    };
    let rows: Vec<[f64; 6]> = rows.iter().map(columns).collect();
    for (seed, row) in seeds.iter().zip(&rows) {
        print(&seed.to_string(), *row);
    }
    print("median", std::array::from_fn(|column| median(rows.iter().map(|row| row[column]).collect())));
}

/// The calibration as given beside self-calibration. Where it is true, a change is an error.
pub fn print_calibrations(preset: Preset, seeds: &[u64], rows: &[[Row; 2]]) {
    println!(
        "\n| {}, seed | ATE as given | refined | change | focal length changed by | in standard deviations |",
        preset.name()
    );
    println!("| ---: | ---: | ---: | ---: | ---: | ---: |");
    let (mut changes, mut n_changed, mut worst) = (Vec::new(), 0, 0.0f64);
    for (seed, [given, refined]) in seeds.iter().zip(rows) {
        let [a, b] = [given, refined].map(|row| row.ate_share.map_or(f64::NAN, |share| 100.0 * share));
        changes.push(100.0 * (b / a - 1.0));
        let change = 100.0 * (b / a - 1.0);
        print!("| {seed} | {a:.3} % | {b:.3} % | {change:+.1} % |");
        match refined.camera {
            None => println!(" - | - |"),
            Some([focal, sigma]) => {
                (n_changed, worst) = (n_changed + 1, worst.max((focal / sigma).abs()));
                println!(" {:+.2} % | {:.1} |", 100.0 * focal, (focal / sigma).abs());
            }
        }
    }
    println!(
        "\n{n_changed} of {} calibrations were changed, by at most {worst:.1} standard deviations; ATE changes by {:+.1} % in the \
         median.",
        rows.len(),
        median(changes)
    );
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
}
