//! Commands of `cargo` in documents: the crates and targets they name are there.

use super::files;
use std::path::Path;

/// The commands of a text, each as its words: from `cargo` to the end of the line or of the code.
fn commands(text: &str) -> Vec<Vec<&str>> {
    text.lines()
        .flat_map(|line| line.match_indices("cargo ").map(|(at, _)| &line[at..]))
        .map(|rest| rest.split(['`', '#']).next().unwrap_or(rest).split_whitespace().collect())
        .collect()
}

/// The word after one of `flags`.
fn value<'a>(words: &[&'a str], flags: &[&str]) -> Option<&'a str> {
    // What comes after a lone `--` is for the program.
    let own = words.iter().position(|word| *word == "--").map_or(words, |end| &words[..end]);
    own.windows(2).find(|pair| flags.contains(&pair[0])).map(|pair| pair[1])
}

/// Whether `folder/NAME.rs`, `folder/NAME/main.rs` or a mention of the name in the manifest makes it a
/// target.
fn has_target(package: &Path, folder: &str, name: &str) -> bool {
    let manifest = std::fs::read_to_string(package.join("Cargo.toml")).unwrap_or_default();
    package.join(folder).join(format!("{name}.rs")).is_file()
        || package.join(folder).join(name).join("main.rs").is_file()
        || manifest.contains(&format!("name = \"{name}\""))
}

/// What is wrong with a command; `None` if all it names is there.
fn fault(words: &[&str]) -> Option<String> {
    let command = words.join(" ");
    let name = value(words, &["-p", "--package"])?;
    let package = files::root().join(name);
    if !package.join("Cargo.toml").is_file() {
        return Some(format!("there is no crate {name}: {command}"));
    }
    let folders =
        [("--example", "examples"), ("--bin", "src/bin"), ("--test", "tests"), ("--bench", "benches")];
    folders.iter().find_map(|(flag, folder)| {
        let target = value(words, &[flag])?;
        (!has_target(&package, folder, target)).then(|| format!("{name} has no {flag} {target}: {command}"))
    })
}

#[test]
fn commands_of_documents_name_targets_that_exist() {
    let (mut n_commands, mut faults) = (0, Vec::new());
    for document in files::with_extension("md") {
        // Paragraphs are wrapped: a command may go on in the next line.
        let text = document.text.replace("\n  ", " ");
        for words in commands(&text) {
            n_commands += 1;
            faults.extend(fault(&words).map(|fault| format!("{}: {fault}", document.path.display())));
        }
    }
    assert!(n_commands > 10, "only {n_commands} commands found: the search for them is broken");
    assert!(faults.is_empty(), "{} of {n_commands} commands:\n{}", faults.len(), faults.join("\n"));
}

#[test]
fn commands_that_name_nothing_are_noticed() {
    let of = |line: &str| commands(line).iter().find_map(|words| fault(words));
    assert!(
        of("run `cargo run --release -p testkit --bin track_synthetic -- room-poor 1..20` twice").is_none()
    );
    assert!(of("cargo test --workspace").is_none());
    assert!(of("`cargo bench -p vision --bench lines` and others").is_none());
    assert!(of("cargo test -p nothing").is_some());
    assert!(of("cargo run -p slam --example track_synthetic").is_some());
    assert!(of("`cargo test -p slam --test nothing`, `cargo test`").is_some());
}
