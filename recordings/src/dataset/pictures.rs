//! A folder of pictures without a list: taken in the order of the numbers in their names, at a rate that is
//! given, or at the times that are their names.

use std::path::{Path, PathBuf};

use super::options::Reading;
use super::{CALIBRATION, Content, FrameFile, folder};
use crate::calibration::read_calibration;
use crate::files::FileError;
use crate::time::decimal_nano;
use crate::units::TimeUnit;

/// Endings of the names of images.
const ENDINGS: [&str; 12] =
    ["png", "jpg", "jpeg", "jpe", "bmp", "webp", "tif", "tiff", "pgm", "ppm", "pnm", "pbm"];

/// Folders in which the pictures may be.
const FOLDERS: [&str; 9] =
    ["images", "rgb", "frames", "image", "img", "color", "data", "cam0/data", "image_0"];

/// Digits of a time of day since 1970 in nanoseconds and in seconds; shorter numbers count frames.
const NS_DIGITS: usize = 16;
const S_DIGITS: usize = 9;

pub(super) fn is_recording(root: &Path) -> bool {
    folder_of_pictures(root).is_some()
}

pub(super) fn read(root: &Path, reading: &Reading<'_>) -> Result<Content, FileError> {
    let folder =
        folder_of_pictures(root).ok_or_else(|| FileError::content(root, "there are no pictures in it"))?;
    let pictures = pictures(&folder)?;
    let frames = match (reading.options.fps, times_by_name(&pictures)) {
        (Some(fps), _) => numbered(pictures, fps),
        (None, Some(frames)) => frames,
        (None, None) => {
            let message = "these pictures have no times: give the rate they were taken at with --fps, or a list \
                           rgb.txt with `timestamp filename` on each line";
            return Err(FileError::content(&folder, message));
        }
    };
    let camera = reading.camera(&frames, || match [root, &folder].map(|place| place.join(CALIBRATION)) {
        [beside, _] if beside.is_file() => read_calibration(&beside),
        [_, inside] if inside.is_file() => read_calibration(&inside),
        [beside, _] => {
            let message = "there is no such file: the camera's calibration belongs in it, or give it with --camera \
                           FILE, its field of view with --fov, or --camera unknown to have it found";
            Err(FileError::content(&beside, message))
        }
    })?;
    Ok(Content { camera, frames, ground_truth: folder::ground_truth(root)? })
}

fn folder_of_pictures(root: &Path) -> Option<PathBuf> {
    let places = std::iter::once(root.to_owned()).chain(FOLDERS.map(|name| root.join(name)));
    places.into_iter().find(|place| {
        std::fs::read_dir(place)
            .is_ok_and(|mut entries| entries.any(|entry| entry.is_ok_and(|entry| is_picture(&entry.path()))))
    })
}

/// Whether the name is that of a picture of a recording, and not that of a mask beside it.
fn is_picture(path: &Path) -> bool {
    let ending =
        path.extension().is_some_and(|ending| ENDINGS.iter().any(|known| ending.eq_ignore_ascii_case(known)));
    let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    ending && stem != "mask" && !stem.starts_with('.')
}

/// The pictures of a folder in the order of the numbers in their names: 10 comes after 9.
pub(super) fn pictures(folder: &Path) -> Result<Vec<PathBuf>, FileError> {
    let mut pictures = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|source| FileError::io(folder, source))? {
        let path = entry.map_err(|source| FileError::io(folder, source))?.path();
        if is_picture(&path) {
            pictures.push(path);
        }
    }
    pictures.sort_by_cached_key(|path| natural(&path.file_name().unwrap_or_default().to_string_lossy()));
    Ok(pictures)
}

/// A part of a name: text, or a number without the zeros before it, longer ones being greater.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    Number(usize, String),
    Text(String),
}

fn natural(name: &str) -> Vec<Part> {
    let mut parts = Vec::new();
    let mut rest = name;
    while let Some(first) = rest.chars().next() {
        let is_number = first.is_ascii_digit();
        let end = rest.find(|c: char| c.is_ascii_digit() != is_number).unwrap_or(rest.len());
        let (part, behind) = rest.split_at(end);
        rest = behind;
        parts.push(if is_number {
            let digits = part.trim_start_matches('0');
            Part::Number(digits.len(), digits.to_owned())
        } else {
            Part::Text(part.to_owned())
        });
    }
    parts
}

pub(super) fn numbered(pictures: Vec<PathBuf>, fps: f64) -> Vec<FrameFile> {
    let pictures = pictures.into_iter().enumerate();
    pictures
        .map(|(i, path)| FrameFile { timestamp_ns: (i as f64 * 1e9 / fps).round() as i64, path })
        .collect()
}

/// The pictures with the times that are their names, if all are.
fn times_by_name(pictures: &[PathBuf]) -> Option<Vec<FrameFile>> {
    let unit = |stem: &str| {
        let whole = stem.split('.').next().unwrap_or_default();
        match (stem.contains('.'), whole.len()) {
            (false, NS_DIGITS..) => Some(TimeUnit::Nanoseconds),
            (true, S_DIGITS..) => Some(TimeUnit::Seconds),
            _ => None,
        }
    };
    let frame = |path: &PathBuf| {
        let stem = path.file_stem()?.to_str()?;
        let timestamp_ns = unit(stem)?.to_ns(decimal_nano(stem)?, None)?;
        Some(FrameFile { timestamp_ns, path: path.clone() })
    };
    let mut frames = pictures.iter().map(frame).collect::<Option<Vec<_>>>()?;
    frames.sort_by_key(|frame| frame.timestamp_ns);
    (!frames.is_empty()).then_some(frames)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_comes_after_nine() {
        let mut names = ["frame10.png", "frame9.png", "frame009.png", "a.png", "frame1.png"];
        names.sort_by_key(|name| natural(name));
        assert_eq!(names, ["a.png", "frame1.png", "frame9.png", "frame009.png", "frame10.png"]);
    }

    #[test]
    fn names_that_are_times_are_times() {
        let times = |names: &[&str]| {
            let paths: Vec<PathBuf> = names.iter().map(PathBuf::from).collect();
            Some(times_by_name(&paths)?.iter().map(|frame| frame.timestamp_ns).collect::<Vec<_>>())
        };
        assert_eq!(times(&["1403715285262142976.png"]), Some(vec![1_403_715_285_262_142_976]));
        assert_eq!(times(&["1305031102.175304.png"]), Some(vec![1_305_031_102_175_304_000]));
        assert_eq!(times(&["1.png", "2.png"]), None);
    }
}
