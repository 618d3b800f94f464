//! The tables of several seeds.

use synthetic::Preset;

/// What became of one sequence, for the table.
pub struct Row {
    /// Share of the frames with a pose in the largest submap.
    pub coverage: f64,
    pub n_submaps: usize,
    pub n_loops: usize,
    pub n_merges: usize,
    /// Of the largest submap; root mean square error as a share of the path.
    pub ate_share: Option<f64>,
    /// Turn from the first frame to the last, degrees.
    pub drift_deg: Option<f64>,
}

/// Every seed, and how many are good.
pub fn print_table(preset: Preset, seeds: &[u64], rows: &[Row]) {
    println!(
        "\n| {}, seed | coverage | submaps | loops | mergers | ATE, % of the path | drift of the attitude, deg |",
        preset.name()
    );
    println!("| ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.3}"));
    for (seed, row) in seeds.iter().zip(rows) {
        println!(
            "| {seed} | {:.3} | {} | {} | {} | {} | {} |",
            row.coverage,
            row.n_submaps,
            row.n_loops,
            row.n_merges,
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

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
}
