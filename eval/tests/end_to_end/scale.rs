//! The measurement of a growing map, on a small one.

use std::fs;

use serde_json::Value;

use crate::tool::waypost_eval;

const SMALL: [&str; 9] =
    ["scale", "--places", "5000", "--words", "2000", "--samples", "100", "--queries", "40"];

const MEASURES: [&str; 9] = [
    "filter_update_ms_p50",
    "filter_update_ms_p95",
    "likelihood_ms_p50",
    "new_place_ms_p50",
    "add_place_us_p50",
    "update_place_us_p50",
    "bytes_per_posting",
    "checkpoint_bytes_per_posting",
    "open_ms",
];

#[test]
fn every_measure_is_there_and_the_curve_is_drawn() {
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
    assert!(fs::read_to_string(folder.path().join("results/scale.svg")).unwrap().contains("measured"));
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

#[test]
fn the_generators_files_can_be_measured() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/workload");
    let report = waypost_eval(&["scale", "--workload", folder, "--json"]).json();
    assert_eq!([&report["places"], &report["words"], &report["postings"]], [25, 60, 278]);
}
