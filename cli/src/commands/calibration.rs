//! `monoslam calibration`: the camera of a session as it was found, as a calibration file.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use proto::v1;
use serde_json::json;

use super::{ServerArgs, session_id};

/// Which session, and where to.
#[derive(Debug, Args)]
pub struct CalibrationArgs {
    /// The session
    #[arg(value_name = "NAME", value_parser = session_id)]
    session: String,
    #[command(flatten)]
    server: ServerArgs,
    /// The file to write, as calib.json [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Writes it.
pub async fn run(args: CalibrationArgs) -> Result<()> {
    let found = args.server.connect().await?.session(&args.session).await?;
    let session = found.with_context(|| format!("there is no session `{}`", args.session))?;
    let camera = session.refined_camera.as_ref().or(session.camera.as_ref());
    let text = calibration(camera.context("the server told no camera of the session")?);
    if session.refined_camera.is_none() {
        eprintln!("the camera of `{}` is as it was when the session was made", args.session);
    }
    match args.output {
        None => println!("{text}"),
        Some(path) => {
            std::fs::write(&path, text + "\n").with_context(|| format!("cannot write {}", path.display()))?;
        }
    }
    Ok(())
}

/// A camera as calib.json has it.
pub(super) fn calibration(camera: &v1::Camera) -> String {
    let model = match camera.model() {
        v1::CameraModel::Pinhole | v1::CameraModel::Unspecified => "pinhole",
        v1::CameraModel::Radtan => "radtan",
        v1::CameraModel::KannalaBrandt => "kannala_brandt",
        v1::CameraModel::Fov => "fov",
        v1::CameraModel::ExtendedUnified => "eucm",
        v1::CameraModel::DoubleSphere => "double-sphere",
    };
    let v1::Camera { width, height, fx, fy, cx, cy, distortion, .. } = camera;
    let object = json!({
        "model": model, "width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "dist": distortion,
    });
    format!("{object:#}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_as_the_same_camera() {
        let distortion = vec![-0.2834, 0.0739, 0.0, 0.0];
        let camera = v1::Camera {
            model: v1::CameraModel::Radtan.into(),
            width: 752,
            height: 480,
            fx: 458.654,
            fy: 457.296,
            cx: 367.215,
            cy: 248.375,
            distortion: distortion.clone(),
        };
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("calib.json");
        std::fs::write(&file, calibration(&camera)).unwrap();
        let read = recordings::read_calibration(&file).unwrap();
        assert_eq!(read.parameters().distortion, distortion);
        assert_eq!((read.parameters().fx, read.parameters().cy), (458.654, 248.375));
    }
}
