//! The measurement of a growing map, on a small one.

use std::fs;

use serde_json::Value;

use crate::tool::{waypost_eval, waypost_eval_on_threads};

const SMALL: [&str; 9] =
    ["scale", "--places", "5000", "--words", "2000", "--samples", "100", "--queries", "40"];

const MEASURES: [&str; 10] = [
    "filter_update_ms_p50",
    "filter_update_ms_p95",
    "likelihood_ms_p50",
    "new_place_ms_p50",
    "add_place_us_p50",
    "add_place_us_mean",
    "update_place_us_p50",
    "bytes_per_posting",
    "checkpoint_bytes_per_posting",
    "open_ms",
];

#[test]
fn every_measure_is_there_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("results").display().to_string();
    let report = waypost_eval(&[&SMALL[..], &["--threads", "2", "--json", "--out", &out]].concat()).json();
    assert_eq!([&report["places"], &report["words"], &report["threads"]], [5000, 2000, 2]);
    for measure in MEASURES {
        assert!(report[measure].as_f64().unwrap() > 0.0, "{measure}: {report}");
    }
    assert!(report["rss_mib"].as_f64().is_none_or(|mib| mib > 1.0));
    let postings = report["postings"].as_f64().unwrap();
    assert!((postings / 5000.0 - 300.0).abs() < 10.0, "{postings}");
    assert!(report["bytes_per_posting"].as_f64().unwrap() <= 4.0, "{report}");
    let growth = report["growth"].as_array().unwrap();
    let sizes: Vec<u64> = growth.iter().map(|point| point["places"].as_u64().unwrap()).collect();
    assert_eq!(sizes, [312, 625, 1250, 2500, 5000]);
    assert!(report.get("bail_out_speedup").is_none());
    let written: Value =
        serde_json::from_slice(&fs::read(folder.path().join("results/scale.json")).unwrap()).unwrap();
    assert_eq!(written, report);
}

#[test]
fn bail_out_evaluates_few_terms_and_decides_alike() {
    let places = ["scale", "--places", "1000", "--words", "2000", "--samples", "100", "--queries", "40"];
    let report = waypost_eval(&[&places[..], &["--most-looks", "3", "--bail-out", "--json"]].concat()).json();
    let fraction = report["bail_out_terms_fraction"].as_f64().unwrap();
    assert!(fraction > 0.0 && fraction < 0.3, "{report}");
    assert!(report["bail_out_changed_fraction"].as_f64().unwrap() <= 0.05, "{report}");
    assert!(report["bail_out_speedup"].as_f64().unwrap() > 0.0, "{report}");
    assert_eq!(report["bail_out_queries"], 40);
}

/// What the whole map takes for what, by one way to stand in for new places.
fn mistakes(threads: usize, places: &str, new_place: &str, seed: &str) -> Value {
    let workload =
        ["scale", "--words", "3000", "--samples", "300", "--queries", "300", "--json", "--mistakes"];
    let chosen = ["--places", places, "--new-place", new_place, "--seed", seed];
    waypost_eval_on_threads(threads, &[&workload[..], &chosen].concat()).json()["mistakes"].clone()
}

#[test]
fn the_tail_of_the_samples_stays_right_as_the_map_grows() {
    for places in ["30", "900"] {
        let tail = mistakes(2, places, "tail", "5");
        assert_eq!((&tail["new_queries"], &tail["revisit_queries"]), (&Value::from(150), &Value::from(150)));
        assert!(tail["false_accepts"].as_u64().unwrap() <= 3, "{tail}");
        assert!(tail["revisits_accepted"].as_u64().unwrap() >= 145, "{tail}");
        assert!(tail["ece"].as_f64().unwrap() <= 0.05, "{tail}");
    }
    let mistaken = |places| mistakes(2, places, "sampled", "5")["false_accepts"].as_u64().unwrap();
    assert!(mistaken("900") > mistaken("30") + 10, "a mean was not outdone");
}

#[test]
fn the_same_seed_gives_the_same_mistakes_on_any_number_of_threads() {
    assert_eq!(mistakes(1, "60", "sampled", "5"), mistakes(4, "60", "sampled", "5"));
    assert_ne!(mistakes(2, "60", "sampled", "5"), mistakes(2, "60", "sampled", "6"));
}

#[test]
fn what_cannot_be_measured_is_refused() {
    assert!(waypost_eval(&["scale", "--words", "599"]).refusal(2).contains("at least twice"));
    assert!(waypost_eval(&["scale", "--places", "0"]).refusal(2).contains("--places"));
}
