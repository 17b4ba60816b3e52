//! A simulated robot is taught a way and led along it again.

use std::fs;

use serde_json::Value;

use crate::mapping::LOOP;
use crate::tool::{waypost_eval, waypost_eval_on_threads};

fn number(report: &Value, figure: &str) -> f64 {
    report[figure].as_f64().unwrap_or_else(|| panic!("no {figure} in {report}"))
}

#[test]
fn what_was_taught_is_driven_again_and_wheels_alone_fail() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (model, out) = (&LOOP.model, path("out"));
    let bad_link = ["--drop", "0.3", "--blind", "5", "--delay", "0.3", "--jitter", "0.2"];
    let drive = [&["navigate", "--model", model, "--json"][..], &bad_link].concat();
    let report = waypost_eval_on_threads(3, &[&drive[..], &["--trials", "2", "--out", &out]].concat()).json();
    assert_eq!((number(&report, "trials"), number(&report, "arrived")), (2.0, 2.0), "{report}");
    assert_eq!(number(&report, "odometry_only_arrived"), 0.0, "{report}");
    assert!(
        number(&report, "cross_track_m_mean") < 0.1 && number(&report, "cross_track_m_p95") < 0.25,
        "{report}"
    );
    assert!(number(&report, "closure_rate") >= 0.6, "{report}");
    assert_eq!(number(&report, "collisions"), 0.0, "{report}");
    let written: Value = serde_json::from_slice(&fs::read(path("out/navigate.json")).unwrap()).unwrap();
    assert_eq!(written, report);
    for seed in [0, 1] {
        let picture = fs::read_to_string(path(&format!("out/navigate-{seed}.svg"))).unwrap();
        assert!(picture.contains("driven by wheels alone") && picture.contains("places recognised"));
    }
    let again = waypost_eval_on_threads(1, &drive).json();
    assert_eq!(again["runs"][0], report["runs"][0], "two runs of the same seed differ");

    let shortcut = ["navigate", "--trial", "shortcut", "--model", model, "--json"];
    let report = waypost_eval_on_threads(3, &shortcut).json();
    assert_eq!(number(&report, "arrived"), 1.0, "{report}");
    assert!(number(&report, "driven_m_median") < 0.4 * number(&report, "taught_m_median"), "{report}");
}

#[test]
fn what_cannot_be_tried_is_refused() {
    let refused = |more: &[&str]| waypost_eval(&[&["navigate"], more].concat());
    let unknown = refused(&["--route", "home", "--model", "none"]);
    assert!(!unknown.refusal(1).is_empty(), "{}", unknown.stderr);
    refused(&["--drop", "1.5"]).refusal(2);
    refused(&["--delay", "-1"]).refusal(2);
    let training = refused(&["--seed", "1000000"]);
    assert!(training.refusal(2).contains("training"), "{}", training.stderr);
}
