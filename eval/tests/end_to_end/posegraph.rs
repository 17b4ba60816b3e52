//! `waypost-eval posegraph`, on a small graph of our own and on public ones where they are at hand.

use std::fs;
use std::path::PathBuf;

use serde_json::Value;

use crate::tool::waypost_eval;

/// Set to a folder of datasets to run on it instead of the one beside the repository.
const DATA_VARIABLE: &str = "WAYPOST_DATA";

/// A square that was driven around twice, with a corner recognised each time, and its last edge too long.
const SQUARE: &str = "\
EDGE_SE2 0 1 1 0 1.5707963 100 0 0 100 0 400\n\
EDGE_SE2 1 2 1 0 1.5707963 100 0 0 100 0 400\n\
EDGE_SE2 2 3 1 0 1.5707963 100 0 0 100 0 400\n\
EDGE_SE2 3 4 1.2 0 1.5707963 100 0 0 100 0 400\n\
EDGE_SE2 4 5 1 0 1.5707963 100 0 0 100 0 400\n\
EDGE_SE2 5 6 1 0 1.5707963 100 0 0 100 0 400\n\
EDGE_SE2 6 7 1 0 1.5707963 100 0 0 100 0 400\n\
EDGE_SE2 0 4 0 0 0 100 0 0 100 0 400\n\
EDGE_SE2 1 5 0 0 0 100 0 0 100 0 400\n\
EDGE_SE2 2 6 0 0 0 100 0 0 100 0 400\n";

fn number(report: &Value, name: &str) -> f64 {
    report[name].as_f64().unwrap_or_else(|| panic!("{name} in {report}"))
}

#[test]
fn a_square_is_closed_written_and_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    fs::write(path("square.g2o"), SQUARE).unwrap();
    let report =
        waypost_eval(&["posegraph", &path("square.g2o"), "--out", &path("out.g2o"), "--json"]).json();
    let counts = ["dimensions", "poses", "edges", "closures"].map(|name| report[name].as_u64().unwrap());
    assert_eq!(counts, [2, 8, 10, 3]);
    // 0.2 m is shared by the edges of the square and those that tie the second round to the first.
    let cost = number(&report, "cost");
    assert!(cost > 0.1 && cost < 4.0 && number(&report, "cost_of_all") == cost, "{report}");
    assert!(number(&report, "ms") > 0.0 && number(&report, "iterations") >= 1.0);
    assert!(report["false_loops"].is_null());

    // From where it was written it does not go any further.
    let again = waypost_eval(&["posegraph", &path("out.g2o"), "--start", "file", "--json"]).json();
    assert!((number(&again, "start_cost") - cost).abs() < 1e-9 * cost);
    assert!(number(&again, "cost") <= number(&again, "start_cost"));
    assert!((number(&again, "cost") - cost).abs() < 1e-6 * cost);
}

#[test]
fn a_wrong_closure_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    fs::write(path("square.g2o"), format!("{SQUARE}EDGE_SE2 0 6 0 0 0 100 0 0 100 0 400\n")).unwrap();
    let plain = waypost_eval(&["posegraph", &path("square.g2o"), "--json"]).json();
    let robust = waypost_eval(&["posegraph", &path("square.g2o"), "--robust", "--json"]).json();
    assert_eq!(robust["left_out"], serde_json::json!([[0, 6]]));
    assert!(number(&robust, "cost") < 4.0 && number(&plain, "cost") > 40.0, "{robust} {plain}");
    assert!(number(&robust, "cost_of_all") > number(&plain, "cost"));
}

#[test]
fn what_cannot_be_relaxed_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let refused = |content: &str, more: &[&str], exit_code, parts: &[&str]| {
        fs::write(path("graph.g2o"), content).unwrap();
        let run = waypost_eval(&[&["posegraph", &path("graph.g2o")], more].concat());
        let message = run.refusal(exit_code);
        for part in parts {
            assert!(message.contains(part), "\"{part}\" is missing in: {message}");
        }
    };
    refused("VERTEX_XY 0 1 2\n", &[], 1, &["graph.g2o", "line 1", "VERTEX_XY", "leave out"]);
    let indefinite = "\nEDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\n";
    refused(indefinite, &[], 1, &["line 2", "0 -> 1", "positive definite", "inverse"]);
    refused("", &[], 1, &["no VERTEX or EDGE line"]);
    refused(SQUARE, &["--start", "file"], 2, &["no VERTEX lines", "--start best"]);
    let chain = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n";
    refused(chain, &["--false-loops", "0.1"], 2, &["no closures", "--false-loops"]);
    refused(SQUARE, &["--false-loops", "0"], 2, &["a share above 0"]);
    refused(SQUARE, &["--seed", "1"], 2, &["--false-loops"]);
}

/// The public graphs with their best known costs; `None`, said aloud, where they are not at hand.
fn public_graphs() -> Option<(PathBuf, Vec<(String, f64)>)> {
    let beside_the_repository = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data"));
    let folder = std::env::var_os(DATA_VARIABLE).map_or_else(beside_the_repository, PathBuf::from);
    let folder = folder.join("posegraph");
    let Ok(mut optimum) = csv::Reader::from_path(folder.join("optimum.csv")) else {
        println!("skipped: no posegraph/optimum.csv; set {DATA_VARIABLE} to the folder that has it");
        return None;
    };
    let rows = optimum.records().map(|row| row.unwrap());
    let graphs: Vec<(String, f64)> = rows.map(|row| (row[0].to_owned(), row[4].parse().unwrap())).collect();
    assert_eq!(graphs.len(), 8);
    Some((folder, graphs))
}

#[test]
fn public_graphs_reach_their_best_known_costs() {
    let Some((folder, graphs)) = public_graphs() else { return };
    for (file, best) in graphs {
        let path = folder.join(&file).display().to_string();
        let report = waypost_eval(&["posegraph", &path, "--json"]).json();
        let ratio = number(&report, "cost") / best;
        assert!((ratio - 1.0).abs() < 1e-3, "{file}: {ratio} times the best known cost");
    }
}

#[test]
fn false_loops_do_not_bend_public_graphs() {
    let Some((folder, graphs)) = public_graphs() else { return };
    for (file, best) in graphs {
        // Three closures do not outvote a fourth.
        if file == "tinyGrid3D.g2o" {
            continue;
        }
        let path = folder.join(&file).display().to_string();
        let report =
            waypost_eval(&["posegraph", &path, "--robust", "--false-loops", "0.1", "--seed", "7", "--json"])
                .json();
        let found = &report["false_loops"];
        assert!(number(found, "added") >= 2.0);
        assert!((number(found, "optimum") / best - 1.0).abs() < 1e-3, "{file}: {found}");
        let ratio = number(found, "optimum_ratio");
        assert!(ratio < 1.1, "{file}: {ratio} times the optimum");
    }
}
