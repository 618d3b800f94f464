//! Sections of a document that a command writes. Everything around them belongs to the document's authors and
//! is kept byte by byte.

use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

/// A section of a file, between the lines `<!-- begin: bench NAME -->` and `<!-- end: bench NAME -->`.
pub struct Section {
    path: PathBuf,
    name: String,
}

impl Section {
    /// The section of that name, found out before anything is measured.
    ///
    /// # Errors
    /// If the file cannot be read, or its section is missing or stands there twice.
    pub fn find(path: &Path, name: &str) -> Result<Self> {
        let section = Self { path: path.to_owned(), name: name.to_owned() };
        section.replaced(&section.read()?, "")?;
        Ok(section)
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Puts `content` between the two lines. The file is read anew: it may have changed since
    /// [`Section::find`]. It is written beside and renamed, so that a file of that name is always whole.
    ///
    /// # Errors
    /// As [`Section::find`], or if the file cannot be written.
    pub fn write(&self, content: &str) -> Result<()> {
        let text = self.replaced(&self.read()?, content)?;
        let mut partial = self.path.as_os_str().to_owned();
        partial.push(".part");
        let partial = PathBuf::from(partial);
        let written = std::fs::write(&partial, text).and_then(|()| std::fs::rename(&partial, &self.path));
        if written.is_err() {
            // It may not have been made.
            let _ = std::fs::remove_file(&partial);
        }
        written.with_context(|| format!("cannot write {}", self.path.display()))
    }

    fn read(&self) -> Result<String> {
        std::fs::read_to_string(&self.path).with_context(|| format!("cannot read {}", self.path.display()))
    }

    fn replaced(&self, document: &str, content: &str) -> Result<String> {
        replace(document, &self.name, content).with_context(|| self.path.display().to_string())
    }
}

/// The document with `content` in its section, an empty line before and after it.
///
/// # Errors
/// If one of the section's lines is missing, stands there twice, or they are the wrong way round.
pub fn replace(document: &str, name: &str, content: &str) -> Result<String> {
    let begin = format!("<!-- begin: bench {name} -->");
    let end = format!("<!-- end: bench {name} -->");
    let (first, last) = match (only_line(document, &begin)?, only_line(document, &end)?) {
        (Some(first), Some(last)) => (first, last),
        (None, None) => bail!(
            "there is no section `{name}`; write the lines `{begin}` and `{end}` where its tables are to stand"
        ),
        (None, Some(_)) => bail!("the section `{name}` has no beginning: the line `{begin}` is missing"),
        (Some(_), None) => bail!("the section `{name}` has no end: the line `{end}` is missing"),
    };
    if last.start < first.end {
        bail!("`{end}` stands before `{begin}`");
    }
    let (before, after) = (&document[..first.end], &document[last.start..]);
    Ok(format!("{before}\n\n{}\n\n{after}", content.trim_matches('\n')))
}

/// Where the line stands, without its end of line; `None` if it is not there.
fn only_line(document: &str, line: &str) -> Result<Option<Range<usize>>> {
    let mut found = None;
    let mut start = 0;
    for text in document.split_inclusive('\n') {
        if text.trim_end_matches(['\n', '\r']) == line {
            if found.is_some() {
                bail!("the line `{line}` stands there twice");
            }
            found = Some(start..start + line.len());
        }
        start += text.len();
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DOCUMENT: &str = "# Results\r\n\nBy hand, `<!-- begin: bench a -->` in passing.\n\n\
        <!-- begin: bench a -->\n\nold\n\n<!-- end: bench a -->\n\n\
        Between, *untouched*  \n<!-- begin: bench ab -->\n<!-- end: bench ab -->\nNo newline at the end";

    fn refused(document: &str) -> String {
        replace(document, "a", "new").unwrap_err().to_string()
    }

    #[test]
    fn only_the_section_changes() {
        let replaced = replace(DOCUMENT, "a", "\nnew\n\n| x |\n\n").unwrap();
        assert_eq!(replaced, DOCUMENT.replace("\nold\n", "\nnew\n\n| x |\n"));
        let filled = replace(DOCUMENT, "ab", "first").unwrap();
        let empty = "<!-- begin: bench ab -->\n<!-- end: bench ab -->";
        let full = "<!-- begin: bench ab -->\n\nfirst\n\n<!-- end: bench ab -->";
        assert_eq!(filled, DOCUMENT.replace(empty, full));
        assert_eq!(replace(&filled, "ab", "first").unwrap(), filled, "the same figures change nothing");
    }

    #[test]
    fn a_section_that_is_missing_is_named_with_what_to_write() {
        let message = refused("# Results\n");
        assert!(message.contains("no section `a`"), "{message}");
        assert!(message.contains("<!-- begin: bench a -->") && message.contains("<!-- end: bench a -->"));
        assert!(refused("<!-- end: bench a -->").contains("has no beginning"));
        assert!(refused("<!-- begin: bench a -->").contains("has no end"));
        assert!(refused("<!-- end: bench a -->\n<!-- begin: bench a -->").contains("stands before"));
        assert!(refused("<!-- begin: bench a -->\n".repeat(2).as_str()).contains("twice"));
    }

    #[test]
    fn a_file_is_refused_before_anything_is_measured_and_else_written_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("results.md");
        let message = |name: &str| format!("{:#}", Section::find(&path, name).err().unwrap());
        assert!(message("a").contains("cannot read"));
        std::fs::write(&path, DOCUMENT).unwrap();
        assert!(message("b").contains("results.md: there is no section `b`"), "{}", message("b"));
        Section::find(&path, "a").unwrap().write("new").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), DOCUMENT.replace("\nold\n", "\nnew\n"));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "the partial file is left behind");
    }

    #[test]
    fn the_results_of_the_repository_have_every_section() {
        let document = include_str!("../../../../docs/results.md");
        for name in ["lossless", "realtime", "ablation"] {
            let begin = format!("<!-- begin: bench {name} -->");
            let end = format!("<!-- end: bench {name} -->");
            let (before, rest) = document.split_once(&begin).unwrap();
            let (content, after) = rest.split_once(&end).unwrap();
            assert!(content.contains("monoslam bench") && content.contains("\n| "), "{name}");
            assert_eq!(replace(document, name, content).unwrap(), document, "{name}");
            assert_eq!(
                replace(document, name, "").unwrap().len(),
                before.len() + after.len() + begin.len() + end.len() + 4
            );
        }
    }
}
