//! Links between documents.

use super::{files, markdown};
use std::path::Path;

/// What is wrong with a link of a document; `None` if it leads somewhere, or out of the repository.
fn fault(document: &Path, text: &str, target: &str) -> Option<String> {
    if target.contains("://") || target.starts_with("mailto:") {
        return None;
    }
    let (path, anchor) = target.split_once('#').map_or((target, None), |(path, anchor)| (path, Some(anchor)));
    let folder = files::root().join(document.parent().unwrap_or(Path::new("")));
    let file = folder.join(path);
    if !path.is_empty() && !file.exists() {
        return Some(format!("{}: there is no {target}", document.display()));
    }
    let is_document = path.is_empty() || file.extension().is_some_and(|extension| extension == "md");
    let anchor = anchor.filter(|_| is_document)?;
    let text =
        if path.is_empty() { text.to_owned() } else { std::fs::read_to_string(&file).unwrap_or_default() };
    let is_there = markdown::anchors(&text).iter().any(|found| found == anchor);
    (!is_there).then(|| format!("{}: no heading has the anchor of {target}", document.display()))
}

#[test]
fn relative_links_lead_somewhere() {
    let (mut n_links, mut faults) = (0, Vec::new());
    for document in files::with_extension("md") {
        for target in markdown::link_targets(&document.text) {
            n_links += 1;
            faults.extend(fault(&document.path, &document.text, &target));
        }
    }
    assert!(n_links > 0, "no document has a link: the search for them is broken");
    assert!(faults.is_empty(), "{} of {n_links} links:\n{}", faults.len(), faults.join("\n"));
}

#[test]
fn links_that_lead_nowhere_are_noticed() {
    let of_readme = |target| fault(Path::new("README.md"), "# Here\n", target);
    assert!(of_readme("#here").is_none());
    assert!(of_readme("ARCHITECTURE.md#floors").is_none());
    assert!(of_readme("https://example.org/nothing").is_none());
    assert!(of_readme("#there").is_some());
    assert!(of_readme("nothing.md").is_some());
    assert!(of_readme("ARCHITECTURE.md#nothing").is_some());
}
