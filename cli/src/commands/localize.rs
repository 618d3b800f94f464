//! `monoslam localize`: where images were taken.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use client::camera_message;
use proto::v1;
use recordings::read_calibration;
use serde_json::json;

use super::{ServerArgs, positive, session_id};

/// The word for a camera nobody knows.
const UNKNOWN: &str = "unknown";

/// Which images, and where to look.
#[derive(Debug, Args)]
pub struct LocalizeArgs {
    /// Image files
    #[arg(value_name = "IMAGE", required = true)]
    images: Vec<PathBuf>,
    /// The session; several may be named, and the answer is of the one that fits best [default: all]
    #[arg(long, value_name = "NAME", value_parser = session_id)]
    session: Vec<String>,
    #[command(flatten)]
    server: ServerArgs,
    /// Calibration of the images' camera, a file like calib.json, or `unknown` [default: the session's camera
    /// for images of its size, else unknown]
    #[arg(long, value_name = "FILE", conflicts_with = "fov")]
    camera: Option<PathBuf>,
    /// Field of view across the longer side of the images, degrees
    #[arg(long, value_name = "DEG", value_parser = positive)]
    fov: Option<f64>,
    /// Where the camera is thought to be, as lengths of the session are told
    #[arg(long, value_name = "X,Y,Z", value_parser = position, requires = "radius", allow_hyphen_values = true)]
    near: Option<v1::Vector3>,
    /// How far it may be from there
    #[arg(long, value_name = "R", value_parser = positive, requires = "near")]
    radius: Option<f64>,
    /// Print one JSON object for each image
    #[arg(long)]
    json: bool,
}

/// Locates them.
pub async fn run(args: LocalizeArgs) -> Result<()> {
    let mut client = args.server.connect().await?;
    let is_unknown = args.camera.as_ref().is_some_and(|camera| camera.as_os_str() == UNKNOWN);
    let camera = match args.camera.as_ref().filter(|_| !is_unknown) {
        Some(path) => Some(camera_message(read_calibration(path)?.parameters())),
        None => None,
    };
    let (session_id, session_ids) = match &args.session[..] {
        [only] => (only.clone(), Vec::new()),
        several => (String::new(), several.to_vec()),
    };
    let mut n_found = 0;
    for path in &args.images {
        let data = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let request = v1::LocalizeRequest {
            session_id: session_id.clone(),
            session_ids: session_ids.clone(),
            all_sessions: args.session.is_empty(),
            image: Some(v1::Image { data: data.into(), ..v1::Image::default() }),
            camera: camera.clone(),
            fov_deg: args.fov,
            unknown_camera: is_unknown,
            near: args.near,
            radius: args.radius,
        };
        let located = client.localize_with(request).await.with_context(|| path.display().to_string())?;
        n_found += usize::from(located.pose_world_from_camera.is_some());
        let name = path.display().to_string();
        println!("{}", if args.json { as_json(&name, &located).to_string() } else { told(&name, &located) });
    }
    ensure!(n_found > 0, "none of the images was located");
    Ok(())
}

fn told(name: &str, located: &v1::LocalizeResponse) -> String {
    let Some(pose) = &located.pose_world_from_camera else {
        return format!("{name}: not located: {}", located.reason);
    };
    let unit = if located.scale() == v1::ScaleKind::Metric { " m" } else { "" };
    let (n, session) = (located.n_inlier_points + located.n_inlier_lines, &located.session_id);
    let v1::Pose { tx, ty, tz, qx, qy, qz, qw } = *pose;
    format!(
        "{name}: in {session} at ({tx:.4}, {ty:.4}, {tz:.4}){unit}, quaternion ({qx:.5}, {qy:.5}, {qz:.5}, {qw:.5}), by {n} \
         landmarks"
    )
}

fn as_json(name: &str, located: &v1::LocalizeResponse) -> serde_json::Value {
    let pose = located.pose_world_from_camera.as_ref().map(|pose| {
        json!({
            "tx": pose.tx, "ty": pose.ty, "tz": pose.tz,
            "qx": pose.qx, "qy": pose.qy, "qz": pose.qz, "qw": pose.qw,
        })
    });
    let camera = located.camera.as_ref().map(
        |c| json!({ "width": c.width, "height": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy }),
    );
    json!({
        "image": name, "session_id": Some(&located.session_id).filter(|id| !id.is_empty()),
        "state": located.state().as_str_name().trim_start_matches("TRACKING_STATE_").to_lowercase(),
        "reason": located.reason, "world_from_camera": pose, "covariance": located.covariance,
        "metric": located.scale() == v1::ScaleKind::Metric, "submap_id": located.submap_id,
        "n_inlier_points": located.n_inlier_points, "n_inlier_lines": located.n_inlier_lines, "camera": camera,
        "n_sessions_searched": located.n_sessions_searched, "n_sessions_tried": located.n_sessions_tried,
        "load_ms": located.load_ms, "locate_ms": located.locate_ms,
    })
}

fn position(text: &str) -> Result<v1::Vector3, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok([x, y, z]) if [x, y, z].iter().all(|number| number.is_finite()) => {
            Ok(v1::Vector3 { x: *x, y: *y, z: *z })
        }
        _ => Err("three numbers with commas between expected".to_owned()),
    }
}
