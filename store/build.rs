//! Embeds the migrations: writes the lists that `src/migrations.rs` includes.
//!
//! The macro of `sqlx` that does it would compile the whole of SQLite a second time, for the compiler's side.

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=../migrations");
    let folder = Path::new(&env::var("CARGO_MANIFEST_DIR")?).join("../migrations").canonicalize()?;
    write_list(&folder, "migrations.rs")?;
    write_list(&folder.join("postgres"), "migrations_postgres.rs")
}

/// Writes the list of a folder's migrations.
fn write_list(folder: &Path, name: &str) -> Result<(), Box<dyn Error>> {
    let mut files: Vec<PathBuf> =
        fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<Result<_, std::io::Error>>()?;
    files.retain(|path| path.extension().is_some_and(|extension| extension == "sql"));
    files.sort();
    let mut list = String::from("[\n");
    for path in files {
        let name = path.file_stem().and_then(|name| name.to_str()).ok_or("a migration's name is not text")?;
        let (version, description) =
            name.split_once('_').ok_or_else(|| format!("{name}.sql is not named NNNN_what_it_does.sql"))?;
        let (version, description): (i64, _) = (version.parse()?, description.replace('_', " "));
        writeln!(list, "    ({version}, {description:?}, include_str!({path:?})),")?;
    }
    list.push_str("]\n");
    fs::write(Path::new(&env::var("OUT_DIR")?).join(name), list)?;
    Ok(())
}
