//! `monoslam export`: saves the map of a session as files of other programs.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use client::{HttpClient, MapFormat};

use super::output::OutputFile;
use super::progress::{ByteBar, StepBar};
use super::{ServerArgs, session_id};

/// What to save and how.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// The session
    #[arg(value_name = "NAME", value_parser = session_id)]
    session: String,
    #[command(flatten)]
    server: ServerArgs,
    /// How the map is written
    #[arg(long, value_enum)]
    format: Format,
    /// This submap only [default: the largest; in JSON all of them]
    #[arg(long, value_name = "N")]
    submap: Option<u32>,
    /// File to write, or folder for colmap and nerfstudio [default: named after the session]
    #[arg(short, long, value_name = "PATH")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Points and lines as a polygon file, for MeshLab, CloudCompare, Blender
    Ply,
    /// Everything as one object
    Json,
    /// Points, lines, poses and images, for Foxglove
    Mcap,
    /// A folder with COLMAP's text model in sparse/0 and the keyframes' images
    Colmap,
    /// A folder with transforms.json, points and the keyframes' images, for nerfstudio and Gaussian splats
    Nerfstudio,
}

/// Saves it.
pub async fn run(args: ExportArgs) -> Result<()> {
    let export = Export { http: args.server.http().await?, session: &args.session, submap: args.submap };
    let default = match args.format {
        Format::Ply => format!("{}.ply", args.session),
        Format::Json => format!("{}.json", args.session),
        Format::Mcap => format!("{}.mcap", args.session),
        Format::Colmap => format!("{}-colmap", args.session),
        Format::Nerfstudio => format!("{}-nerfstudio", args.session),
    };
    let path = args.output.unwrap_or_else(|| PathBuf::from(default));
    match args.format {
        Format::Ply => export.file(MapFormat::Ply, &path).await?,
        Format::Json => export.file(MapFormat::Json, &path).await?,
        Format::Mcap => export.file(MapFormat::Mcap, &path).await?,
        Format::Colmap => export.colmap(&path).await?,
        Format::Nerfstudio => export.nerfstudio(&path).await?,
    }
    println!("{}", path.display());
    Ok(())
}

/// Where the map is.
struct Export<'a> {
    http: HttpClient,
    session: &'a str,
    submap: Option<u32>,
}

impl Export<'_> {
    async fn file(&self, format: MapFormat, path: &Path) -> Result<()> {
        let mut file = OutputFile::create(path)?;
        let mut bar = ByteBar::new(&path.display().to_string());
        let observe = |n_bytes, of| bar.show(n_bytes, of);
        let written = self.http.write_map(self.session, format, self.submap, &mut file, observe).await;
        written.with_context(|| format!("cannot fetch the map into {}", path.display()))?;
        file.finish()
    }

    async fn colmap(&self, folder: &Path) -> Result<()> {
        let model = folder.join("sparse/0");
        make(&model)?;
        self.file(MapFormat::ColmapCameras, &model.join("cameras.txt")).await?;
        self.file(MapFormat::ColmapImages, &model.join("images.txt")).await?;
        self.file(MapFormat::ColmapPoints, &model.join("points3D.txt")).await?;
        let images = fs::read_to_string(model.join("images.txt"))?;
        self.images(folder, names_of_model(&images)).await
    }

    async fn nerfstudio(&self, folder: &Path) -> Result<()> {
        make(folder)?;
        let transforms = folder.join("transforms.json");
        self.file(MapFormat::Transforms, &transforms).await?;
        self.file(MapFormat::Ply, &folder.join("sparse_pc.ply")).await?;
        let names = names_of_transforms(&fs::read_to_string(&transforms)?)?;
        self.images(folder, names).await
    }

    /// Fetches the images of these names into a folder of their own.
    async fn images(&self, folder: &Path, names: Vec<String>) -> Result<()> {
        let images = folder.join("images");
        make(&images)?;
        let bar = StepBar::new("images", names.len());
        for name in names {
            let keyframe_id =
                keyframe_of(&name).with_context(|| format!("`{name}` is no keyframe's image"))?;
            let image = self.http.keyframe_image(self.session, keyframe_id).await?;
            let mut file = OutputFile::create(&images.join(&name))?;
            file.write_all(&image.bytes)?;
            file.finish()?;
            bar.advance();
        }
        Ok(())
    }
}

fn make(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))
}

/// The images in `images.txt` that were kept: the others have no extension. Of each two lines the first ends
/// with the name.
fn names_of_model(text: &str) -> Vec<String> {
    let lines = text.lines().filter(|line| !line.starts_with('#')).step_by(2);
    let names = lines.filter_map(|line| line.rsplit(' ').next());
    names.filter(|name| name.contains('.')).map(str::to_owned).collect()
}

fn names_of_transforms(text: &str) -> Result<Vec<String>> {
    let transforms: serde_json::Value = serde_json::from_str(text)?;
    let frames = transforms["frames"].as_array().context("there are no frames in transforms.json")?;
    let path =
        |frame: &serde_json::Value| frame["file_path"].as_str()?.strip_prefix("images/").map(str::to_owned);
    let names: Vec<String> = frames.iter().filter_map(path).collect();
    ensure!(
        !names.is_empty(),
        "no image of this session was kept, and without images transforms.json is of no use"
    );
    Ok(names)
}

/// The keyframe of `keyframe_000012.jpg`, a name that leads to no other folder.
fn keyframe_of(name: &str) -> Option<u64> {
    let (number, extension) = name.strip_prefix("keyframe_")?.split_once('.')?;
    extension.chars().all(|c| c.is_ascii_alphanumeric()).then(|| number.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_found_by_their_names() {
        let model = "# Image list\n1 1 0 0 0 0 0 0 1 keyframe_000001.jpg\n10 20 -1\n\
                     2 1 0 0 0 0 0 0 1 keyframe_000002\n\n3 1 0 0 0 0 0 0 1 keyframe_000012.png\n\n";
        assert_eq!(names_of_model(model), ["keyframe_000001.jpg", "keyframe_000012.png"]);
        assert_eq!(keyframe_of("keyframe_000012.png"), Some(12));
        assert_eq!(keyframe_of("../keyframe_000012.png"), None);
        assert_eq!(keyframe_of("keyframe_000012.png/../../x"), None);
        let transforms = r#"{"frames": [{"file_path": "images/keyframe_000001.jpg"}]}"#;
        assert_eq!(names_of_transforms(transforms).unwrap(), ["keyframe_000001.jpg"]);
        assert!(names_of_transforms(r#"{"frames": []}"#).is_err());
    }
}
