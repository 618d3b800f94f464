//! Generates the messages, the server trait and the client from the .proto files, in pure Rust: no protoc.

use std::{env, error::Error, fs, path::PathBuf};

use prost::Message;

const PROTO_FILES: [&str; 1] = ["monoslam/v1/slam.proto"];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=monoslam");
    let files = protox::compile(PROTO_FILES, ["."])?;

    let out_dir = PathBuf::from(env::var("OUT_DIR")?);
    fs::write(out_dir.join("monoslam_descriptor.bin"), files.encode_to_vec())?;

    tonic_prost_build::configure()
        // Images arrive as slices of the receive buffer instead of being copied out of it.
        .bytes(".monoslam.v1.Image.data")
        // Files leave as they are read.
        .bytes(".monoslam.v1.ExportMapResponse.data")
        .compile_fds(files)?;
    Ok(())
}
