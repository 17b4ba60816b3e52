//! The new-place measurement on small maps.

use std::fs;

use serde_json::Value;

use crate::tool::{waypost_eval, waypost_eval_on_threads};

const SMALL: [&str; 9] =
    ["new-place", "--words", "3000", "--samples", "300", "--queries", "150", "--json", "--places"];

fn method<'a>(map: &'a Value, name: &str) -> &'a Value {
    let methods = map["methods"].as_array().unwrap();
    methods.iter().find(|method| method["method"] == name).unwrap()
}

#[test]
fn the_tail_of_the_samples_stays_right_as_the_map_grows() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("results").display().to_string();
    let report = waypost_eval(&[&SMALL[..], &["30,900", "--out", &out]].concat()).json();
    let maps = report["maps"].as_array().unwrap();
    assert_eq!(maps.iter().map(|map| map["places"].as_u64().unwrap()).collect::<Vec<_>>(), [30, 900]);
    for map in maps {
        assert_eq!((map["new_queries"].as_u64(), map["revisit_queries"].as_u64()), (Some(150), Some(150)));
        let tail = method(map, "tail");
        assert!(tail["false_accepts"].as_u64().unwrap() <= 3, "{tail}");
        assert!(tail["revisits_accepted"].as_u64().unwrap() >= 145, "{tail}");
        assert!(tail["ece"].as_f64().unwrap() <= 0.05, "{tail}");
        assert!(tail["new_place_ms_p50"].as_f64().unwrap() > 0.0, "{tail}");
    }
    let mistaken = |map: &Value| method(map, "sampled")["false_accepts"].as_u64().unwrap();
    assert!(mistaken(&maps[1]) > mistaken(&maps[0]) + 10, "a mean was not outdone: {report}");
    let written: Value =
        serde_json::from_slice(&fs::read(folder.path().join("results/new_place.json")).unwrap()).unwrap();
    assert_eq!(written, report);
    let svg = fs::read_to_string(folder.path().join("results/new_place.svg")).unwrap();
    assert!(svg.contains("tail") && svg.contains("mean-field"));
}

/// Times differ from run to run; what is counted does not.
#[test]
fn the_same_seed_gives_the_same_counts_on_any_number_of_threads() {
    let counts = |threads, seed: &str| {
        let report = waypost_eval_on_threads(threads, &[&SMALL[..], &["60", "--seed", seed]].concat()).json();
        let methods = report["maps"][0]["methods"].as_array().unwrap().clone();
        let of = |method: &Value| {
            ["method", "false_accepts", "revisits_accepted", "revisits_misplaced", "ece"]
                .map(|key| method[key].clone())
        };
        methods.iter().map(of).collect::<Vec<_>>()
    };
    assert_eq!(counts(1, "5"), counts(4, "5"));
    assert_ne!(counts(2, "5"), counts(2, "6"));
}

#[test]
fn the_generators_files_can_be_measured() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/workload");
    let report = waypost_eval(&["new-place", "--workload", folder, "--json"]).json();
    let map = &report["maps"][0];
    assert_eq!((map["places"].as_u64(), map["revisit_queries"].as_u64()), (Some(25), Some(5)));
    assert_eq!(report["seed"], Value::Null);
}

#[test]
fn what_cannot_be_measured_is_refused() {
    assert!(waypost_eval(&["new-place", "--words", "599"]).refusal(2).contains("at least twice"));
    assert!(waypost_eval(&["new-place", "--places", "0"]).refusal(2).contains("--places"));
    assert!(waypost_eval(&["new-place", "--workload", "nowhere"]).refusal(1).contains("nowhere/tree.txt"));
    assert!(waypost_eval(&["new-place", "--workload", "x", "--seed", "3"]).refusal(2).contains("--seed"));
}
