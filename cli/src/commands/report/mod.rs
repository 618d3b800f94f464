//! `monoslam report`: everything about a session on one page that needs no server.

mod gather;
mod page;

use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use client::{HttpClient, StreamSummary};
use recordings::{Evaluation, EvaluationOptions, Trajectory, evaluate};
use serde_json::{Value, json};

use super::output::OutputFile;
use super::picture::{self, Graph, Scene, chart};
use super::{ServerArgs, session_id};
use gather::Gathered;
use page::{Page, Plot, Rows};

/// What to report.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// The session
    #[arg(value_name = "NAME", value_parser = session_id)]
    session: String,
    #[command(flatten)]
    server: ServerArgs,
    /// The true trajectory: TUM or EuRoC format
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// What `monoslam stream --json` printed, for the times of the stages
    #[arg(long, value_name = "FILE")]
    summary: Option<PathBuf>,
    /// Keyframes whose pictures are in the page
    #[arg(long, value_name = "N", default_value_t = 12)]
    pictures: usize,
    /// Folder to write the plots into as SVG files as well
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,
    /// File to write [default: NAME.html]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// What is known of a session besides the server.
#[derive(Default)]
pub struct Known {
    /// The true trajectory.
    pub truth: Option<Trajectory>,
    /// What became of the frames.
    pub summary: Option<StreamSummary>,
}

/// Writes it.
pub async fn run(args: ReportArgs) -> Result<()> {
    let truth = args.truth.as_deref().map(Trajectory::read).transpose()?;
    let summary = args.summary.as_deref().map(read_summary).transpose()?;
    let http = args.server.http().await?;
    let report = Report::of(&http, &args.session, Known { truth, summary }, args.pictures).await?;
    let path = args.output.unwrap_or_else(|| PathBuf::from(format!("{}.html", args.session)));
    report.write(&path)?;
    if let Some(folder) = &args.plots {
        report.write_plots(folder)?;
    }
    println!("{}", path.display());
    Ok(())
}

/// The last line of what `stream --json` printed.
fn read_summary(path: &Path) -> Result<StreamSummary> {
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let last = text.lines().rfind(|line| !line.is_empty()).unwrap_or_default();
    serde_json::from_str(last)
        .with_context(|| format!("{} is not what `monoslam stream --json` prints", path.display()))
}

/// A report that is ready to be written.
pub struct Report(Page);

impl Report {
    /// Gathers it.
    ///
    /// # Errors
    /// If the server cannot be asked, or there is nothing to report.
    pub async fn of(http: &HttpClient, session: &str, known: Known, n_pictures: usize) -> Result<Self> {
        let gathered = Gathered::fetch(http, session, n_pictures).await?;
        let evaluation = known.truth.as_ref().and_then(|truth| {
            let n_frames = gathered.session["n_frames"].as_u64().and_then(|n| usize::try_from(n).ok());
            let options = EvaluationOptions { n_frames, ..EvaluationOptions::default() };
            let evaluated = evaluate(truth, &gathered.trajectory, &options);
            evaluated.inspect_err(|error| eprintln!("the trajectory cannot be evaluated: {error}")).ok()
        });
        // Without an evaluation the truth cannot be laid over the map either.
        let truth = known.truth.filter(|_| evaluation.is_some());
        let plots = plots(&gathered, truth, known.summary.as_ref())?;
        let keyframes =
            gathered.images.keys().filter_map(|id| Some((id.parse().ok()?, format!("Keyframe {id}"))));
        let mut keyframes: Vec<(u64, String)> = keyframes.collect();
        keyframes.sort_unstable();
        Ok(Self(Page {
            title: format!("Session {session}"),
            lead: lead(&gathered.session, evaluation.as_ref()),
            tables: tables(&gathered, evaluation.as_ref(), known.summary.as_ref()),
            plots,
            keyframes,
            data: json!({
                "session": gathered.session, "scene": gathered.scene, "edges": gathered.covisibility,
                "images": gathered.images,
            }),
        }))
    }

    /// Writes the page.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut file = OutputFile::create(path)?;
        file.write_all(self.0.html()?.as_bytes())?;
        file.finish()
    }

    fn write_plots(&self, folder: &Path) -> Result<()> {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        for Plot { name, svg, .. } in &self.0.plots {
            let path = folder.join(format!("{name}.svg"));
            fs::write(&path, svg).with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }
}

fn number(session: &Value, field: &str) -> u64 {
    session[field].as_u64().unwrap_or(0)
}

fn lead(session: &Value, evaluation: Option<&Evaluation>) -> String {
    let n = |field| number(session, field);
    let mut text = format!(
        "{} frames, a map of {} keyframes, {} points, {} lines and {} global primitives in {} submaps.",
        n("n_frames"),
        n("n_keyframes"),
        n("n_points"),
        n("n_lines"),
        n("n_primitives"),
        n("n_submaps"),
    );
    if let Some(Evaluation { ate_rmse, path, ate_percent_of_path, .. }) = evaluation {
        let share = ate_percent_of_path.map_or_else(String::new, |share| format!(", {share:.2} %"));
        text.push_str(&format!(" Off the truth by {ate_rmse:.4} (RMS) on a path of {path:.2}{share}."));
    }
    text
}

/// Trajectory from above and from the side, error, states, graph, and times.
fn plots(
    gathered: &Gathered,
    truth: Option<Trajectory>,
    summary: Option<&StreamSummary>,
) -> Result<Vec<Plot>> {
    let mut plots = Vec::new();
    let mut plot = |name, caption: &str, svg| plots.push(Plot { name, caption: caption.to_owned(), svg });
    let (points, lines) = (gathered.points(), gathered.lines());
    let estimate = gathered.trajectory.clone();
    let mut scene = Scene { title: String::new(), truth, estimate, points, lines };
    if !scene.estimate.is_empty() {
        let against = if scene.truth.is_some() { ", the estimate over the truth" } else { "" };
        for (name, from, view) in [
            ("trajectory-above", "from above", picture::Direction::Above),
            ("trajectory-side", "from the side", picture::Direction::Side),
        ] {
            scene.title = format!("Map and path of the camera seen {from}{against}");
            plot(name, &scene.title, scene.draw_from(view)?);
        }
        let graph = Graph {
            title: "Keyframes seen from above: those that share landmarks are joined in green, those that see the \
                    same global primitive in red"
                .to_owned(),
            keyframes: gathered.keyframes(),
            covisible: pairs(&gathered.covisibility),
            tied: pairs(&gathered.ties),
        };
        if let Some(svg) = graph.draw(&scene) {
            plot("graph", &graph.title, svg);
        }
    }
    if let Some(errors) = scene.position_errors() {
        let title = "Distance from the truth along time, after alignment";
        plot("error", title, chart::curve(title, "units of the truth", &errors));
    }
    let states = gathered.states();
    if !states.is_empty() {
        plot("states", "How tracking went, frame by frame", chart::states("States of the frames", &states));
    }
    if let Some(summary) = summary.filter(|summary| !summary.stages.is_empty()) {
        let stages: Vec<(String, f64, f64)> =
            summary.stages.iter().map(|stage| (stage.name.clone(), stage.ms.median, stage.ms.p95)).collect();
        let title = "Time of a frame by stage: median, and pale the 95th percentile";
        plot("stages", title, chart::bars(title, &stages));
    }
    Ok(plots)
}

/// The pairs of a graph, each once although several primitives may tie it.
fn pairs(edges: &Value) -> Vec<[u64; 2]> {
    let edges = edges.as_array().map(Vec::as_slice).unwrap_or_default();
    let pairs = edges.iter().filter_map(|edge| {
        let (from, to) = (edge["from"].as_u64()?, edge["to"].as_u64()?);
        Some([from.min(to), from.max(to)])
    });
    pairs.collect::<BTreeSet<_>>().into_iter().collect()
}

fn tables(
    gathered: &Gathered,
    evaluation: Option<&Evaluation>,
    summary: Option<&StreamSummary>,
) -> Vec<(String, Rows)> {
    let session = &gathered.session;
    let row = |name: &str, value: String| (name.to_owned(), value);
    let count = |name: &str, field| row(name, number(session, field).to_string());
    let map = vec![
        count("frames", "n_frames"),
        row("poses in the trajectory", gathered.trajectory.len().to_string()),
        count("keyframes", "n_keyframes"),
        count("points", "n_points"),
        count("lines", "n_lines"),
        count("global primitives", "n_primitives"),
        count("submaps", "n_submaps"),
        row(
            "scale",
            session["metres_per_unit"]
                .as_f64()
                .map_or("free".to_owned(), |metres| format!("{metres:.4} m a unit")),
        ),
    ];
    let accuracy = evaluation.map_or_else(Vec::new, |e| {
        vec![
            row("coverage", format!("{:.1} %", 100.0 * e.coverage)),
            row("ATE RMSE", format!("{:.5}", e.ate_rmse)),
            row(
                "ATE mean / median / max",
                format!("{:.5} / {:.5} / {:.5}", e.ate_mean, e.ate_median, e.ate_max),
            ),
            row("rotation RMSE", format!("{:.3}°", e.rot_rmse_deg)),
            row("RPE RMSE", format!("{:.5}, {:.3}°", e.rpe_trans_rmse, e.rpe_rot_rmse_deg)),
            row("path", format!("{:.3}", e.path)),
            row("scale of the estimate", format!("{:.5}", e.scale)),
            row("scale drift", e.scale_drift.map_or("-".to_owned(), |drift| format!("{drift:.4}"))),
        ]
    });
    let primitives = gathered.primitives().into_iter().map(|(id, [x, y, z], n_lines, n_keyframes)| {
        row(&format!("{id}: {x:.3} {y:.3} {z:.3}"), format!("{n_lines} lines, {n_keyframes} keyframes"))
    });
    let times = summary.map_or_else(Vec::new, |summary| {
        let distribution = |d: Option<client::Distribution>| {
            d.map_or("-".to_owned(), |d| format!("{:.1} ms, 95 %: {:.1}", d.median, d.p95))
        };
        vec![
            row("frame", distribution(summary.wall_ms)),
            row("tracking, processor", distribution(summary.tracking_cpu_ms)),
            row("frames a second", format!("{:.1}", summary.frames_per_second)),
            row("times real time", format!("{:.2}", summary.realtime_factor)),
        ]
    });
    vec![
        ("Map".to_owned(), map),
        ("Against the truth".to_owned(), accuracy),
        ("Camera".to_owned(), camera(session)),
        ("Global primitives (direction)".to_owned(), primitives.collect()),
        ("Time".to_owned(), times),
    ]
}

/// The calibration as given, and as it was found where that is known.
fn camera(session: &Value) -> Rows {
    let given = &session["camera"];
    let refined = &session["refined_camera"];
    let model = given["model"].as_str().unwrap_or("unknown").to_owned();
    let size = format!("{} x {}", given["width"], given["height"]);
    let mut rows = vec![("model".to_owned(), model), ("image".to_owned(), size)];
    for field in ["fx", "fy", "cx", "cy"] {
        let of = |camera: &Value| camera[field].as_f64();
        let text = match (of(given), of(refined)) {
            (Some(given), Some(refined)) => format!("{given:.2} given, {refined:.2} found"),
            (Some(given), None) => format!("{given:.2} px"),
            _ => continue,
        };
        rows.push((field.to_owned(), text));
    }
    if let Some(distortion) = given["distortion"].as_array().filter(|list| !list.is_empty()) {
        let coefficients: Vec<String> = distortion.iter().map(Value::to_string).collect();
        rows.push(("distortion".to_owned(), coefficients.join(" ")));
    }
    rows
}
