//! The Rust files of the workspace, as text.

use std::collections::BTreeMap;
use std::path::Path;

use crate::harness::workspace;

/// Files by their path in the repository, with `/` between folders.
pub(super) type Sources = BTreeMap<String, String>;

/// Every Rust file of the workspace's own packages: sources, tests, benches and examples.
pub(super) fn all() -> Sources {
    let mut sources = Sources::new();
    for entry in std::fs::read_dir(workspace()).unwrap() {
        let folder = entry.unwrap().path();
        if folder.join("Cargo.toml").is_file() {
            collect(&folder, &mut sources);
        }
    }
    assert!(sources.len() > 400, "only {} files: this test sees too little", sources.len());
    sources
}

fn collect(folder: &Path, sources: &mut Sources) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let hidden = path.file_name().unwrap().to_string_lossy().starts_with('.');
        if path.is_dir() && !hidden && !path.ends_with("target") {
            collect(&path, sources);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let name = path.strip_prefix(workspace()).unwrap().to_string_lossy().replace('\\', "/");
            sources.insert(name, std::fs::read_to_string(&path).unwrap());
        }
    }
}

/// What a crate is made of: its folder and the files under its `src`.
pub(super) fn crates(sources: &Sources) -> BTreeMap<&str, Sources> {
    let mut crates: BTreeMap<&str, Sources> = BTreeMap::new();
    for (path, text) in sources {
        if let Some((folder, _)) = path.split_once("/src/") {
            crates.entry(folder).or_default().insert(path.clone(), text.clone());
        }
    }
    crates
}
