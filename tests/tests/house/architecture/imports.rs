//! Which modules a file names: its `use` items, and the paths in its code and in the arguments of its macros.
//! Test modules are left out.

use std::collections::{BTreeMap, BTreeSet};

use proc_macro2::{TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Attribute, File, ItemMod, ItemUse, Macro, Path, UseTree};

use super::sources::Sources;

/// A path from a crate's root or from another crate, in its segments.
pub(super) type Segments = Vec<String>;

/// What each file under `src` names, by the file's own module path.
pub(super) struct Imports {
    /// The file of each module.
    pub(super) files: BTreeMap<Segments, String>,
    /// The paths that each module names; those of its own crate begin with `crate`.
    pub(super) named: BTreeMap<Segments, BTreeSet<Segments>>,
}

impl Imports {
    /// Reads the files of one crate.
    pub(super) fn of(crate_sources: &Sources) -> Self {
        let mut imports = Self { files: BTreeMap::new(), named: BTreeMap::new() };
        for (path, text) in crate_sources {
            let module = module_of(path);
            if module.iter().any(|segment| segment == "tests") {
                continue;
            }
            let file: File = syn::parse_file(text).unwrap_or_else(|error| panic!("{path}: {error}"));
            let mut reader = Reader { module: module.clone(), depth: 0, named: BTreeSet::new() };
            reader.visit_file(&file);
            // A program beside a library has a root of its own: both are `crate`.
            imports.files.insert(module.clone(), path.clone());
            imports.named.entry(module).or_default().extend(reader.named);
        }
        imports
    }

    /// The module that a path of this crate leads into: the longest of its beginnings that is a file.
    pub(super) fn module(&self, path: &[String]) -> Option<&Segments> {
        let lengths = (1..=path.len()).rev();
        lengths
            .filter_map(|length| self.files.get_key_value(&path[..length]))
            .map(|(module, _)| module)
            .next()
    }
}

/// `server/src/service/maps.rs` is `crate::service::maps`.
fn module_of(path: &str) -> Segments {
    let (_, inside) = path.split_once("/src/").expect("the file is a source of a crate");
    let inside = inside.trim_end_matches(".rs");
    let inside = inside.strip_suffix("/mod").unwrap_or(inside);
    let own = inside.split('/').filter(|segment| !matches!(*segment, "lib" | "main"));
    std::iter::once("crate").chain(own).map(str::to_owned).collect()
}

struct Reader {
    module: Segments,
    /// Modules within the file that the reader is in.
    depth: usize,
    named: BTreeSet<Segments>,
}

impl Reader {
    /// Notes a path, from the crate's root.
    fn name(&mut self, path: &[String]) {
        let Some(first) = path.first() else { return };
        let own = self.module.len();
        let absolute = match first.as_str() {
            "crate" => path.to_vec(),
            "self" => [&self.module[..], &path[1..]].concat(),
            "super" => {
                let up = path.iter().take_while(|segment| *segment == "super").count();
                // A module within the file has the file's own module above it.
                let up_files = up.saturating_sub(self.depth);
                [&self.module[..own.saturating_sub(up_files)], &path[up..]].concat()
            }
            _ => path.to_vec(),
        };
        self.named.insert(absolute);
    }

    fn name_tree(&mut self, before: &mut Segments, tree: &UseTree) {
        match tree {
            UseTree::Path(path) => {
                before.push(path.ident.to_string());
                self.name_tree(before, &path.tree);
                before.pop();
            }
            UseTree::Name(name) => self.name_end(before, &name.ident.to_string()),
            UseTree::Rename(rename) => self.name_end(before, &rename.ident.to_string()),
            UseTree::Glob(_) => self.name(&before.clone()),
            UseTree::Group(group) => group.items.iter().for_each(|tree| self.name_tree(before, tree)),
        }
    }

    fn name_end(&mut self, before: &Segments, end: &str) {
        let end = (end != "self").then(|| end.to_owned());
        self.name(&before.iter().cloned().chain(end).collect::<Segments>());
    }

    /// Paths in what a macro is given are tokens yet.
    fn name_tokens(&mut self, tokens: TokenStream) {
        let mut path: Segments = Vec::new();
        let mut colons = 0;
        for token in tokens {
            match token {
                TokenTree::Ident(ident) => {
                    if colons != 2 {
                        self.end_path(&mut path);
                    }
                    path.push(ident.to_string());
                    colons = 0;
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' => colons += 1,
                TokenTree::Group(group) => {
                    self.end_path(&mut path);
                    self.name_tokens(group.stream());
                }
                TokenTree::Punct(_) | TokenTree::Literal(_) => {
                    self.end_path(&mut path);
                    colons = 0;
                }
            }
        }
        self.end_path(&mut path);
    }

    fn end_path(&mut self, path: &mut Segments) {
        if path.len() > 1 {
            self.name(path);
        }
        path.clear();
    }
}

fn is_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<Path>().is_ok_and(|condition| condition.is_ident("test"))
    })
}

impl<'ast> Visit<'ast> for Reader {
    fn visit_item_mod(&mut self, module: &'ast ItemMod) {
        if !is_for_tests(&module.attrs) && module.content.is_some() {
            self.depth += 1;
            visit::visit_item_mod(self, module);
            self.depth -= 1;
        }
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        if !is_for_tests(&item.attrs) {
            self.name_tree(&mut Vec::new(), &item.tree);
        }
    }

    fn visit_path(&mut self, path: &'ast Path) {
        if path.segments.len() > 1 {
            self.name(&path.segments.iter().map(|segment| segment.ident.to_string()).collect::<Segments>());
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, called: &'ast Macro) {
        self.name_tokens(called.tokens.clone());
        visit::visit_macro(self, called);
    }
}
