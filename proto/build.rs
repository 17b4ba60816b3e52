//! Compiles the contract with protox: no protoc is needed.

use std::path::PathBuf;

use prost::Message;

const FILES: [&str; 7] = [
    "waypost/v1/model.proto",
    "waypost/v1/map.proto",
    "waypost/v1/session.proto",
    "waypost/v1/navigation.proto",
    "waypost/v1/merge.proto",
    "waypost/v1/appearance.proto",
    "waypost/v1/token.proto",
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=waypost");
    println!("cargo:rerun-if-changed=google");
    let descriptors = protox::compile(FILES, ["."])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    tonic_prost_build::configure().build_transport(true).compile_fds(descriptors)?;
    Ok(())
}
