//! Lists of images, `timestamp filename` on each line.

use std::path::{Path, PathBuf};

use super::FrameFile;
use crate::files::{FileError, Line, TextFile};

/// Reads `list`, whose file names are relative to `root`.
pub(super) fn read(root: &Path, list: &Path) -> Result<Vec<FrameFile>, FileError> {
    let file = TextFile::read(list)?;
    let mut frames: Vec<FrameFile> = Vec::new();
    for line in file.lines() {
        let words = line.words();
        let [timestamp, name, ..] = words[..] else {
            return Err(line.error("`timestamp filename` expected"));
        };
        let timestamp_ns = line.seconds_ns(timestamp)?;
        check_order(&line, frames.last(), timestamp_ns)?;
        frames.push(FrameFile { timestamp_ns, path: existing(&line, root.join(name))? });
    }
    Ok(frames)
}

/// Checks that a listed time is after that of the frame before.
pub(super) fn check_order(
    line: &Line<'_>,
    before: Option<&FrameFile>,
    timestamp_ns: i64,
) -> Result<(), FileError> {
    match before {
        Some(before) if before.timestamp_ns >= timestamp_ns => {
            Err(line.error("the time is not after that of the line before"))
        }
        _ => Ok(()),
    }
}

/// The path, if there is a file.
pub(super) fn existing(line: &Line<'_>, path: PathBuf) -> Result<PathBuf, FileError> {
    if path.is_file() { Ok(path) } else { Err(line.error(format!("there is no image {}", path.display()))) }
}
