//! The walls of the house: who imports whom inside each crate. Each check is shown to fail on a wall that is broken.

mod circles;
mod imports;
mod sources;
mod walls;

use circles::circles;
use sources::Sources;
use walls::{Door, Wall, doors_passed, long_files, sql_outside, walls_broken};

/// What a folder never names.
const WALLS: &[Wall] = &[
    // Pure crates: the same input gives the same output, wherever and whenever.
    Wall { folder: "fabmap/src", never: IO },
    Wall { folder: "posegraph/src", never: IO },
    Wall { folder: "topomap/src", never: IO },
    Wall { folder: "navigation/src", never: IO },
    // Adapters decode, call the service, encode.
    Wall { folder: "server/src/grpc", never: &["crate::storage", "crate::http", "waypost_vision"] },
    Wall { folder: "server/src/http", never: &["crate::storage", "crate::grpc", "waypost_vision"] },
    // The service knows no transport.
    Wall {
        folder: "server/src/service",
        never: &["crate::grpc", "crate::http", "waypost_proto", "tonic", "axum"],
    },
    Wall {
        folder: "server/src/storage",
        never: &["crate::service", "crate::grpc", "crate::http", "waypost_proto", "waypost_vision"],
    },
];

const IO: &[&str] = &["std::fs", "std::net", "std::time", "std::thread", "std::process", "std::env"];

/// Crates that only some folders of the server name.
const DOORS: &[Door] = &[
    Door { crate_folder: "server/src", named: "sqlx", only_in: &["server/src/storage"] },
    Door { crate_folder: "server/src", named: "waypost_vision", only_in: &["server/src/ingest"] },
];

/// Where SQL may stand: of our own database, and of those that robots recorded.
const SQL: &[&str] = &[
    "server/src/storage",
    "bags/src/source/sqlite",
    "bags/src/rtabmap/database",
    "tests/fuzz/src/targets/rtabmap",
];

/// Lines of a file that need no reason.
const MOST_LINES: usize = 400;

/// Files that may be longer and say why.
const MOST_REASONS: usize = 5;

fn assert_none(found: &[String]) {
    assert!(found.is_empty(), "\n{}", found.join("\n"));
}

#[test]
fn no_files_beside_each_other_import_in_a_circle() {
    assert_none(&circles(&sources::all()));
}

#[test]
fn no_folder_names_what_it_must_not() {
    assert_none(&walls_broken(&sources::all(), WALLS));
    assert_none(&doors_passed(&sources::all(), DOORS));
}

#[test]
fn sql_stands_where_databases_are_read_alone() {
    assert_none(&sql_outside(&sources::all(), SQL));
}

#[test]
fn files_are_short_or_say_why_not() {
    assert_none(&long_files(&sources::all(), MOST_LINES, MOST_REASONS));
}

/// A small crate, file by file.
fn house(files: &[(&str, &str)]) -> Sources {
    files.iter().map(|&(path, text)| (path.to_owned(), text.to_owned())).collect()
}

#[test]
fn a_circle_is_seen_through_folders_code_and_macros() {
    let straight = [
        ("a/src/lib.rs", "mod x; mod y;"),
        ("a/src/x.rs", "use crate::y::Y; mod inner;"),
        ("a/src/x/inner.rs", "use super::super::y::Y; use super::X;"),
        ("a/src/y.rs", "#[cfg(test)] mod tests { use crate::x::X; }"),
    ];
    assert_none(&circles(&house(&straight)));
    let ways_back = [
        "use crate::x::inner::Z;",
        "use super::{other::O, x::X};",
        "fn f() -> crate::x::X { loop {} }",
        "fn f() { println!(\"{}\", crate::x::inner::z()); }",
        "mod inside { use super::super::x::X; }",
    ];
    for back in ways_back {
        let mut files = straight;
        files[3].1 = back;
        assert_eq!(circles(&house(&files)), ["a: crate imports in a circle: x ↔ y"], "{back}");
    }
}

#[test]
fn a_wall_that_is_broken_is_seen() {
    let walls = [
        ("server/src/grpc/maps.rs", "use crate::storage::MapRow;"),
        ("server/src/http.rs", "use crate::{error::E, storage::MapRow};"),
        ("server/src/service/maps.rs", "fn f(map: waypost_proto::v1::Map) {}"),
        ("server/src/storage/log.rs", "use super::super::service::maps::View;"),
        ("topomap/src/map.rs", "fn f() { let now = std::time::Instant::now(); }"),
        ("fabmap/src/model.rs", "use std::{collections::BTreeMap, fs};"),
    ];
    for wall in walls {
        let broken = walls_broken(&house(&[wall]), WALLS);
        assert!(broken.len() == 1 && broken[0].starts_with(wall.0), "{wall:?}: {broken:?}");
    }
    for (path, named) in [("server/src/service/maps.rs", "sqlx"), ("server/src/net/tls.rs", "waypost_vision")]
    {
        let text = format!("use {named}::Thing;");
        assert_eq!(doors_passed(&house(&[(path, &text)]), DOORS).len(), 1, "{path}");
    }
    assert_none(&doors_passed(&house(&[("server/src/storage/log.rs", "use sqlx::Row;")]), DOORS));
}

#[test]
fn sql_outside_storage_is_seen() {
    let text = "fn f() { query(\"SELECT name FROM maps\") }";
    let in_the_service = house(&[("server/src/service/maps.rs", text)]);
    assert_eq!(sql_outside(&in_the_service, SQL).len(), 1);
    let in_storage = house(&[("server/src/storage/maps.rs", text)]);
    assert_none(&sql_outside(&in_storage, SQL));
    let prose = house(&[("cli/src/main.rs", "const HELP: &str = \"Select a map from the list\";")]);
    assert_none(&sql_outside(&prose, SQL));
}

#[test]
fn a_long_file_without_a_reason_is_seen() {
    let lines = "\n".repeat(MOST_LINES + 1);
    let reasoned = format!("// long: one table\n{lines}");
    assert_eq!(long_files(&house(&[("a/src/b.rs", &lines)]), MOST_LINES, MOST_REASONS).len(), 1);
    assert_none(&long_files(&house(&[("a/src/b.rs", &reasoned)]), MOST_LINES, MOST_REASONS));
    assert_eq!(long_files(&house(&[("a/src/b.rs", &reasoned)]), MOST_LINES, 0).len(), 1);
}
