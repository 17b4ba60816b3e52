//! A simulated robot goes where it was never shown, by looks alone.

use std::fs;

use serde_json::Value;

use crate::tool::{waypost_eval, waypost_eval_on_threads};

#[test]
fn the_robot_comes_to_both_goals_and_the_graph_is_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let arguments = ["appearance", "--json", "--parts", "drives", "--trials", "1", "--seed", "7", "--out"];
    let report = waypost_eval(&[&arguments[..], &[out.to_str().unwrap()]].concat()).json();
    assert_eq!((&report["trials"], &report["arrived"]), (&Value::from(2), &Value::from(2)), "{report}");
    let ratio = report["path_ratio_mean"].as_f64().unwrap();
    assert!((0.9..1.2).contains(&ratio), "{report}");
    assert_eq!(report["headings"], Value::Null, "not asked for");
    for figure in ["heading_error_std_rad", "links_lost_fraction", "pair_check_ratio"] {
        assert_eq!(report.get(figure), Some(&Value::Null), "{figure} is named, and was not asked for");
    }
    assert_eq!(report["collisions"], 0, "{report}");
    assert_eq!(report["path_ratio_by_people"][0], report["path_ratio_mean"], "{report}");
    let picture = fs::read_to_string(out.join("appearance-7.svg")).unwrap();
    assert!(picture.contains("a-to-c") && picture.contains("b-to-c") && picture.contains("stroke-opacity"));
}

#[test]
fn the_index_leads_to_nearly_all_links_whatever_the_threads() {
    let arguments =
        ["appearance", "--json", "--parts", "index", "--panoramas", "80", "--words", "400", "--seed", "7"];
    let report = waypost_eval_on_threads(3, &arguments).json();
    let index = &report["index"];
    assert_eq!((&index["panoramas"], &index["reference"]), (&Value::from(80), &Value::from(80)));
    assert!(index["links"].as_u64().unwrap() > 80, "{index}");
    assert_eq!(index["links_far_apart"], 0, "{index}");
    let (lost, ratio) = (&report["links_lost_fraction"], &report["pair_check_ratio"]);
    assert!(lost.as_f64().unwrap() < 0.03 && ratio.as_f64().unwrap() > 15.0, "{index}");
    // Some of the images are enough to look for lost links: each pair of theirs counts once.
    let sample = waypost_eval_on_threads(1, &[&arguments[..], &["--reference", "12"]].concat()).json();
    let links = |report: &Value| report["index"]["links"].as_u64().unwrap();
    assert!((1..links(&report)).contains(&links(&sample)), "{sample}");
    assert_eq!(sample["index"]["pair_checks"], index["pair_checks"]);
}

#[test]
fn the_index_does_with_words_that_were_learnt_elsewhere() {
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/../demo/model.waypost");
    let arguments = ["appearance", "--json", "--parts", "index", "--panoramas", "120", "--seed", "7"];
    let foreign = ["--acuity", "fine", "--reference", "40", "--model"];
    let report = waypost_eval(&[&arguments[..], &foreign, &[model]].concat()).json();
    let (lost, ratio) = (&report["links_lost_fraction"], &report["pair_check_ratio"]);
    assert!(lost.as_f64().unwrap() < 0.03 && ratio.as_f64().unwrap() > 10.0, "{report}");
    let missing = [&arguments[..], &["--model", "nowhere.waypost"]].concat();
    assert!(waypost_eval(&missing).refusal(1).contains("nowhere.waypost cannot be read"));
}

#[test]
fn what_cannot_be_measured_is_refused() {
    let numbers =
        [["--trials", "0"], ["--people", "9"], ["--panoramas", "1"], ["--reference", "0"], ["--words", "1"]];
    for arguments in numbers.iter().chain(&[["--parts", "everything"]]) {
        waypost_eval(&[&["appearance"], &arguments[..]].concat()).refusal(2);
    }
}
