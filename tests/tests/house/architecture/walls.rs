//! Which folder may import which, where SQL may stand, what pure crates leave alone, how long a file may be.

use syn::LitStr;
use syn::visit::Visit;

use super::imports::{Imports, Segments};
use super::sources::{Sources, crates};

/// A folder and what no file in it may name: modules of its own crate (`crate::…`) or other crates.
pub(super) struct Wall {
    pub(super) folder: &'static str,
    pub(super) never: &'static [&'static str],
}

/// A crate that may be named in these folders alone, within the folder of one crate.
pub(super) struct Door {
    pub(super) crate_folder: &'static str,
    pub(super) named: &'static str,
    pub(super) only_in: &'static [&'static str],
}

/// One line for each import that goes through a wall.
pub(super) fn walls_broken(sources: &Sources, walls: &[Wall]) -> Vec<String> {
    let mut broken = Vec::new();
    for (_, crate_sources) in crates(sources) {
        let imports = Imports::of(&crate_sources);
        for (module, path) in named(&imports) {
            let file = &imports.files[module];
            for wall in walls.iter().filter(|wall| is_within(file, wall.folder)) {
                let never = wall.never.iter().find(|never| leads_into(path, never));
                broken.extend(never.map(|never| format!("{file} names {never}: {}", path.join("::"))));
            }
        }
    }
    broken
}

/// One line for each file that names a crate outside of the folders that may.
pub(super) fn doors_passed(sources: &Sources, doors: &[Door]) -> Vec<String> {
    let mut passed = Vec::new();
    for (_, crate_sources) in crates(sources) {
        let imports = Imports::of(&crate_sources);
        for (module, path) in named(&imports) {
            let file = &imports.files[module];
            for door in doors.iter().filter(|door| is_within(file, door.crate_folder)) {
                let may = door.only_in.iter().any(|folder| is_within(file, folder));
                if leads_into(path, door.named) && !may {
                    passed.push(format!("{file} names {}, which only {:?} may", door.named, door.only_in));
                }
            }
        }
    }
    passed.dedup();
    passed
}

fn named(imports: &Imports) -> impl Iterator<Item = (&Segments, &Segments)> {
    imports.named.iter().flat_map(|(module, paths)| paths.iter().map(move |path| (module, path)))
}

/// A file lies within a folder, or is the file that the folder's module is.
fn is_within(file: &str, folder: &str) -> bool {
    file.strip_prefix(folder).is_some_and(|rest| rest.starts_with('/') || rest == ".rs")
}

fn leads_into(path: &[String], place: &str) -> bool {
    let place: Vec<&str> = place.split("::").collect();
    path.len() >= place.len() && path.iter().zip(&place).all(|(segment, wanted)| segment == wanted)
}

/// One line for each text that reads as SQL in a crate's sources outside of `folders`.
pub(super) fn sql_outside(sources: &Sources, folders: &[&str]) -> Vec<String> {
    let mut found = Vec::new();
    for crate_sources in crates(sources).values() {
        let outside = |path: &str| !folders.iter().any(|folder| is_within(path, folder));
        for (path, text) in crate_sources.iter().filter(|(path, _)| outside(path)) {
            let file = syn::parse_file(text).unwrap_or_else(|error| panic!("{path}: {error}"));
            let mut texts = Texts(Vec::new());
            texts.visit_file(&file);
            let sql = texts.0.into_iter().filter(|text| is_sql(text));
            found.extend(sql.map(|text| format!("{path} has SQL: {text:?}")));
        }
    }
    found
}

struct Texts(Vec<String>);

impl Visit<'_> for Texts {
    fn visit_lit_str(&mut self, text: &LitStr) {
        self.0.push(text.value());
    }
}

fn is_sql(text: &str) -> bool {
    let words: Vec<&str> = text.split_whitespace().collect();
    let has = |word: &str| words.contains(&word);
    match words.first().copied() {
        Some("SELECT") => has("FROM"),
        Some("INSERT") => has("INTO"),
        Some("UPDATE") => has("SET"),
        Some("DELETE") => has("FROM"),
        Some("PRAGMA" | "VACUUM") => true,
        Some("CREATE" | "DROP" | "ALTER") => has("TABLE") || has("INDEX"),
        Some(_) | None => false,
    }
}

/// A file that says in its first line why it is long.
const REASON: &str = "// long: ";

/// One line for each file of more than `most_lines` that does not say why, and one if more than `most_reasons` do.
pub(super) fn long_files(sources: &Sources, most_lines: usize, most_reasons: usize) -> Vec<String> {
    let long = || sources.iter().filter(|(_, text)| text.lines().count() > most_lines);
    let silent = long().filter(|(_, text)| !text.starts_with(REASON));
    let mut found: Vec<String> = silent
        .map(|(path, text)| format!("{path} has {} lines and no reason in its first", text.lines().count()))
        .collect();
    let reasons = long().count() - found.len();
    if reasons > most_reasons {
        found.push(format!("{reasons} files are long with a reason; {most_reasons} may be"));
    }
    found
}
