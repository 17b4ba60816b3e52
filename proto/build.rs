//! Compiles the contract with protox: no protoc is needed. Then writes the messages' JSON and flags.

#[path = "build/flags.rs"]
mod flags;
#[path = "build/json.rs"]
mod json;

use std::path::PathBuf;

use prost::Message;

const FILES: [&str; 13] = [
    "waypost/v1/job.proto",
    "waypost/v1/model.proto",
    "waypost/v1/map.proto",
    "waypost/v1/correction.proto",
    "waypost/v1/label.proto",
    "waypost/v1/recognition.proto",
    "waypost/v1/session.proto",
    "waypost/v1/navigation.proto",
    "waypost/v1/merge.proto",
    "waypost/v1/appearance.proto",
    "waypost/v1/event.proto",
    "waypost/v1/token.proto",
    "waypost/v1/cluster.proto",
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=waypost");
    println!("cargo:rerun-if-changed=google");
    println!("cargo:rerun-if-changed=build");
    let descriptors = protox::compile(FILES, ["."])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    std::fs::write(out.join("json.rs"), json::generate(&descriptors))?;
    std::fs::write(out.join("flags.rs"), flags::generate(&descriptors))?;
    std::fs::write(out.join("openapi.rs"), json::describe(&descriptors))?;
    tonic_prost_build::configure().build_transport(true).compile_fds(descriptors)?;
    Ok(())
}
