//! Lists of images, `timestamp filename` on each line, as people and programs write them: blanks, tabs,
//! commas or semicolons between the two, blanks in the name, words as a head.

use std::path::{Path, PathBuf};

use super::FrameFile;
use super::options::Reading;
use crate::files::{FileError, Line, TextFile};
use crate::time::decimal_nano;
use crate::units::{self, TimeUnit};

/// A line of a list: what it says, not yet a time.
struct Entry<'a> {
    line: Line<'a>,
    /// As written, and in billionths of its unit.
    time: &'a str,
    nano: i128,
    path: PathBuf,
}

/// Reads `list`, whose file names are relative to `folder`.
pub(super) fn read(folder: &Path, list: &Path, reading: &Reading<'_>) -> Result<Vec<FrameFile>, FileError> {
    read_in(folder, list, None, reading)
}

/// As [`read`], of a layout that has its times in a unit of its own.
pub(super) fn read_in(
    folder: &Path,
    list: &Path,
    unit: Option<TimeUnit>,
    reading: &Reading<'_>,
) -> Result<Vec<FrameFile>, FileError> {
    let file = TextFile::read(list)?;
    let lines: Vec<Line<'_>> = file.lines().collect();
    let n_head = usize::from(lines.len() > 1 && is_head(folder, &lines[0]));
    let mut entries = Vec::with_capacity(lines.len());
    for line in &lines[n_head..] {
        match entry(folder, *line) {
            Ok(entry) => entries.push(entry),
            Err(error) => reading.bad_line(error)?,
        }
    }
    timed(&file, entries, unit, reading)
}

fn timed(
    file: &TextFile,
    entries: Vec<Entry<'_>>,
    unit: Option<TimeUnit>,
    reading: &Reading<'_>,
) -> Result<Vec<FrameFile>, FileError> {
    let unit = match reading.options.times.or(unit) {
        Some(TimeUnit::Frames) if reading.options.fps.is_none() => {
            return Err(file.error("numbers of frames become times by a rate: give it with --fps"));
        }
        Some(unit) => unit,
        None => {
            let numbers: Vec<i128> = entries.iter().map(|entry| entry.nano).collect();
            let found = units::of_images(&numbers);
            if let Some(remark) = found.remark {
                reading.remark(file.error(remark).to_string());
            }
            found.unit
        }
    };
    let mut frames = Vec::with_capacity(entries.len());
    for entry in entries {
        match unit.to_ns(entry.nano, reading.options.fps) {
            Some(timestamp_ns) => frames.push((entry.line, FrameFile { timestamp_ns, path: entry.path })),
            None => {
                let message =
                    format!("`{}` is not a time in {unit} that can be counted in nanoseconds", entry.time);
                reading.bad_line(entry.line.error(message))?;
            }
        }
    }
    in_order(frames, reading)
}

/// The frames of lines, whose times must increase.
pub(super) fn in_order(
    mut frames: Vec<(Line<'_>, FrameFile)>,
    reading: &Reading<'_>,
) -> Result<Vec<FrameFile>, FileError> {
    if reading.options.sort {
        frames.sort_by_key(|(_, frame)| frame.timestamp_ns);
    }
    let mut kept: Vec<FrameFile> = Vec::with_capacity(frames.len());
    for (line, frame) in frames {
        match kept.last() {
            // Once more the same image is no other frame.
            Some(last) if *last == frame && reading.options.sort => {}
            Some(last) if last.timestamp_ns >= frame.timestamp_ns => {
                let is_same = last.timestamp_ns == frame.timestamp_ns;
                let advice = match (is_same, reading.options.sort) {
                    (true, _) => "--skip-bad leaves out what comes twice",
                    (false, _) => "--sort brings the list into order, --skip-bad leaves such lines out",
                };
                let message = format!("the time is not after that of the line before ({advice})");
                reading.bad_line(line.error(message))?;
            }
            _ => kept.push(frame),
        }
    }
    Ok(kept)
}

fn entry<'a>(folder: &Path, line: Line<'a>) -> Result<Entry<'a>, FileError> {
    let Some((time, rest)) = split(line.text) else {
        return Err(line.error("`timestamp filename` expected"));
    };
    let Some(nano) = decimal_nano(time) else {
        let is_turned = split_last(line.text).is_some_and(|(_, last)| decimal_nano(last).is_some());
        let hint = if is_turned { "; the time comes first, the file's name behind it" } else { "" };
        return Err(line.error(format!("`{time}` is not a time{hint}")));
    };
    match file_of(folder, rest) {
        Some(path) => Ok(Entry { line, time, nano, path }),
        None => {
            let named = names(rest).next().unwrap_or(rest);
            Err(line.error(format!("there is no image {}", folder.join(named).display())))
        }
    }
}

/// Whether the first line is a head in words, and not a line that is wrong.
fn is_head(folder: &Path, line: &Line<'_>) -> bool {
    match split(line.text) {
        Some((first, rest)) => {
            first.starts_with(|c: char| c.is_alphabetic() || c == '"')
                && decimal_nano(first).is_none()
                && file_of(folder, rest).is_none()
                && file_of(folder, first).is_none()
        }
        None => false,
    }
}

fn is_separator(c: char) -> bool {
    matches!(c, ',' | ';') || c.is_whitespace()
}

/// The first field and what comes behind it.
fn split(text: &str) -> Option<(&str, &str)> {
    let (first, rest) = text.split_once(is_separator)?;
    let rest = rest.trim_matches(is_separator);
    (!rest.is_empty()).then_some((first.trim_matches('"'), rest))
}

fn split_last(text: &str) -> Option<(&str, &str)> {
    text.trim_end_matches(is_separator).rsplit_once(is_separator)
}

/// What the file may be called: all that is left of the line, or less of it where other columns follow.
fn names(rest: &str) -> impl Iterator<Item = &str> {
    let unquoted = rest.strip_prefix('"').and_then(|rest| rest.split('"').next());
    let cell = rest.split([',', ';', '\t']).next();
    let word = rest.split_whitespace().next();
    [unquoted, Some(rest), cell, word].into_iter().flatten().map(str::trim).filter(|name| !name.is_empty())
}

fn file_of(folder: &Path, rest: &str) -> Option<PathBuf> {
    names(rest).find_map(|name| {
        let path = folder.join(name);
        if path.is_file() {
            return Some(path);
        }
        // Windows has another separator of folders.
        let path = folder.join(name.replace('\\', "/"));
        (name.contains('\\') && path.is_file()).then_some(path)
    })
}

/// The path, if there is a file.
pub(super) fn existing(line: &Line<'_>, path: PathBuf) -> Result<PathBuf, FileError> {
    if path.is_file() { Ok(path) } else { Err(line.error(format!("there is no image {}", path.display()))) }
}
