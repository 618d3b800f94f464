//! Text files read line by line, with errors that say which line of which file is wrong.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use thiserror::Error;

use crate::text;
use crate::time::{decimal_nano, parse_seconds_ns};
use crate::units;

/// Why a file or folder of a recording could not be used.
#[derive(Debug, Error)]
pub enum FileError {
    /// The operating system refused.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Its reason.
        reason: std::io::Error,
    },
    /// A line says something that cannot be.
    #[error("{}:{line}: {message}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, counted from one.
        line: usize,
        /// A sentence for the user.
        message: String,
    },
    /// The file or folder as a whole is not what it should be.
    #[error("{}: {message}", path.display())]
    Content {
        /// The file or folder.
        path: PathBuf,
        /// A sentence for the user.
        message: String,
    },
}

impl FileError {
    pub(crate) fn io(path: &Path, reason: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), reason }
    }

    pub(crate) fn content(path: &Path, message: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), message: message.into() }
    }
}

/// The times of a list, such as `rgb.txt` or `times.txt`: the first field of each line that is neither empty
/// nor a comment, nor a head in words.
///
/// # Errors
/// If the file cannot be read, or a line has no time.
pub fn read_times(path: &Path) -> Result<Vec<i64>, FileError> {
    let file = TextFile::read(path)?;
    let mut numbers = Vec::new();
    for (idx, line) in file.lines().enumerate() {
        let field = line.fields().first().copied().unwrap_or_default();
        let field = field.split_whitespace().next().unwrap_or_default();
        match decimal_nano(field) {
            Some(number) => numbers.push((line, number)),
            None if idx == 0 && file.lines().count() > 1 => {}
            None => return Err(line.error(format!("`{field}` is not a time"))),
        }
    }
    let unit = units::of_images(&numbers.iter().map(|(_, number)| *number).collect::<Vec<_>>()).unit;
    let time = |(line, number): &(Line<'_>, i128)| {
        unit.to_ns(*number, None).ok_or_else(|| line.error(format!("this is not a time in {unit}")))
    };
    numbers.iter().map(time).collect()
}

/// A whole text file.
pub(crate) struct TextFile {
    path: PathBuf,
    text: String,
}

impl TextFile {
    pub(crate) fn read(path: &Path) -> Result<Self, FileError> {
        let bytes = std::fs::read(path).map_err(|source| FileError::io(path, source))?;
        match text::decode(bytes) {
            Ok(text) => Ok(Self::from_text(path, text)),
            Err((line, message)) => Err(FileError::Line { path: path.to_owned(), line, message }),
        }
    }

    pub(crate) fn from_text(path: &Path, text: impl Into<String>) -> Self {
        Self { path: path.to_owned(), text: text.into() }
    }

    pub(crate) fn text(&self) -> &str {
        &self.text
    }

    /// The lines that hold data: neither empty nor a `#` comment.
    pub(crate) fn lines(&self) -> impl Iterator<Item = Line<'_>> {
        self.text
            .lines()
            .enumerate()
            .map(|(line_idx, text)| Line { path: &self.path, number: line_idx + 1, text: text.trim() })
            .filter(|line| !line.text.is_empty() && !line.text.starts_with('#'))
    }

    pub(crate) fn error(&self, message: impl Into<String>) -> FileError {
        FileError::content(&self.path, message)
    }
}

/// One line of a [`TextFile`], trimmed.
#[derive(Clone, Copy)]
pub(crate) struct Line<'a> {
    path: &'a Path,
    number: usize,
    pub(crate) text: &'a str,
}

impl<'a> Line<'a> {
    pub(crate) fn error(&self, message: impl Into<String>) -> FileError {
        FileError::Line { path: self.path.to_owned(), line: self.number, message: message.into() }
    }

    /// The fields between blanks.
    pub(crate) fn words(&self) -> Vec<&'a str> {
        self.text.split_whitespace().collect()
    }

    /// The fields between commas, semicolons, or else blanks.
    pub(crate) fn fields(&self) -> Vec<&'a str> {
        match self.text.contains([',', ';']) {
            true => self.text.split([',', ';']).map(str::trim).collect(),
            false => self.words(),
        }
    }

    /// Reads `field` as decimal seconds.
    pub(crate) fn seconds_ns(&self, field: &str) -> Result<i64, FileError> {
        parse_seconds_ns(field).ok_or_else(|| self.error(format!("`{field}` is not a time in seconds")))
    }

    /// Reads `N` finite numbers.
    pub(crate) fn numbers<const N: usize>(&self, fields: &[&str]) -> Result<[f64; N], FileError> {
        if fields.len() != N {
            return Err(self.error(format!("{N} numbers expected, {} found", fields.len())));
        }
        let mut numbers = [0.0; N];
        for (number, field) in numbers.iter_mut().zip(fields) {
            *number = f64::from_str(field)
                .ok()
                .filter(|x| x.is_finite())
                .ok_or_else(|| self.error(format!("`{field}` is not a finite number")))?;
        }
        Ok(numbers)
    }
}
