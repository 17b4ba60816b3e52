//! Who may depend on whom.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;
use std::sync::LazyLock;

use serde_json::Value;

use crate::harness::workspace;

/// What cargo knows of the workspace and all it depends on, on this machine's platform.
pub(crate) static METADATA: LazyLock<Value> = LazyLock::new(|| {
    let version = Command::new(env!("CARGO")).arg("-vV").output().unwrap();
    let version = String::from_utf8(version.stdout).unwrap();
    let host = version.lines().find_map(|line| line.strip_prefix("host: ")).expect("cargo names its host");
    let output = Command::new(env!("CARGO"))
        .current_dir(workspace())
        .args(["metadata", "--format-version", "1", "--locked", "--filter-platform", host])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
});

/// May depend on any other member.
const ANY: &[&str] = &["*"];

/// Member, and the members that it may depend on where no feature is asked for.
const ALLOWED: [(&str, &[&str]); 16] = [
    ("fabmap", &[]),
    ("posegraph", &[]),
    ("topomap", &["fabmap", "posegraph"]),
    ("waypost-navigation", &["fabmap", "posegraph", "topomap"]),
    ("waypost-vision", &["fabmap", "posegraph", "topomap", "waypost-navigation"]),
    ("waypost-sim", &[]),
    ("waypost-proto", &[]),
    ("waypost-bags", &[]),
    ("waypost-ros-messages", &["waypost-proto"]),
    (
        "waypost-server",
        &["fabmap", "posegraph", "topomap", "waypost-navigation", "waypost-vision", "waypost-proto"],
    ),
    ("waypost-client", &["waypost-proto"]),
    (
        "waypost-cli",
        &["waypost-bags", "waypost-client", "waypost-proto", "waypost-ros-messages", "waypost-sim"],
    ),
    ("waypost-ros", &["waypost-bags", "waypost-client", "waypost-ros-messages"]),
    ("waypost-eval", ANY),
    ("waypost-e2e", ANY),
    ("waypost-fuzz", ANY),
];

/// Members, and what none of their normal dependencies may be, however deep, where no feature is asked for.
const FORBIDDEN: [(&str, &[&str]); 11] = [
    ("fabmap", &["tokio", "serde", "sqlx", "opencv", "tonic"]),
    ("posegraph", &["tokio", "serde", "sqlx", "opencv", "tonic"]),
    ("topomap", &["tokio", "serde", "sqlx", "opencv", "tonic"]),
    ("waypost-navigation", &["tokio", "serde", "sqlx", "opencv", "tonic"]),
    ("waypost-sim", &["tokio", "serde", "sqlx", "opencv", "tonic"]),
    ("waypost-bags", &["tokio", "sqlx", "opencv", "tonic"]),
    ("waypost-proto", &["opencv", "sqlx"]),
    ("waypost-client", &["opencv", "sqlx"]),
    ("waypost-cli", &["opencv", "sqlx", "rustdds"]),
    ("waypost-ros", &["opencv", "sqlx"]),
    ("waypost-server", &["rustdds"]),
];

/// The one member that may name OpenCV.
const OPENCV: &str = "waypost-vision";

fn members() -> BTreeMap<&'static str, &'static Value> {
    let ids: BTreeSet<&str> = strings(&METADATA["workspace_members"]).collect();
    let packages = METADATA["packages"].as_array().unwrap().iter();
    let members = packages.filter(|package| ids.contains(package["id"].as_str().unwrap()));
    members.map(|package| (package["name"].as_str().unwrap(), package)).collect()
}

fn strings(array: &'static Value) -> impl Iterator<Item = &'static str> {
    array.as_array().unwrap().iter().map(|value| value.as_str().unwrap())
}

/// Normal dependencies that are always there, by name.
fn dependencies(package: &'static Value) -> impl Iterator<Item = &'static str> {
    let dependencies = package["dependencies"].as_array().unwrap().iter();
    let normal =
        dependencies.filter(|dependency| dependency["kind"].is_null() && dependency["optional"] == false);
    normal.map(|dependency| dependency["name"].as_str().unwrap())
}

#[test]
fn members_depend_on_those_they_may() {
    let members = members();
    assert!(members.len() >= 8, "{:?}", members.keys());
    for (&member, package) in &members {
        let allowed = ALLOWED.iter().find(|(name, _)| *name == member);
        let (_, allowed) =
            allowed.unwrap_or_else(|| panic!("{member} is new: say here what it may depend on"));
        for dependency in dependencies(package).filter(|dependency| members.contains_key(dependency)) {
            let may = *allowed == ANY || allowed.contains(&dependency);
            assert!(may, "{member} must not depend on {dependency}");
        }
        if member != OPENCV {
            let mut all = package["dependencies"].as_array().unwrap().iter();
            assert!(
                !all.any(|dependency| dependency["name"] == "opencv"),
                "only {OPENCV} may link OpenCV, not {member}"
            );
        }
    }
    assert!(
        dependencies(members[OPENCV]).any(|dependency| dependency == "opencv"),
        "this test sees no dependencies"
    );
}

#[test]
fn pure_crates_stay_pure_however_deep() {
    for (member, forbidden) in FORBIDDEN {
        let reached = normal_closure(member);
        assert!(reached.contains(member) && reached.len() > 3, "this test sees no dependencies of {member}");
        for name in forbidden {
            assert!(!reached.contains(*name), "{member} depends on {name}, if not directly");
        }
    }
    let server = normal_closure("waypost-server");
    assert!(server.contains("opencv") && server.contains("sqlx"), "this test does not see deep");
}

/// What only tests need may not switch on what programs are then built without: they would be compiled twice, and those
/// that are tested would not be those that ship. The end-to-end tests' Cargo.toml says how that is so.
#[test]
fn programs_are_built_with_the_features_that_tests_have() {
    let shipped = features("normal,build");
    let tested = features("normal,build,dev");
    assert!(shipped.len() > 300 && tested.len() > shipped.len(), "this test sees no dependencies");
    let apart: Vec<&String> = shipped.difference(&tested).collect();
    assert!(
        apart.is_empty(),
        "name among the dependencies of tests/Cargo.toml what gives these more: {apart:#?}"
    );
}

/// Each package of the workspace and of what it depends on by these edges, with its version and features.
fn features(edges: &str) -> BTreeSet<String> {
    tree(&["--workspace", "--edges", edges, "--format", "{p} {f}"])
}

/// Names of all packages that a member needs when it is built for itself, its own among them.
fn normal_closure(member: &str) -> BTreeSet<String> {
    tree(&["--no-default-features", "--edges", "normal", "--format", "{p}", "--package", member])
        .iter()
        .filter_map(|line| line.split_whitespace().next())
        .map(str::to_owned)
        .collect()
}

/// The lines of `cargo tree`, each once.
fn tree(arguments: &[&str]) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO"))
        .current_dir(workspace())
        .args(["tree", "--locked", "--prefix", "none"])
        .args(arguments)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = String::from_utf8(output.stdout).unwrap();
    // What was there already is marked.
    lines.lines().map(|line| line.trim_end_matches(" (*)").to_owned()).collect()
}
