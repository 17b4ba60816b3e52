//! Files beside each other that import one another in a circle.

use std::collections::{BTreeMap, BTreeSet};

use super::imports::{Imports, Segments};
use super::sources::{Sources, crates};

/// One line for each circle: the folder and the modules in it.
pub(super) fn circles(sources: &Sources) -> Vec<String> {
    let mut found = Vec::new();
    for (name, crate_sources) in crates(sources) {
        let imports = Imports::of(&crate_sources);
        let parents: BTreeSet<&[String]> = imports.files.keys().map(parent).collect();
        for folder in parents {
            for circle in circles_in(folder, &imports) {
                found.push(format!(
                    "{name}: {} imports in a circle: {}",
                    folder.join("::"),
                    circle.join(" ↔ ")
                ));
            }
        }
    }
    found
}

fn parent(module: &Segments) -> &[String] {
    &module[..module.len().saturating_sub(1)]
}

/// Circles among the modules right under `folder`, each with all that lies under it.
fn circles_in(folder: &[String], imports: &Imports) -> Vec<Vec<String>> {
    let child = |module: &[String]| {
        (module.len() > folder.len() && module.starts_with(folder)).then(|| module[folder.len()].clone())
    };
    let mut edges: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (module, named) in &imports.named {
        let Some(from) = child(module) else { continue };
        let to = named.iter().filter_map(|path| imports.module(path)).filter_map(|module| child(module));
        edges.entry(from.clone()).or_default().extend(to.filter(|to| *to != from));
    }
    let reach: BTreeMap<&str, BTreeSet<&str>> =
        edges.keys().map(|from| (from.as_str(), reachable(from, &edges))).collect();
    let mut circles: BTreeSet<Vec<String>> = BTreeSet::new();
    for (&from, there) in reach.iter().filter(|(from, there)| there.contains(*from)) {
        let back = there.iter().filter(|to| reach.get(**to).is_some_and(|back| back.contains(from)));
        circles.insert(back.map(|&to| to.to_owned()).collect());
    }
    circles.into_iter().collect()
}

/// What can be reached from `start` by one edge or more.
fn reachable<'a>(start: &str, edges: &'a BTreeMap<String, BTreeSet<String>>) -> BTreeSet<&'a str> {
    let mut reached = BTreeSet::new();
    let mut open: Vec<&str> = edges.get(start).into_iter().flatten().map(String::as_str).collect();
    while let Some(module) = open.pop() {
        if reached.insert(module) {
            open.extend(edges.get(module).into_iter().flatten().map(String::as_str));
        }
    }
    reached
}
