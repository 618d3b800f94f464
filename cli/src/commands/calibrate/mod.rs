//! `monoslam calibrate`: a camera from pictures of a chessboard.

mod pictures;
mod plot;

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use calibration::{
    Board, Calibrated, CalibrationConfig, DetectionConfig, Verdict, View, calibrate, find_board,
};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use geometry::CameraModel;
use serde_json::json;
use vision::GrayImage;

use super::calibration::calibration;
use super::positive;
use pictures::Pictures;

/// Views of a video closer to each other than this show the same once more, share of the image's width.
const MIN_MOVED_SHARE: f64 = 0.04;
/// Views beyond which more bring nothing but time.
const MAX_VIEWS: usize = 80;

/// What to calibrate by.
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    /// Pictures of the board, folders of them, or a video
    #[arg(value_name = "SOURCE", required = true)]
    sources: Vec<PathBuf>,
    /// Inner corners of the chessboard, where four squares meet, along its two sides
    #[arg(long, value_name = "CxR", default_value = "9x6", value_parser = board_size)]
    board: (usize, usize),
    /// Side of a square, meters: it changes nothing but how far away the boards are said to be
    #[arg(long, value_name = "M", default_value = "0.025", value_parser = positive)]
    square: f64,
    /// The lens: radtan for most cameras, kannala-brandt for fisheyes
    #[arg(long, value_name = "MODEL", default_value = "radtan", value_parser = model())]
    model: CameraModel,
    /// Radial-tangential distortion with k3, for views with boards up to the very edge of the image
    #[arg(long)]
    k3: bool,
    /// Of a video, look at every so many frames [default: three a second]
    #[arg(long, value_name = "N")]
    every: Option<usize>,
    /// The calibration to write
    #[arg(short, long, value_name = "FILE", default_value = "calib.json")]
    output: PathBuf,
    /// Draw the errors and where boards were seen into an SVG file
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// A family of lenses by its name.
fn model() -> impl TypedValueParser<Value = CameraModel> {
    PossibleValuesParser::new(CameraModel::ALL.map(CameraModel::name)).try_map(|name: String| {
        CameraModel::ALL.into_iter().find(|model| model.name() == name).ok_or("not a family of lenses")
    })
}

fn board_size(text: &str) -> Result<(usize, usize), String> {
    let sides = text.split_once('x').and_then(|(c, r)| Some((c.parse().ok()?, r.parse().ok()?)));
    let (columns, rows) = sides.ok_or_else(|| "inner corners such as 9x6 expected".to_owned())?;
    Board::new(columns, rows, 1.0).map_err(|refused| refused.to_string())?;
    Ok((columns, rows))
}

/// The views of a board in pictures of one size.
struct Found {
    size: (u32, u32),
    views: Vec<View>,
    /// Of which picture each is.
    names: Vec<String>,
    /// The pictures without a whole board.
    without: Vec<String>,
}

/// Calibrates.
pub fn run(args: &CalibrateArgs) -> Result<()> {
    let board = Board::new(args.board.0, args.board.1, args.square)?;
    let found = find_views(args, &board)?;
    let (n, n_without) = (found.views.len(), found.without.len());
    eprintln!(
        "the board of {}x{} corners was found in {n} of {} pictures",
        args.board.0,
        args.board.1,
        n + n_without
    );
    ensure!(
        n > 0,
        "no picture shows the whole board of {}x{} inner corners: count corners where four squares meet, leave a white \
         margin around the board, and keep all of it in the picture",
        args.board.0,
        args.board.1
    );
    let config = CalibrationConfig { model: args.model, with_k3: args.k3, ..CalibrationConfig::default() };
    let calibrated = calibrate(&board, &found.views, found.size, &config)?;
    let text = calibration(&client::camera_message(&calibrated.camera));
    std::fs::write(&args.output, text + "\n")
        .with_context(|| format!("cannot write {}", args.output.display()))?;
    if let Some(path) = &args.plot {
        std::fs::write(path, plot::draw(&calibrated))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    if args.json {
        println!("{}", summary(&calibrated, &found));
    } else {
        print(&calibrated, &found);
        println!("written to {}", args.output.display());
    }
    Ok(())
}

fn find_views(args: &CalibrateArgs, board: &Board) -> Result<Found> {
    let mut found = Found { size: (0, 0), views: Vec::new(), names: Vec::new(), without: Vec::new() };
    let mut pictures = Pictures::of(&args.sources, args.every);
    while let Some((name, image)) = pictures.next_picture()? {
        let size = (image.width(), image.height());
        if found.size == (0, 0) {
            found.size = size;
        }
        ensure!(
            size == found.size,
            "{name} has {}x{} pixels, the first picture {}x{}: all must be taken with the same camera and settings",
            size.0,
            size.1,
            found.size.0,
            found.size.1
        );
        add_view(&mut found, name, &image, board, pictures.is_video());
        if found.views.len() >= MAX_VIEWS {
            eprintln!("{MAX_VIEWS} views are enough; the rest is not looked at");
            break;
        }
    }
    Ok(found)
}

fn add_view(found: &mut Found, name: String, image: &GrayImage, board: &Board, is_video: bool) {
    let Some(view) = find_board(image, board, &DetectionConfig::default()) else {
        found.without.push(name);
        return;
    };
    // Of a video only what shows something else than before.
    let is_near = |other: &View| {
        let moved = view.corners.iter().zip(&other.corners).map(|(a, b)| (a - b).norm());
        moved.fold(0.0, f64::max) < MIN_MOVED_SHARE * f64::from(image.width())
    };
    if is_video && found.views.iter().any(is_near) {
        return;
    }
    found.views.push(view);
    found.names.push(name);
}

/// Names of `fx fy cx cy` and the coefficients.
fn names(model: CameraModel) -> Vec<&'static str> {
    let coefficients = match model {
        CameraModel::Radtan => &["k1", "k2", "p1", "p2", "k3"][..],
        CameraModel::KannalaBrandt => &["k1", "k2", "k3", "k4"],
        CameraModel::Fov => &["omega"],
        CameraModel::ExtendedUnified => &["alpha", "beta"],
        CameraModel::DoubleSphere => &["xi", "alpha"],
        CameraModel::Pinhole => &[],
    };
    ["fx", "fy", "cx", "cy"].into_iter().chain(coefficients.iter().copied()).collect()
}

/// Each number with its name and standard deviation.
fn numbers(calibrated: &Calibrated) -> Vec<(&'static str, f64, f64)> {
    let camera = &calibrated.camera;
    let values =
        [camera.fx, camera.fy, camera.cx, camera.cy].into_iter().chain(camera.distortion.iter().copied());
    names(camera.model)
        .into_iter()
        .zip(values.zip(&calibrated.sigmas))
        .map(|(name, (value, sigma))| (name, value, *sigma))
        .collect()
}

fn verdict(calibrated: &Calibrated) -> &'static str {
    match calibrated.verdict() {
        Verdict::Good => "good",
        Verdict::Usable => "usable",
        Verdict::Poor => "poor",
    }
}

fn print(calibrated: &Calibrated, found: &Found) {
    let camera = &calibrated.camera;
    println!("{} {}x{}", camera.model.name(), camera.width, camera.height);
    for (name, value, sigma) in numbers(calibrated) {
        let digits = if value.abs() >= 10.0 { 2 } else { 5 };
        println!("  {name:5} {value:10.digits$} ± {sigma:.digits$}");
    }
    println!("  view                              rms px  worst px  tilt deg");
    for view in &calibrated.views {
        let worst = view.residuals.iter().map(|residual| residual.norm()).fold(0.0, f64::max);
        let tilt = view.pose.rotation_matrix()[(2, 2)].clamp(-1.0, 1.0).acos().to_degrees();
        let left_out = if view.is_used { "" } else { "  left out" };
        let name = found.names.get(view.idx).map_or("", String::as_str);
        println!("  {name:32} {:7.3} {worst:9.3} {tilt:9.0}{left_out}", view.rms_px());
    }
    println!(
        "errors {:.3} px; boards cover {:.0} % of the image, tilted by up to {:.0} degrees against each other",
        calibrated.rms_px,
        100.0 * calibrated.coverage,
        calibrated.tilt_deg
    );
    println!("verdict: {}", verdict(calibrated));
    for finding in &calibrated.findings {
        println!("- {finding}");
    }
}

fn summary(calibrated: &Calibrated, found: &Found) -> serde_json::Value {
    let named = numbers(calibrated);
    let values: serde_json::Map<String, serde_json::Value> =
        named.iter().map(|(name, value, _)| ((*name).to_owned(), json!(value))).collect();
    let sigmas: serde_json::Map<String, serde_json::Value> =
        named.iter().map(|(name, _, sigma)| ((*name).to_owned(), json!(sigma))).collect();
    let views = calibrated.views.iter().map(
        |view| json!({"picture": found.names.get(view.idx), "rms_px": view.rms_px(), "used": view.is_used}),
    );
    json!({
        "model": calibrated.camera.model.name(), "camera": values, "sigmas": sigmas, "rms_px": calibrated.rms_px,
        "coverage": calibrated.coverage, "tilt_deg": calibrated.tilt_deg, "verdict": verdict(calibrated),
        "findings": calibrated.findings.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "views": views.collect::<Vec<_>>(), "without_board": found.without,
    })
}
