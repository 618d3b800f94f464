//! Operations: the table of metrics is what the server exports, dashboard and alerts ask for nothing else,
//! and every alert is explained.

use super::files;
use server::measures::{Kind, MEASURES, Measure};
use std::collections::BTreeSet;
use std::path::Path;

const BEGIN: &str = "<!-- Made by `cargo test -p tests --test repository`, UPDATE_GENERATED=1. -->\n";
const END: &str = "\n<!-- End. -->";

fn read(path: &str) -> String {
    let path = files::root().join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Words of a text that are names of metrics, by how they begin.
fn names_in(text: &str) -> BTreeSet<&str> {
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let words = text.split(|c: char| !is_part(c));
    words.filter(|word| ["monoslam_", "process_"].iter().any(|begin| word.starts_with(begin))).collect()
}

fn row(measure: &Measure) -> String {
    let Measure { name, kind, help, label } = measure;
    let kind = match kind {
        Kind::Counter => "counter",
        Kind::Gauge => "gauge",
        Kind::Histogram => "histogram",
    };
    let labels = label.map_or(String::new(), |(label, values)| match values {
        [] => label.to_owned(),
        values => format!("{label}: {}", values.join(", ")),
    });
    format!("| `{name}` | {kind} | {help} | {labels} |\n")
}

#[test]
fn the_table_of_metrics_is_of_what_is_exported() {
    let table: String = MEASURES.iter().map(row).collect();
    let table = format!("| metric | kind | is | labels |\n| --- | --- | --- | --- |\n{table}");
    let document = read("docs/operations.md");
    let (before, rest) = document.split_once(BEGIN).expect("the table's begin is marked");
    let (found, after) = rest.split_once(END).expect("the table's end is marked");
    if std::env::var_os("UPDATE_GENERATED").is_some() {
        let made = format!("{before}{BEGIN}{table}{END}{after}");
        std::fs::write(files::root().join("docs/operations.md"), made).unwrap();
        return;
    }
    assert_eq!(found, table, "UPDATE_GENERATED=1 makes it anew");
}

#[test]
fn every_metric_is_described_and_every_described_one_is_measured() {
    let described: BTreeSet<&str> = MEASURES.iter().map(|measure| measure.name).collect();
    let mut measured = BTreeSet::new();
    let sources = files::with_extension("rs");
    let of_server = |path: &Path| path.starts_with("server/src") && !path.ends_with("measures.rs");
    for source in sources.iter().filter(|source| of_server(&source.path)) {
        for text in source.text.split("metrics::").skip(1) {
            let called =
                ["counter!(\"", "gauge!(\"", "histogram!(\""].iter().find_map(|call| text.strip_prefix(call));
            measured.extend(called.and_then(|rest| rest.split('"').next()));
        }
    }
    assert!(measured.len() > 15, "the search is broken: {measured:?}");
    assert_eq!(measured, described, "server/src/measures.rs has a list of them");
}

#[test]
fn dashboard_and_alerts_ask_for_what_there_is() {
    let known = |name: &str| {
        let of_histogram = |name: &str| MEASURES.iter().any(|m| m.name == name && m.kind == Kind::Histogram);
        let of_other = |name: &str| MEASURES.iter().any(|m| m.name == name && m.kind != Kind::Histogram);
        of_other(name)
            || ["_bucket", "_sum", "_count"]
                .iter()
                .any(|end| name.strip_suffix(end).is_some_and(of_histogram))
    };
    for file in ["deploy/grafana/monoslam.json", "deploy/prometheus/alerts.yml"] {
        let text = read(file);
        let names = names_in(&text);
        assert!(names.len() > 8, "{file}: {names:?}");
        let unknown: Vec<_> = names.iter().filter(|name| !known(name)).collect();
        assert!(unknown.is_empty(), "{file} asks for what the server does not export: {unknown:?}");
    }
    let dashboard: serde_json::Value = serde_json::from_str(&read("deploy/grafana/monoslam.json")).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    let of_row = |panel: &serde_json::Value| panel["type"] == "row";
    assert!(
        panels.iter().all(|panel| of_row(panel) || !panel["targets"][0]["expr"].is_null()),
        "a panel is empty"
    );
}

#[test]
fn every_alert_is_explained() {
    let (alerts, document) = (read("deploy/prometheus/alerts.yml"), read("docs/operations.md"));
    let names: Vec<&str> = alerts.lines().filter_map(|line| line.trim().strip_prefix("- alert: ")).collect();
    assert!(names.len() > 10, "{names:?}");
    for name in &names {
        assert!(document.contains(&format!("| `{name}` |")), "docs/operations.md does not explain {name}");
    }
    let n_explained = document.lines().filter(|line| line.starts_with("| `Monoslam")).count();
    assert_eq!(n_explained, names.len(), "an alert is explained that is not there");
    for part in ["expr:", "severity:", "summary:"] {
        assert_eq!(alerts.matches(part).count(), names.len(), "an alert has no {part}");
    }
}
