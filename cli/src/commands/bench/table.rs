//! Tables in Markdown.

use std::fmt::Write;

/// Where tables stand: what their headings look like.
#[derive(Clone, Copy, Debug)]
pub enum Place<'a> {
    /// By themselves, on standard output.
    Alone,
    /// In the section of that name of a document, which tells its tables from those of other sections.
    Section(&'a str),
}

impl Place<'_> {
    fn heading(self, title: &str) -> String {
        match self {
            Self::Alone => format!("## {title}\n\n"),
            Self::Section(name) => format!("### {title}: {name}\n\n"),
        }
    }
}

/// A table of a document.
pub struct Table(String);

impl Table {
    /// A table without rows under its title. The first two columns are words, the others numbers.
    pub fn new(place: Place<'_>, title: &str, columns: &[&str]) -> Self {
        let mut table = Self(place.heading(title));
        table.cells(columns.iter());
        table.cells(columns.iter().enumerate().map(|(i, _)| if i < 2 { "---" } else { "---:" }));
        table
    }

    /// Adds a row.
    pub fn row(&mut self, cells: &[String]) {
        self.cells(cells.iter());
    }

    fn cells(&mut self, cells: impl Iterator<Item: std::fmt::Display>) {
        for cell in cells {
            // Writing to a string cannot fail.
            let _ = write!(self.0, "| {cell} ");
        }
        self.0.push_str("|\n");
    }

    /// The table with an empty line after it.
    pub fn finish(mut self) -> String {
        self.0.push('\n');
        self.0
    }
}
