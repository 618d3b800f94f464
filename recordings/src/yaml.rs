//! YAML as calibrations are written in it: maps, lists and words, in block or flow style.
//!
//! Read by `yaml-rust2`, event by event. Aliases are refused, with which few lines become a tree of any size,
//! and so is what is nested deeper than any calibration.

use std::path::{Path, PathBuf};

use yaml_rust2::parser::{Event, Parser};

use crate::files::{FileError, TextFile};

/// Deeper than any calibration is nested.
const MAX_DEPTH: usize = 16;

/// More values than any calibration has.
const MAX_NODES: usize = 100_000;

/// A file in YAML.
pub(crate) struct Yaml {
    path: PathBuf,
    root: Node,
}

/// A value and the line it begins at.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Node {
    pub line: usize,
    pub value: Value,
}

/// A value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    Word(String),
    List(Vec<Node>),
    Map(Vec<(String, Node)>),
}

impl Node {
    /// What a map holds under one of these names, the first that is there.
    pub fn get(&self, names: &[&str]) -> Option<&Node> {
        let Value::Map(entries) = &self.value else { return None };
        names.iter().find_map(|wanted| entries.iter().find(|(name, _)| name == wanted)).map(|(_, node)| node)
    }

    /// The word it is.
    pub fn word(&self) -> Option<&str> {
        if let Value::Word(word) = &self.value { Some(word) } else { None }
    }
}

impl Yaml {
    /// Reads a file.
    pub fn parse(path: &Path, file: &TextFile) -> Result<Self, FileError> {
        // OpenCV writes a first line that is almost the directive of YAML.
        let text = file.text();
        let text = if text.starts_with("%YAML:") {
            text.split_once('\n').map_or("", |(_, rest)| rest)
        } else {
            text
        };
        let n_skipped = file.text()[..file.text().len() - text.len()].matches('\n').count();
        let mut builder = Builder { path, n_skipped, parser: Parser::new_from_str(text), n_nodes: 0 };
        Ok(Self { path: path.to_owned(), root: builder.document()? })
    }

    /// The whole.
    pub fn root(&self) -> &Node {
        &self.root
    }

    /// An error in the line of a node.
    pub fn error(&self, node: &Node, message: impl Into<String>) -> FileError {
        FileError::Line { path: self.path.clone(), line: node.line, message: message.into() }
    }

    /// The finite numbers of a list, of lists in it as well, or of a map with `data`.
    pub fn numbers(&self, name: &str, node: &Node) -> Result<Vec<f64>, FileError> {
        let mut numbers = Vec::new();
        self.collect(name, node, &mut numbers)?;
        Ok(numbers)
    }

    fn collect(&self, name: &str, node: &Node, numbers: &mut Vec<f64>) -> Result<(), FileError> {
        match &node.value {
            Value::List(items) => items.iter().try_for_each(|item| self.collect(name, item, numbers)),
            Value::Map(_) => match node.get(&["data"]) {
                Some(data) => self.collect(name, data, numbers),
                None => Err(self.error(node, format!("`{name}` must be a list of numbers"))),
            },
            Value::Word(word) => {
                let number = word.parse().ok().filter(|x: &f64| x.is_finite());
                let refused = || self.error(node, format!("`{word}` in `{name}` is not a finite number"));
                numbers.push(number.ok_or_else(refused)?);
                Ok(())
            }
        }
    }
}

struct Builder<'a> {
    path: &'a Path,
    /// Lines before the text that is parsed.
    n_skipped: usize,
    parser: Parser<std::str::Chars<'a>>,
    n_nodes: usize,
}

/// A list or map that is not finished.
struct Open {
    node: Node,
    /// The name whose value is to come.
    name: Option<String>,
}

impl Builder<'_> {
    fn error(&self, line: usize, message: impl Into<String>) -> FileError {
        let line = self.n_skipped + line.max(1);
        FileError::Line { path: self.path.to_owned(), line, message: message.into() }
    }

    /// The first document.
    fn document(&mut self) -> Result<Node, FileError> {
        let mut open: Vec<Open> = Vec::new();
        loop {
            let (event, mark) = match self.parser.next_token() {
                Ok(next) => next,
                Err(error) => {
                    return Err(
                        self.error(error.marker().line(), format!("this is no YAML: {}", error.info()))
                    );
                }
            };
            let line = self.n_skipped + mark.line().max(1);
            let finished = match event {
                Event::Scalar(word, ..) => Node { line, value: Value::Word(word) },
                Event::SequenceStart(..) => {
                    open.push(Open { node: Node { line, value: Value::List(Vec::new()) }, name: None });
                    self.check_depth(&open, mark.line())?;
                    continue;
                }
                Event::MappingStart(..) => {
                    open.push(Open { node: Node { line, value: Value::Map(Vec::new()) }, name: None });
                    self.check_depth(&open, mark.line())?;
                    continue;
                }
                Event::SequenceEnd | Event::MappingEnd => match open.pop() {
                    Some(finished) => finished.node,
                    None => return Err(self.error(mark.line(), "this is no YAML")),
                },
                Event::Alias(_) => {
                    return Err(self.error(mark.line(), "aliases (*) are not read in a calibration"));
                }
                Event::DocumentEnd | Event::StreamEnd => return Err(self.error(1, "there is nothing in it")),
                Event::Nothing | Event::StreamStart | Event::DocumentStart => continue,
            };
            self.n_nodes += 1;
            if self.n_nodes > MAX_NODES {
                return Err(
                    self.error(mark.line(), format!("more than {MAX_NODES} values are no calibration"))
                );
            }
            let Some(parent) = open.last_mut() else { return Ok(finished) };
            match (&mut parent.node.value, parent.name.take()) {
                (Value::List(items), _) => items.push(finished),
                (Value::Map(entries), Some(name)) => entries.push((name, finished)),
                (Value::Map(_), None) => match finished.value {
                    Value::Word(word) => parent.name = Some(word),
                    _ => return Err(self.error(mark.line(), "a name must be a word")),
                },
                (Value::Word(_), _) => {}
            }
        }
    }

    fn check_depth(&self, open: &[Open], line: usize) -> Result<(), FileError> {
        if open.len() > MAX_DEPTH {
            return Err(self.error(line, format!("this is nested deeper than {MAX_DEPTH} levels")));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Yaml, FileError> {
        let path = Path::new("a.yaml");
        Yaml::parse(path, &TextFile::from_text(path, text))
    }

    fn numbers(text: &str) -> Vec<f64> {
        let yaml = parse(text).unwrap();
        yaml.numbers("k", yaml.root().get(&["k"]).unwrap()).unwrap()
    }

    #[test]
    fn lists_are_read_in_every_style() {
        for text in ["k: [1, 2.5,\n  -3e1]", "k:\n- 1\n- 2.5\n- -3e1\n", "k:\n  - 1\n  - 2.5 # c\n  - -3e1\n"]
        {
            assert_eq!(numbers(text), [1.0, 2.5, -30.0], "{text}");
        }
        assert_eq!(
            numbers("%YAML:1.0\n---\nk: !!opencv-matrix\n   rows: 1\n   data: [ 1., 2. ]\n"),
            [1.0, 2.0]
        );
        assert_eq!(numbers("k:\n- [1, 2]\n- [3, 4]\n"), [1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn what_is_wrong_is_told_by_its_line() {
        let message = |text: &str| parse(text).err().unwrap().to_string();
        assert!(message("a: [1\nb: 2").starts_with("a.yaml:"), "{}", message("a: [1\nb: 2"));
        assert!(message("a: &x [1]\nb: *x").contains("a.yaml:2: aliases"));
        assert!(message(&"[".repeat(MAX_DEPTH + 1)).contains("nested deeper"));
        assert!(message(&"[".repeat(100_000)).starts_with("a.yaml:1: "));
        let yaml = parse("a: 1\nk: [1, x]").unwrap();
        let refused = yaml.numbers("k", yaml.root().get(&["k"]).unwrap()).unwrap_err().to_string();
        assert_eq!(refused, "a.yaml:2: `x` in `k` is not a finite number");
        assert!(message("").contains("nothing in it"));
    }
}
