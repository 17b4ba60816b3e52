//! The contract reads as it should, and breaks nobody who speaks what was released.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test fails by panicking")]

mod breaking;
mod elements;
mod lint;

use std::path::{Path, PathBuf};

use prost::Message;
use prost_types::FileDescriptorSet;
use waypost_proto::FILE_DESCRIPTOR_SET;

use breaking::broken;
use lint::unclean;

/// What is wrong, and with what.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Finding {
    /// Full name of the element, as `waypost.v1.Frame.sequence`.
    element: String,
    wrong: String,
}

impl Finding {
    fn new(element: &str, wrong: impl Into<String>) -> Self {
        Self { element: element.to_owned(), wrong: wrong.into() }
    }
}

fn contract() -> FileDescriptorSet {
    FileDescriptorSet::decode(FILE_DESCRIPTOR_SET).unwrap()
}

/// The contract of the last release, or of what early users run.
fn released() -> FileDescriptorSet {
    let file = released_file();
    let bytes = std::fs::read(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    FileDescriptorSet::decode(bytes.as_slice()).unwrap()
}

fn released_file() -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("released");
    let files = std::fs::read_dir(&folder).unwrap().map(|file| file.unwrap().path());
    let mut files: Vec<PathBuf> =
        files.filter(|file| file.extension().is_some_and(|end| end == "binpb")).collect();
    assert_eq!(files.len(), 1, "{} holds the last release alone: {files:?}", folder.display());
    files.remove(0)
}

#[track_caller]
fn assert_none(findings: &[Finding]) {
    let lines: Vec<String> =
        findings.iter().map(|finding| format!("{}: {}", finding.element, finding.wrong)).collect();
    assert!(findings.is_empty(), "\n{}", lines.join("\n"));
}

#[test]
fn the_contract_is_clean() {
    assert_none(&unclean(&contract()));
}

#[test]
fn the_contract_breaks_nobody() {
    assert_none(&broken(&released(), &contract()));
}

/// A contract that was not read at all would be clean and break nobody.
#[test]
fn both_contracts_are_seen_whole() {
    for (set, services) in [(contract(), 10), (released(), 8)] {
        let elements = elements::Elements::of(&set);
        assert!(elements.services.len() >= services, "{:?}", elements.services.keys());
        assert!(elements.messages.len() >= 50, "{:?}", elements.messages.keys());
        assert!(elements.enums.len() >= 6, "{:?}", elements.enums.keys());
        assert!(elements.messages.contains_key("waypost.v1.StreamRequest"));
        assert!(elements.enums.contains_key("waypost.v1.Panorama.Projection"));
    }
}

/// Not a test, but what keeps the contract of a release: see README.md beside the file that it writes.
#[test]
#[ignore = "run at a release: it makes the contract of today the one that must not be broken"]
fn keep_the_contract_of_this_release() {
    let mut set = contract();
    for file in &mut set.file {
        file.source_code_info = None;
    }
    let older = released_file();
    let file = older.with_file_name(concat!("waypost-v1-", env!("CARGO_PKG_VERSION"), ".binpb"));
    std::fs::write(&file, set.encode_to_vec()).unwrap();
    if older != file {
        std::fs::remove_file(older).unwrap();
    }
}
