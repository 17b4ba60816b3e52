//! Everything that is built in may be passed on under terms that we accept.

use std::iter::Peekable;
use std::vec::IntoIter;

use super::dependencies::METADATA;

/// SPDX identifiers of the terms that we accept; `A WITH B` is an identifier of its own.
const ACCEPTED: [&str; 18] = [
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-1-Clause",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "CDLA-Permissive-2.0",
    "ISC",
    "MIT",
    "MIT-0",
    "MPL-2.0",
    // As MIT; libFuzzer, which no program of ours links but the one that scripts/fuzz builds.
    "NCSA",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
    "bzip2-1.0.6",
];

/// What is said of an expression.
#[derive(Debug, PartialEq)]
enum Verdict {
    Accepted,
    Refused,
    /// Not an SPDX expression.
    Unreadable,
}

/// Whether the terms that an SPDX expression offers can be met within [`ACCEPTED`].
fn verdict(expression: &str) -> Verdict {
    // Old manifests separate alternatives by a slash.
    let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
    let tokens: Vec<String> = spaced.split_whitespace().map(str::to_owned).collect();
    let mut tokens = tokens.into_iter().peekable();
    match (any_of(&mut tokens), tokens.next()) {
        (Some(true), None) => Verdict::Accepted,
        (Some(false), None) => Verdict::Refused,
        (None, _) | (_, Some(_)) => Verdict::Unreadable,
    }
}

type Tokens = Peekable<IntoIter<String>>;

/// Terms joined by OR, which binds least.
fn any_of(tokens: &mut Tokens) -> Option<bool> {
    let mut accepted = all_of(tokens)?;
    while tokens.next_if(|token| token == "OR").is_some() {
        accepted |= all_of(tokens)?;
    }
    Some(accepted)
}

fn all_of(tokens: &mut Tokens) -> Option<bool> {
    let mut accepted = term(tokens)?;
    while tokens.next_if(|token| token == "AND").is_some() {
        accepted &= term(tokens)?;
    }
    Some(accepted)
}

fn term(tokens: &mut Tokens) -> Option<bool> {
    let mut licence = tokens.next()?;
    if licence == "(" {
        let accepted = any_of(tokens)?;
        return tokens.next_if(|token| token == ")").map(|_| accepted);
    }
    if [")", "AND", "OR", "WITH"].contains(&licence.as_str()) {
        return None;
    }
    if tokens.next_if(|token| token == "WITH").is_some() {
        licence = format!("{licence} WITH {}", tokens.next()?);
    }
    Some(ACCEPTED.contains(&licence.as_str()))
}

#[test]
fn every_dependency_has_terms_that_we_accept() {
    let packages = METADATA["packages"].as_array().unwrap();
    let refused: Vec<String> = packages
        .iter()
        .filter(|package| package["license"].as_str().map(verdict) != Some(Verdict::Accepted))
        .map(|package| format!("{} {}: {}", package["name"], package["version"], package["license"]))
        .collect();
    assert!(refused.is_empty(), "not accepted, or not stated:\n{}", refused.join("\n"));
    let foreign = packages.iter().filter(|package| !package["source"].is_null()).count();
    assert!(foreign > 100, "this test sees {foreign} dependencies only");
}

#[test]
fn our_own_terms_are_stated() {
    let packages = METADATA["packages"].as_array().unwrap();
    for package in packages.iter().filter(|package| package["source"].is_null()) {
        assert_eq!(package["license"], "MIT OR Apache-2.0", "{}", package["name"]);
    }
}

#[test]
fn expressions_are_read_as_spdx_means_them() {
    let accepted = [
        "MIT",
        "MIT OR Apache-2.0",
        "MIT/Apache-2.0",
        "GPL-3.0-only OR MIT",
        "(MIT OR GPL-3.0-only) AND Unicode-3.0",
        "Apache-2.0 WITH LLVM-exception OR GPL-2.0-only",
        "MIT AND (Apache-2.0 OR LGPL-2.1-or-later) AND (ISC)",
    ];
    for expression in accepted {
        assert_eq!(verdict(expression), Verdict::Accepted, "{expression}");
    }
    let refused = [
        "GPL-3.0-only",
        "MIT AND GPL-3.0-only",
        "MIT AND GPL-2.0-only OR LGPL-2.1-only",
        "GPL-2.0-only WITH Classpath-exception-2.0",
        "MIT WITH Commons-Clause",
        "(MIT OR ISC) AND SSPL-1.0",
    ];
    for expression in refused {
        assert_eq!(verdict(expression), Verdict::Refused, "{expression}");
    }
    for expression in ["", "MIT OR", "(MIT", "MIT)", "MIT Apache-2.0", "AND MIT", "()", "MIT WITH"] {
        assert_eq!(verdict(expression), Verdict::Unreadable, "{expression}");
    }
}
