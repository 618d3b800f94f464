//! The folder in which recordings are kept.

use std::path::{Path, PathBuf};

use crate::files::FileError;

/// The environment variable that names the folder of recordings, each a folder of its own in it.
pub const DATA_VARIABLE: &str = "MONOSLAM_DATA";

/// A recording's folder: the path itself if it is one, else the folder of this name in the one that
/// [`DATA_VARIABLE`] names.
///
/// # Errors
/// A [`FileError`] that says where it was looked for.
pub fn find_folder(path: impl AsRef<Path>) -> Result<PathBuf, FileError> {
    let kept = std::env::var_os(DATA_VARIABLE).filter(|value| !value.is_empty());
    find_in(path.as_ref(), kept.map(PathBuf::from).as_deref())
}

fn find_in(path: &Path, kept: Option<&Path>) -> Result<PathBuf, FileError> {
    if path.is_dir() {
        return Ok(path.to_owned());
    }
    let Some(kept) = kept else {
        let message =
            format!("there is no such folder, and {DATA_VARIABLE} does not say where recordings are");
        return Err(FileError::content(path, message));
    };
    let beside = kept.join(path);
    if beside.is_dir() { Ok(beside) } else { Err(FileError::content(&beside, "there is no such folder")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_is_here_or_where_recordings_are_kept() {
        let kept = tempfile::tempdir().unwrap();
        std::fs::create_dir(kept.path().join("room-7")).unwrap();
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        assert_eq!(find_in(here, None).unwrap(), here);
        assert_eq!(find_in(Path::new("room-7"), Some(kept.path())).unwrap(), kept.path().join("room-7"));
        let refused = find_in(Path::new("room-7"), None).unwrap_err().to_string();
        assert!(refused.contains("room-7") && refused.contains(DATA_VARIABLE), "{refused}");
        let refused = find_in(Path::new("room-8"), Some(kept.path())).unwrap_err().to_string();
        assert!(refused.contains(&kept.path().join("room-8").display().to_string()), "{refused}");
    }
}
