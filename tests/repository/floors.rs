//! The floors of ARCHITECTURE.md: inside a crate, modules import only what stands below them.
//!
//! The list is read from the fenced block `floors` of ARCHITECTURE.md: one line per crate, floors from the
//! ground up separated by `<`, the modules of one floor, which do not import each other, separated by commas.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The floor of each module of a crate, from the ground up.
type Floors = BTreeMap<String, usize>;

#[test]
fn modules_import_only_what_stands_below_them() {
    let root = repository();
    let architecture = fs::read_to_string(root.join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    let crates = read_floors(&architecture);
    assert!(["slam", "optim", "server"].iter().all(|name| crates.contains_key(*name)), "{:?}", crates.keys());
    let mut wrong = Vec::new();
    for (name, floors) in &crates {
        let source = root.join(name).join("src");
        let listed: BTreeSet<&String> = floors.keys().collect();
        let modules = top_modules(&source);
        let there: BTreeSet<&String> = modules.keys().collect();
        for missing in there.difference(&listed) {
            wrong.push(format!("{name}: module `{missing}` stands on no floor"));
        }
        for gone in listed.difference(&there) {
            wrong.push(format!("{name}: there is no module `{gone}`"));
        }
        let mut n_imports = 0;
        for (module, files) in &modules {
            for file in files {
                let text = fs::read_to_string(file).expect("a source file");
                let depth = depth_of(&source, file);
                let imported = imports(&text, depth);
                n_imports += imported.len();
                let upward = imported.iter().filter(|other| goes_up(floors, module, other));
                wrong.extend(upward.map(|other| {
                    let file = file.strip_prefix(&root).expect("a file of the repository").display();
                    format!("{file}: `{module}` imports `{other}`, which does not stand below it")
                }));
            }
        }
        assert!(n_imports > 0, "{name}: no import was found, so nothing was tested");
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn an_arrow_that_goes_up_is_noticed() {
    let floors = read_floors("```floors\nx: map, config < bundle < pipeline\n```").remove("x").expect("x");
    assert!(!goes_up(&floors, "bundle", "map"));
    assert!(!goes_up(&floors, "bundle", "bundle"));
    assert!(goes_up(&floors, "map", "bundle"));
    assert!(goes_up(&floors, "map", "config"), "modules of one floor do not import each other");
}

#[test]
fn imports_are_found_in_all_their_forms() {
    let text = "use crate::map::{A, B};\nuse crate::{bundle, loops::C};\nfn f() { crate::mapping::g() }\n\
                use super::pose::P;\nuse super::super::report::R;\n// crate::comment::X\n\
                #[cfg(test)]\nmod tests {\n    use crate::pipeline::P;\n}\n";
    let found = |depth| imports(text, depth).into_iter().collect::<Vec<_>>();
    assert_eq!(found(2), ["bundle", "loops", "map", "mapping", "report"]);
    assert_eq!(found(1)[..5], ["bundle", "loops", "map", "mapping", "pose"]);
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace").to_path_buf()
}

fn read_floors(architecture: &str) -> BTreeMap<String, Floors> {
    let block = architecture.split("```floors\n").nth(1).and_then(|rest| rest.split("```").next());
    let lines = block.expect("a fenced block `floors`").lines().filter(|line| !line.trim().is_empty());
    lines
        .map(|line| {
            let (name, floors) = line.split_once(':').expect("`crate: floors`");
            let floors = floors.split('<').enumerate().flat_map(|(floor, modules)| {
                modules.split(',').map(move |module| (module.trim().to_owned(), floor))
            });
            (name.trim().to_owned(), floors.collect())
        })
        .collect()
}

fn goes_up(floors: &Floors, module: &str, imported: &str) -> bool {
    match (floors.get(module), floors.get(imported)) {
        _ if module == imported => false,
        (Some(from), Some(to)) => to >= from,
        // Items of the crate's root are no modules.
        _ => false,
    }
}

/// The files of each module at the root of a crate; tests and the root itself apart.
fn top_modules(source: &Path) -> BTreeMap<String, Vec<PathBuf>> {
    let mut modules: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for file in rust_files(source) {
        let relative = file.strip_prefix(source).expect("a file of the crate");
        let top = relative.components().next().expect("a name").as_os_str().to_string_lossy();
        let module = top.trim_end_matches(".rs").to_owned();
        let stem = file.file_stem().expect("a name").to_string_lossy().into_owned();
        let is_test =
            stem == "tests" || stem.ends_with("_tests") || relative.iter().any(|part| part == "tests");
        if !is_test && !["lib", "main"].contains(&module.as_str()) {
            modules.entry(module).or_default().push(file);
        }
    }
    modules
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// How many modules deep a file's own module stands: 1 for `src/map.rs` and `src/map/mod.rs`.
fn depth_of(source: &Path, file: &Path) -> usize {
    let relative = file.strip_prefix(source).expect("a file of the crate");
    relative.components().count() - usize::from(file.ends_with("mod.rs"))
}

/// The modules at the crate's root that a file of the given depth names, its unit tests left out.
fn imports(text: &str, depth: usize) -> BTreeSet<String> {
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let code: String =
        code.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n");
    let mut found = BTreeSet::new();
    for prefix in ["crate::".to_owned(), format!("use {}", "super::".repeat(depth))] {
        for (at, _) in code.match_indices(&prefix) {
            let preceded = code[..at].chars().next_back();
            if preceded.is_some_and(|before| before.is_alphanumeric() || before == '_' || before == '$') {
                continue;
            }
            found.extend(first_names(&code[at + prefix.len()..]));
        }
    }
    found.remove("super");
    found
}

/// The first names of a path, or of each path of a group in braces.
fn first_names(path: &str) -> Vec<String> {
    let name = |text: &str| text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let Some(group) = path.strip_prefix('{') else { return vec![name(path)] };
    let (mut names, mut depth, mut at_start) = (Vec::new(), 1, true);
    for (at, character) in group.char_indices() {
        match character {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 1 => at_start = true,
            _ if at_start && depth == 1 && !character.is_whitespace() => {
                names.push(name(&group[at..]));
                at_start = false;
            }
            _ => {}
        }
        if depth == 0 {
            break;
        }
    }
    names
}
