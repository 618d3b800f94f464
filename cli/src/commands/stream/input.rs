//! What is streamed: a folder, a video, a camera or a pipe, and the calibration of the camera that took it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::Args;
use client::{FrameSource, Sequential};
use geometry::{Camera, CameraModel, CameraParameters};
use recordings::{
    Bag, CameraOfSize, Ffmpeg, FileError, FrameImage, FrameReader, FrameTimes, GrayReader, Layout,
    OpenOptions, Recording, TimeUnit, VideoInput, find_folder, read_calibration, read_pipe,
};
use vision::decode::{DecodeLimits, decode_alpha};

/// The word for a camera whose calibration nobody knows.
const UNKNOWN: &str = "unknown";
/// Across the longer side: what stands in for the calibration of a folder until the session finds it. Nothing
/// is computed with it.
const STAND_IN_FOV_DEG: f64 = 65.0;

/// The picture, beside a recording or a video, of what of its images is not to be used.
const MASK: &str = "mask.png";

/// The calibration beside a video.
const CALIBRATION: &str = "calib.json";

/// What to stream.
#[derive(Debug, Args)]
pub struct InputArgs {
    /// A recording's folder, also looked for in the folder that MONOSLAM_DATA names; an MCAP file or ROS 1
    /// bag; a video; a camera such as /dev/video0, or its address; or - for JPEG images, a video, or gray
    /// pixels on standard input
    #[arg(value_name = "SOURCE", required_unless_present = "camera")]
    source: Option<PathBuf>,
    /// Calibration of the camera, a file like calib.json, or `unknown` [default: what the recording brings,
    /// or calib.json beside a video]. Without a SOURCE, the camera to stream from, such as /dev/video0
    #[arg(long, value_name = "FILE|DEVICE")]
    camera: Option<PathBuf>,
    /// Calibration of the camera, a file like calib.json, or `unknown`, where --camera names the device
    #[arg(long, value_name = "FILE", conflicts_with = "fov")]
    calibration: Option<PathBuf>,
    /// Field of view across the longer side of the images, degrees, of a camera without a calibration
    #[arg(long, value_name = "DEG", value_parser = field_of_view)]
    fov: Option<f64>,
    /// Standard input is gray pixels, a byte each, in images of this size
    #[arg(long, value_name = "WxH", value_parser = image_size)]
    raw: Option<(u32, u32)>,
    /// A picture of the size of the images, dark where nothing of them is to be used, such as a border or a
    /// bonnet [default: mask.png beside the recording; else that is found while the camera moves]
    #[arg(long, value_name = "FILE")]
    mask: Option<PathBuf>,
    /// Topic of the images in an MCAP file or bag [default: the only one]
    #[arg(long, value_name = "TOPIC")]
    topic: Option<String>,
    /// Layout of a recording's folder: folder, euroc, kitti, tum, icl, 7scenes, scannet or pictures [default:
    /// recognized]
    #[arg(long, value_name = "L")]
    layout: Option<Layout>,
    /// Unit of the times in a recording's list: s, ms, us, ns, or frames (numbers of frames, which come --fps
    /// a second) [default: told by their size and rate]
    #[arg(long, value_name = "UNIT")]
    times: Option<TimeUnit>,
    /// Bring a recording's list into the order of time
    #[arg(long)]
    sort: bool,
    /// Where the clock of a camera, video or bag goes back, go on a second behind the last frame, instead of
    /// having what follows refused
    #[arg(long)]
    continue_times: bool,
    /// Leave out lines of a recording's list that cannot be used: without an image, without a time, out of
    /// order
    #[arg(long)]
    skip_bad: bool,
}

/// An opened source.
pub struct Input {
    /// What messages call it.
    pub name: String,
    /// Its frames.
    pub source: Arc<dyn FrameSource>,
    /// The camera that took them.
    pub camera: CameraParameters,
    /// Whether its focal length is known roughly, by a field of view.
    pub is_approximate: bool,
    /// The file of a picture that is dark where nothing of its images is to be used.
    pub mask: Option<Vec<u8>>,
    /// Whether the times of its frames were made from the rate that was given.
    pub is_timed_by_rate: bool,
    /// The source, if it is read in turn.
    sequential: Option<Arc<Sequential>>,
}

impl Input {
    /// What was wrong without keeping frames from being read.
    pub fn remark(&self) -> Option<String> {
        self.sequential.as_ref()?.remark()
    }

    /// Makes an interrupt from the keyboard end a camera's stream in order; a second one ends the program.
    pub fn stop_on_interrupt(&self) {
        let Some(camera) = self.sequential.clone().filter(|source| source.is_live()) else { return };
        tokio::spawn(async move {
            if tokio::signal::ctrl_c().await.is_ok() {
                eprintln!("ending the stream; once more to end at once");
                camera.stop();
                let _ = tokio::signal::ctrl_c().await;
                std::process::exit(130);
            }
        });
    }
}

/// Opens what the arguments name. `fps` is the rate of images that come without times.
pub fn open(args: &InputArgs, fps: Option<f64>) -> Result<Input> {
    let mut input = open_any(args, fps)?;
    input.is_approximate = args.fov.is_some();
    input.mask = mask(args)?.or_else(|| transparent_first(&*input.source));
    let warnings = if server::is_of_size_alone(&input.camera) {
        Vec::new()
    } else {
        server::camera_warnings(&input.camera)
    };
    for warning in warnings {
        eprintln!("{}: {warning}", input.name);
    }
    Ok(input)
}

/// The mask that is given, or lies beside the recording.
fn mask(args: &InputArgs) -> Result<Option<Vec<u8>>> {
    let beside = || {
        let source = args.source.as_deref()?;
        let folder = if is_folder(source) { find_folder(source).ok()? } else { source.parent()?.to_owned() };
        Some(folder.join(MASK)).filter(|path| path.is_file())
    };
    let Some(path) = args.mask.clone().or_else(beside) else { return Ok(None) };
    let file = std::fs::read(&path).with_context(|| format!("{}", path.display()))?;
    Ok(Some(file))
}

/// The file of the first image, if some of it is transparent: of a camera whose images were cut out.
fn transparent_first(source: &dyn FrameSource) -> Option<Vec<u8>> {
    if source.is_live() {
        return None;
    }
    let image = source.frame(0).ok()??.image;
    decode_alpha(&image.data, &DecodeLimits::default()).map(|_| image.data.to_vec())
}

fn open_any(args: &InputArgs, fps: Option<f64>) -> Result<Input> {
    let (path, calibration) = match (&args.source, &args.camera) {
        (Some(source), camera) => {
            ensure!(
                camera.is_none() || args.calibration.is_none(),
                "--camera and --calibration both give a calibration; one will do"
            );
            (source, camera.as_ref().or(args.calibration.as_ref()))
        }
        (None, Some(device)) => (device, args.calibration.as_ref()),
        (None, None) => bail!("nothing to stream is named"),
    };
    ensure!(args.raw.is_none() || path == Path::new("-"), "--raw is for images on standard input (-)");
    if is_folder(path) {
        return open_folder(path, args, fps, calibration.map(PathBuf::as_path));
    }
    let name = name(path);
    let is_bag = Bag::is_bag(path);
    ensure!(args.topic.is_none() || is_bag, "--topic is for MCAP files and bags, and {name} is none");
    let bag = if is_bag { Some(Bag::open(path, args.topic.as_deref())?) } else { None };
    let recorded = match &bag {
        Some(bag) if calibration.is_none() && args.fov.is_none() => bag.camera()?,
        _ => None,
    };
    let recorded = recorded.map(|camera| camera.parameters().clone());
    let sequential = match bag {
        Some(bag) => open_bag(bag)?,
        None => open_sequential(path, args, fps)?,
    };
    let sequential =
        Arc::new(if args.continue_times { sequential.with_continued_times() } else { sequential });
    let size = first_size(&sequential, &name)?;
    let given = Given { file: calibration.map(PathBuf::as_path), fov_deg: args.fov, recorded };
    let camera = given.camera(path, &name, size)?;
    let is_timed_by_rate = false;
    Ok(Input {
        name,
        source: sequential.clone(),
        camera,
        is_approximate: false,
        mask: None,
        is_timed_by_rate,
        sequential: Some(sequential),
    })
}

/// Whether the path is not one of the sources that are read in turn.
fn is_folder(path: &Path) -> bool {
    let is_sequential = path == Path::new("-") || is_address(path) || (path.exists() && !path.is_dir());
    !is_sequential
}

fn open_folder(path: &Path, args: &InputArgs, fps: Option<f64>, calibration: Option<&Path>) -> Result<Input> {
    let folder = find_folder(path)?;
    let name = name(path);
    let is_given = calibration.is_some() || args.fov.is_some();
    let is_nobodys = !is_given && brings_no_calibration(&folder);
    let is_unknown = is_nobodys || calibration == Some(Path::new(UNKNOWN));
    let camera_of_size = |(width, height): (u32, u32)| -> Result<Camera, FileError> {
        let given = Given { file: calibration, fov_deg: args.fov, recorded: None };
        let refused =
            |error: anyhow::Error| FileError::Content { path: folder.clone(), message: format!("{error:#}") };
        let camera = if is_unknown {
            CameraParameters::of_field_of_view(width, height, STAND_IN_FOV_DEG)
        } else {
            given.camera(&folder.join("images"), &name, (width, height)).map_err(refused)?
        };
        Camera::new(camera).map_err(|error| refused(error.into()))
    };
    let options = OpenOptions {
        layout: args.layout,
        fps,
        times: args.times,
        sort: args.sort,
        skip_bad: args.skip_bad,
        camera: (is_given || is_nobodys).then_some(&camera_of_size as CameraOfSize<'_>),
    };
    let recording = Recording::open_with(&folder, &options)?;
    for remark in &recording.remarks {
        eprintln!("{remark}");
    }
    if is_nobodys {
        eprintln!(
            "{name} has no {CALIBRATION}: its camera is found as the map grows; --camera FILE gives a calibration, \
             --fov DEG a field of view"
        );
    }
    let camera = recording.camera.parameters().clone();
    let camera = if is_unknown { of_size(camera.width, camera.height) } else { camera };
    let is_timed_by_rate = recording.layout == Layout::Pictures || args.times == Some(TimeUnit::Frames);
    let name = recording.name.clone();
    Ok(Input {
        name,
        source: Arc::new(recording),
        camera,
        is_approximate: false,
        mask: None,
        is_timed_by_rate,
        sequential: None,
    })
}

/// Whether a folder is one of pictures whose camera nobody has described: other layouts bring calibrations or
/// have published ones.
fn brings_no_calibration(folder: &Path) -> bool {
    let is_there = |name: &str| folder.join(name).exists();
    let known = [CALIBRATION, "calib.txt", "mav0", "cam0", "intrinsic", "associations.txt", "cameras.txt"];
    let is_published = Recording::open(folder, None).is_ok();
    !known.into_iter().any(is_there) && !is_published
}

fn open_bag(bag: Bag) -> Result<Sequential> {
    let n_images = bag.n_images();
    let open = move || Ok(Box::new(bag.frames()?) as Box<dyn FrameReader>);
    Ok(Sequential::new(open)?.of_length(n_images))
}

fn open_sequential(path: &Path, args: &InputArgs, fps: Option<f64>) -> Result<Sequential> {
    if path == Path::new("-") {
        let times = fps.map_or(FrameTimes::Arrival, FrameTimes::PerSecond);
        let stdin = Box::new(std::io::stdin());
        let reader: Box<dyn FrameReader> = match args.raw {
            Some(size) => Box::new(GrayReader::new(stdin, size, times)?),
            None => read_pipe(stdin, times)?,
        };
        return Ok(Sequential::live(reader));
    }
    let ffmpeg = Ffmpeg::find()?;
    if is_address(path) {
        let address = path.to_str().context("the address is not UTF-8")?.to_owned();
        return Ok(Sequential::live(Box::new(ffmpeg.open(VideoInput::Address(address))?)));
    }
    if is_device(path) {
        return Ok(Sequential::live(Box::new(ffmpeg.open(VideoInput::Device(path.to_owned()))?)));
    }
    let path = path.to_owned();
    let open = move || {
        let reader = ffmpeg.open(VideoInput::File(path.clone()))?;
        Ok(Box::new(reader) as Box<dyn FrameReader>)
    };
    Ok(Sequential::new(open)?)
}

fn is_address(path: &Path) -> bool {
    path.to_str().is_some_and(|text| text.contains("://"))
}

#[cfg(unix)]
fn is_device(path: &Path) -> bool {
    use std::os::unix::fs::FileTypeExt;
    path.metadata().is_ok_and(|file| file.file_type().is_char_device())
}

#[cfg(not(unix))]
fn is_device(path: &Path) -> bool {
    !path.is_file()
}

fn name(path: &Path) -> String {
    if path == Path::new("-") { "standard input".to_owned() } else { path.display().to_string() }
}

/// Width and height of the first image, pixels.
fn first_size(source: &Sequential, name: &str) -> Result<(u32, u32)> {
    let first = source.frame(0).map_err(|refused| anyhow!("{refused}"))?;
    let image = first.with_context(|| format!("{name}: there is no image in it"))?.image;
    let size = match (image.width, image.height) {
        (0, _) | (_, 0) => FrameImage::Encoded(image.data.into()).size(),
        size => Some(size),
    };
    size.with_context(|| {
        format!("{name}: its first image is of no format that is read (PNG, JPEG, BMP, WebP, TIFF, PGM, PPM)")
    })
}

/// What is known of the camera.
struct Given<'a> {
    /// The file, or the word `unknown`.
    file: Option<&'a Path>,
    /// A field of view.
    fov_deg: Option<f64>,
    /// What was recorded with the images.
    recorded: Option<CameraParameters>,
}

impl Given<'_> {
    /// The calibration that was given, else that a field of view makes, else that was recorded or lies beside
    /// the source, else the size alone. It must be for images of this size.
    fn camera(self, path: &Path, name: &str, (width, height): (u32, u32)) -> Result<CameraParameters> {
        let is_unknown = self.file == Some(Path::new(UNKNOWN));
        let recorded = self.recorded.filter(|_| !is_unknown);
        let beside = path.parent().map(|folder| folder.join(CALIBRATION));
        let beside = beside.filter(|file| !is_unknown && file.is_file());
        let file = self.file.filter(|_| !is_unknown);
        let (camera, origin) = match (file, self.fov_deg, recorded, beside) {
            (Some(file), ..) => from_file(file)?,
            (None, None, Some(recorded), _) => (recorded, "its calibration".to_owned()),
            (None, None, None, Some(beside)) => from_file(&beside)?,
            (None, None, None, None) => {
                eprintln!(
                    "the calibration of {name} is not known: it is found as the map grows; where it is known, give it \
                     with --camera FILE (as calib.json)"
                );
                return Ok(of_size(width, height));
            }
            (None, Some(fov_deg), ..) => {
                eprintln!(
                    "the calibration of {name} is taken from a field of view of {fov_deg} degrees, without \
                     distortion: shapes come out wrong as far as that is"
                );
                return Ok(CameraParameters::of_field_of_view(width, height, fov_deg));
            }
        };
        if (camera.width, camera.height) == (width, height) {
            return Ok(camera);
        }
        let hint = if (camera.height, camera.width) == (width, height) {
            "; its images are turned as its rotation tag says, the calibration must be for these"
        } else {
            ""
        };
        bail!(
            "{name} has images of {width}x{height} pixels, but {origin} is for {}x{}{hint}",
            camera.width,
            camera.height
        );
    }
}

fn from_file(file: &Path) -> Result<(CameraParameters, String)> {
    Ok((read_calibration(file)?.parameters().clone(), file.display().to_string()))
}

/// A camera given by the size of its images alone.
fn of_size(width: u32, height: u32) -> CameraParameters {
    let (model, distortion) = (CameraModel::Pinhole, Vec::new());
    CameraParameters { model, width, height, fx: 0.0, fy: 0.0, cx: 0.0, cy: 0.0, distortion }
}

fn field_of_view(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|degrees: &f64| (10.0..=150.0).contains(degrees))
        .ok_or_else(|| "an angle from 10 to 150 degrees expected".to_owned())
}

fn image_size(text: &str) -> Result<(u32, u32), String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    sides.filter(|(w, h)| *w > 0 && *h > 0).ok_or_else(|| "a size such as 640x480 expected".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_of_view_is_across_the_longer_side() {
        let camera = CameraParameters::of_field_of_view(640, 480, 90.0);
        assert!((camera.fx - 320.0).abs() < 1e-9 && (camera.fx - camera.fy).abs() < 1e-12);
        assert_eq!((camera.cx, camera.cy), (319.5, 239.5));
        assert!((CameraParameters::of_field_of_view(480, 640, 90.0).fx - 320.0).abs() < 1e-9);
    }

    #[test]
    fn a_calibration_is_given_or_lies_beside() {
        let folder = tempfile::tempdir().unwrap();
        let video = folder.path().join("a.mp4");
        let camera_of = |file: Option<&str>, fov_deg| {
            let given = Given { file: file.map(Path::new), fov_deg, recorded: None };
            given.camera(&video, "a.mp4", (64, 48))
        };
        for word in [None, Some(UNKNOWN)] {
            let unknown = camera_of(word, None).unwrap();
            assert_eq!((unknown.width, unknown.height, unknown.fx), (64, 48, 0.0), "the size alone is told");
        }
        let calibration = |width: u32, height: u32| {
            let text = format!(
                r#"{{"width": {width}, "height": {height}, "fx": 60, "fy": 60, "cx": 31, "cy": 23, "dist": []}}"#
            );
            std::fs::write(folder.path().join(CALIBRATION), text).unwrap();
        };
        calibration(64, 48);
        assert_eq!(camera_of(None, None).unwrap().fx, 60.0);
        // A field of view that is asked for goes before a file that is not.
        assert!(camera_of(None, Some(90.0)).unwrap().fx < 33.0);
        let recorded = Some(CameraParameters::of_field_of_view(64, 48, 60.0));
        let given = Given { file: None, fov_deg: None, recorded: recorded.clone() };
        assert_eq!(Some(given.camera(&video, "a.mp4", (64, 48)).unwrap()), recorded);
        calibration(48, 64);
        let refused = camera_of(None, None).unwrap_err().to_string();
        assert!(refused.contains("64x48") && refused.contains("rotation tag"), "{refused}");
    }
}
