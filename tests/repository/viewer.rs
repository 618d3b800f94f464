//! The viewer's built files belong to its sources: `npm run build` in `viewer/` makes them, and leaves a hash
//! of what it made them from.

use super::files::root;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// What the page is built from, as in `viewer/vite.config.ts`.
const SOURCES: [&str; 7] =
    ["capture.html", "index.html", "package-lock.json", "package.json", "public", "src", "vite.config.ts"];

/// The files below a path, those of a folder in the order of their names.
fn files_below(viewer: &Path, path: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(viewer.join(path)) else { return vec![path.to_owned()] };
    let mut entries: Vec<PathBuf> =
        entries.map(|entry| path.join(entry.expect("an entry of a folder").file_name())).collect();
    entries.sort();
    entries.iter().flat_map(|entry| files_below(viewer, entry)).collect()
}

#[test]
fn the_viewer_was_built_from_its_sources() {
    let viewer = root().join("viewer");
    let mut hash = Sha256::new();
    for path in SOURCES.iter().flat_map(|source| files_below(&viewer, Path::new(source))) {
        hash.update(path.to_str().expect("a name of ours"));
        hash.update([0]);
        hash.update(std::fs::read(viewer.join(&path)).expect("a source of the viewer"));
        hash.update([0]);
    }
    let found: String = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    let built = std::fs::read_to_string(viewer.join("dist/sources.sha256")).expect("the viewer was built");
    assert_eq!(built.trim(), found, "viewer/dist is stale: run `npm ci && npm run build` in viewer/");
}

#[test]
fn the_lock_file_names_no_registry() {
    let lock = std::fs::read_to_string(root().join("viewer/package-lock.json")).expect("a lock file");
    assert!(!lock.contains("\"resolved\""), "set omit-lockfile-registry-resolved, see viewer/.npmrc");
    assert!(lock.contains("\"integrity\""), "packages are pinned by what they hold");
}
