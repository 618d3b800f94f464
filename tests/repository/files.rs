//! The files of the repository.

use std::path::{Path, PathBuf};

/// Folders that hold what others wrote or what was built.
const FOREIGN: [&str; 2] = ["target", "node_modules"];

/// A text file.
pub struct File {
    /// From the root of the repository.
    pub path: PathBuf,
    pub text: String,
}

/// The folder of the workspace.
pub fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().expect("the crate lies in the workspace").to_owned()
}

/// Every file of our own with this extension, in the order of paths.
pub fn with_extension(extension: &str) -> Vec<File> {
    let (root, mut paths) = (root(), Vec::new());
    collect(&root, extension, &mut paths);
    paths.sort();
    assert!(!paths.is_empty(), "there is no .{extension} below {}", root.display());
    let read = |path: PathBuf| {
        let text =
            std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        File { path: path.strip_prefix(&root).expect("found below it").to_owned(), text }
    };
    paths.into_iter().map(read).collect()
}

fn collect(folder: &Path, extension: &str, paths: &mut Vec<PathBuf>) {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    for entry in entries {
        let path = entry.expect("readable").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_symlink() || name.starts_with('.') || FOREIGN.contains(&name.as_str()) {
            continue;
        }
        if path.is_dir() {
            collect(&path, extension, paths);
        } else if path.extension().is_some_and(|found| found == extension) {
            paths.push(path);
        }
    }
}
