//! Text files read line by line, with errors that say which line of which file is wrong.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use thiserror::Error;

use crate::time::parse_seconds_ns;

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

/// The number of lines of a list, such as `rgb.txt`, that are neither empty nor comments.
///
/// # Errors
/// If the file cannot be read.
pub fn count_data_lines(path: &Path) -> Result<usize, FileError> {
    Ok(TextFile::read(path)?.lines().count())
}

/// A whole text file.
pub(crate) struct TextFile {
    path: PathBuf,
    text: String,
}

impl TextFile {
    pub(crate) fn read(path: &Path) -> Result<Self, FileError> {
        match std::fs::read_to_string(path) {
            Ok(text) => Ok(Self::from_text(path, text)),
            Err(source) => Err(FileError::io(path, source)),
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

    /// The fields between commas, trimmed.
    pub(crate) fn cells(&self) -> Vec<&'a str> {
        self.text.split(',').map(str::trim).collect()
    }

    /// Reads `field` as decimal seconds.
    pub(crate) fn seconds_ns(&self, field: &str) -> Result<i64, FileError> {
        parse_seconds_ns(field).ok_or_else(|| self.error(format!("`{field}` is not a time in seconds")))
    }

    /// Reads `field` as integer nanoseconds.
    pub(crate) fn integer_ns(&self, field: &str) -> Result<i64, FileError> {
        field.parse().map_err(|_| self.error(format!("`{field}` is not a time in nanoseconds")))
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
