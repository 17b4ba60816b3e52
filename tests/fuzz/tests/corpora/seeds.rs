//! What the corpora begin with: our own fixtures, and the smallest of everything that is taken.
//! `cargo test --release -p waypost-fuzz -- --ignored make_the_seeds` writes it. Bags and messages of ROS come from the tests of
//! `bags`, whose `keep_seeds` does the same.

mod calls;
mod files;
mod texts;

use std::path::PathBuf;

use waypost_fuzz::{Fed, corpus, named};

/// One file of a corpus.
struct Seed {
    target: &'static str,
    name: String,
    bytes: Vec<u8>,
}

impl Seed {
    fn new(target: &'static str, name: impl Into<String>, bytes: impl Into<Vec<u8>>) -> Self {
        Self { target, name: name.into(), bytes: bytes.into() }
    }
}

fn all() -> Vec<Seed> {
    let groups = [texts::seeds(), files::seeds(), calls::grpc(), calls::rest()];
    groups.into_iter().flatten().collect()
}

/// A file of the repository.
fn fixture(path: &str) -> Vec<u8> {
    let root: PathBuf = [env!("CARGO_MANIFEST_DIR"), "..", ".."].iter().collect();
    std::fs::read(root.join(path)).unwrap()
}

/// What is taken is called so, and a test holds it to that; what is refused is kept for what it nearly is. What becomes of a call
/// depends on those before it.
#[test]
#[ignore = "writes the seeds of all targets but those of bags"]
fn make_the_seeds() {
    for Seed { target, name, bytes } in all() {
        let folder = corpus::directory().join(target);
        std::fs::create_dir_all(&folder).unwrap();
        let fed = (named(target).unwrap().feed)(&bytes);
        let is_call = ["grpc", "rest"].contains(&target);
        let name = if fed == Fed::Taken && !is_call { format!("taken-{name}") } else { name };
        std::fs::write(folder.join(name), bytes).unwrap();
    }
}
