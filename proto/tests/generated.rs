//! What is committed in `src/generated` is what `monoslam/v1/slam.proto` gives.
//!
//! After a change of the .proto file: `UPDATE_GENERATED=1 cargo test -p proto --test generated`.

use std::error::Error;
use std::path::Path;
use std::{env, fs};

use prost::Message;

const PROTO_FILES: [&str; 1] = ["monoslam/v1/slam.proto"];

/// The files that are generated, in `src/generated`.
const GENERATED: [&str; 2] = ["monoslam.v1.rs", "descriptor.bin"];

/// Compiles the .proto files in pure Rust (no protoc) and writes the messages, the server trait and the
/// client.
fn generate(folder: &Path) -> Result<(), Box<dyn Error>> {
    let files = protox::compile(PROTO_FILES, [env!("CARGO_MANIFEST_DIR")])?;
    fs::write(folder.join(GENERATED[1]), files.encode_to_vec())?;
    tonic_prost_build::configure()
        // Images arrive as slices of the receive buffer instead of being copied out of it.
        .bytes(".monoslam.v1.Image.data")
        // Files leave as they are read.
        .bytes(".monoslam.v1.ExportMapResponse.data")
        // How a connection is made is the client's business.
        .build_transport(false)
        .emit_rerun_if_changed(false)
        .out_dir(folder)
        .compile_fds(files)?;
    Ok(())
}

#[test]
fn the_generated_code_is_that_of_the_proto_file() -> Result<(), Box<dyn Error>> {
    let committed = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/generated");
    if env::var_os("UPDATE_GENERATED").is_some() {
        generate(&committed)?;
    }
    let fresh = tempfile::tempdir()?;
    generate(fresh.path())?;
    for name in GENERATED {
        assert!(
            fs::read(committed.join(name))? == fs::read(fresh.path().join(name))?,
            "proto/src/generated/{name} is stale: run UPDATE_GENERATED=1 cargo test -p proto --test generated"
        );
    }
    Ok(())
}
