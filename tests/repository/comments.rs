//! Comments: their width, and what they say across lines.

use super::files;

/// Columns that a comment may take, as code may by `rustfmt.toml`; rustfmt does not see comments.
const MAX_COLUMNS: usize = 110;

/// What a comment says, without the marks of a comment; `None` for a line of code.
fn said(line: &str) -> Option<&str> {
    let line = line.trim();
    ["///", "//!", "//"].into_iter().find_map(|mark| line.strip_prefix(mark)).map(str::trim)
}

/// Runs of comment lines, each joined to one text, with the number of its first line.
pub fn blocks(text: &str) -> Vec<(usize, String)> {
    let mut blocks: Vec<(usize, String)> = Vec::new();
    let mut goes_on = false;
    for (idx, line) in text.lines().enumerate() {
        match (said(line), blocks.last_mut()) {
            (Some(words), Some((_, block))) if goes_on => {
                block.push(' ');
                block.push_str(words);
            }
            (Some(words), _) => blocks.push((idx + 1, words.to_owned())),
            (None, _) => {}
        }
        goes_on = said(line).is_some();
    }
    blocks
}

/// Whether a line is a comment that is too wide and could be broken: rows of tables and addresses cannot.
fn is_too_wide(line: &str) -> bool {
    let could_be_broken = |words: &str| !words.starts_with('|') && !words.contains("://");
    line.chars().count() > MAX_COLUMNS && said(line).is_some_and(could_be_broken)
}

#[test]
fn comments_are_as_narrow_as_code() {
    let mut wide = Vec::new();
    let written = |file: &files::File| !file.path.components().any(|part| part.as_os_str() == "generated");
    for file in files::with_extension("rs").into_iter().filter(written) {
        let lines = file.text.lines().enumerate().filter(|(_, line)| is_too_wide(line));
        wide.extend(lines.map(|(idx, line)| {
            format!("{}:{}: {} columns", file.path.display(), idx + 1, line.chars().count())
        }));
    }
    assert!(wide.is_empty(), "comments wider than {MAX_COLUMNS} columns:\n{}", wide.join("\n"));
}

#[test]
fn wide_comments_are_noticed() {
    let words = "word ".repeat(30);
    assert!(is_too_wide(&format!("    /// {words}")));
    assert!(!is_too_wide(&format!("    let code = {words:?};")));
    assert!(!is_too_wide(&format!("/// | {words} |")));
    assert!(!is_too_wide(&format!("{:>110}", "// as wide as may be")));
}

#[test]
fn comments_go_on_over_lines() {
    let text = "//! One\n//! two\nlet code;\n    // three\n\n    // four";
    assert_eq!(blocks(text), [(1, "One two".into()), (4, "three".into()), (6, "four".into())]);
}
