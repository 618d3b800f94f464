//! Citations of the method in comments: each names a heading of `docs/method.md`.
//!
//! A citation is `method` with a colon and a heading, in square brackets; several headings are separated by
//! semicolons.

use super::{comments, files, markdown};
use std::collections::BTreeSet;

/// How a citation begins.
const BEGIN: &str = "[method:";

/// Forms of citation that a reader of the repository cannot follow.
const UNRESOLVABLE: [&str; 5] = ["ALGORITHMS", "[paper", "(paper", "Paper, \"", "the paper"];

/// The headings that a comment cites. What is not closed is cited to its end, where no heading will match.
fn cited(block: &str) -> Vec<String> {
    let citations =
        block.split(BEGIN).skip(1).map(|rest| rest.split_once(']').map_or(rest, |(inside, _)| inside));
    citations.flat_map(|inside| inside.split(';')).map(|heading| heading.trim().to_owned()).collect()
}

#[test]
fn cited_headings_exist() {
    let method =
        std::fs::read_to_string(files::root().join("docs/method.md")).expect("the method is described");
    let headings: BTreeSet<String> = markdown::headings(&method).into_iter().collect();
    let (mut n_citations, mut faults) = (0, Vec::new());
    for file in files::with_extension("rs") {
        for (line, block) in comments::blocks(&file.text) {
            let place = format!("{}:{line}", file.path.display());
            for heading in cited(&block) {
                n_citations += 1;
                if !headings.contains(&heading) {
                    faults.push(format!("{place}: docs/method.md has no heading `{heading}`"));
                }
            }
            let unresolvable = UNRESOLVABLE.into_iter().filter(|form| block.contains(form));
            faults.extend(
                unresolvable.map(|form| format!("{place}: `{form}` cites what is not in the repository")),
            );
        }
    }
    assert!(n_citations > 0, "no comment cites the method: the search for citations is broken");
    assert!(faults.is_empty(), "{n_citations} citations:\n{}", faults.join("\n"));
}

#[test]
fn citations_are_found() {
    assert_eq!(
        cited("A line. [method: Line extent; Line fusion] And [method: J-Linkage]."),
        ["Line extent", "Line fusion", "J-Linkage"]
    );
    assert_eq!(cited("[method: Line extent and so on"), ["Line extent and so on"]);
    assert!(cited("no [citation: of anything]").is_empty());
}
