//! A simulated robot maps a small world, and its map is held against the truth.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use serde_json::Value;

use crate::tool::{waypost_eval, waypost_eval_on_threads};

/// A ring of corridors, driven once and a little more, by wheels of 5 % and three degrees a metre.
const DRIVE: [&str; 9] = [
    "map",
    "--world",
    "loop",
    "--route",
    "once",
    "--scale-error=0.05",
    "--drift-rad-per-m=-0.0523599",
    "--trials=2",
    "--json",
];

/// The loop as the first test that asks for it maps it, with a model that is trained on it.
pub(crate) static LOOP: LazyLock<Mapped> = LazyLock::new(|| {
    let folder = concat!(env!("CARGO_TARGET_TMPDIR"), "/loop");
    // What an earlier run wrote is no picture of this one.
    if Path::new(folder).exists() {
        fs::remove_dir_all(folder).unwrap();
    }
    fs::create_dir_all(folder).unwrap();
    let model = format!("{folder}/model");
    let training = ["--words", "500", "--training-drives", "2", "--model-out", &model, "--out", folder];
    let report = waypost_eval_on_threads(3, &[&DRIVE[..], &training].concat()).json();
    Mapped { folder: folder.to_owned(), model, report }
});

pub(crate) struct Mapped {
    folder: String,
    pub(crate) model: String,
    report: Value,
}

fn number(report: &Value, figure: &str) -> f64 {
    report[figure].as_f64().unwrap_or_else(|| panic!("no {figure} in {report}"))
}

/// The report without what is another each time.
fn without_times(mut report: Value) -> Value {
    let fields = report.as_object_mut().unwrap();
    fields.retain(|name, _| !name.contains("ms_"));
    report
}

#[test]
fn a_loop_that_closes_undoes_what_wheels_have_drifted() {
    let Mapped { folder, model, report } = &*LOOP;
    assert_eq!((report["world"].as_str(), report["route"].as_str()), (Some("loop"), Some("once")));
    assert!((number(report, "length_m") - 46.0).abs() < 1.0, "{report}");
    assert!(number(report, "images") > 60.0 && number(report, "closures_true") > 3.0, "{report}");
    let (worst, wheels_m) = (&report["worst"], number(report, "odometry_rmse_m"));
    assert_eq!(number(worst, "closures_false"), 0.0, "{report}");
    assert_eq!(number(worst, "places_apart"), 0.0, "{report}");
    assert!(number(worst, "missed_fraction") < 0.5, "{report}");
    // What is left is the wheels' scale: half a metre at ten metres.
    assert!(wheels_m > 3.0 && number(worst, "map_rmse_m") < 0.8, "{report}");
    assert!(number(worst, "map_rmse_scaled_m") < 0.3, "{report}");
    for time in ["ms_per_image_p50", "ms_per_image_p95", "relax_ms_p50", "relax_ms_p95", "relax_ms_max"] {
        assert!(number(report, time) > 0.0, "{time}: {report}");
    }
    let written: Value = serde_json::from_slice(&fs::read(format!("{folder}/map.json")).unwrap()).unwrap();
    assert_eq!(&written, report);
    for seed in [1, 2] {
        let picture = fs::read_to_string(format!("{folder}/map-{seed}.svg")).unwrap();
        assert!(picture.contains("wheels alone") && picture.contains("loop closures"));
    }

    let again = waypost_eval_on_threads(1, &[&DRIVE[..], &["--model", model]].concat()).json();
    assert_eq!(without_times(again), without_times(report.clone()), "two runs of the same seeds differ");
}

#[test]
fn what_cannot_be_driven_is_refused() {
    let refused = |more: &[&str]| waypost_eval(&[&["map", "--world", "loop"], more].concat());
    let unknown = refused(&["--route", "home"]);
    assert!(unknown.refusal(2).contains("there are once, twice"), "{}", unknown.stderr);
    let training = refused(&["--route", "once", "--seed", "1000000"]);
    assert!(training.refusal(2).contains("training"), "{}", training.stderr);
    let frames = refused(&["--route", "once", "--prior-frames", "5"]);
    assert!(frames.refusal(2).contains("1..=4"), "{}", frames.stderr);
    refused(&["--route", "once", "--scale-error", "0.05"]).refusal(2);
}

#[test]
fn a_long_drive_is_put_right_by_the_loop_at_its_end() {
    let beside_the_repository = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
    let data = std::env::var("WAYPOST_DATA").unwrap_or_else(|_| beside_the_repository.to_owned());
    let folder = format!("{data}/kitti06_trajectory");
    if !Path::new(&folder).is_dir() {
        println!("skipped: no kitti06_trajectory; set WAYPOST_DATA to the folder that has it");
        return;
    }
    let wheels = ["--scale-error", "0.02", "--drift-rad-per-m", "0.005"];
    let report = waypost_eval(&[&["map", "--kitti", &folder, "--json"], &wheels[..]].concat()).json();
    assert_eq!((report["places"].as_u64(), report["map_contradicted_links"].as_u64()), (Some(1101), Some(0)));
    assert!((number(&report, "length_m") - 1233.0).abs() < 5.0, "{report}");
    assert!((number(&report, "drift_found_rad_per_m") - 0.005).abs() < 1e-3, "{report}");
    assert!(number(&report, "odometry_rmse_m") > 100.0, "{report}");
    // Half a per cent of the way, but for the wheels' scale.
    assert!(number(&report, "map_rmse_scaled_m") < 6.0, "{report}");
}
