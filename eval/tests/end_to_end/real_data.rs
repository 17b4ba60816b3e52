//! The program on a real sequence, where its images are at hand.

use std::fs;
use std::path::PathBuf;

use crate::tool::{frame_rows, proposal, waypost_eval, waypost_eval_on_threads};

/// Set to a folder of datasets to run on it instead of the one beside the repository.
const DATA_VARIABLE: &str = "WAYPOST_DATA";

/// The folder that has these datasets; `None`, said aloud, where it does not.
fn data_folder(names: &[&str]) -> Option<PathBuf> {
    let beside_the_repository = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data"));
    let folder = std::env::var_os(DATA_VARIABLE).map_or_else(beside_the_repository, PathBuf::from);
    let is_there = names.iter().all(|name| folder.join(name).is_dir());
    if !is_there {
        println!("skipped: no {}; set {DATA_VARIABLE} to the folder that has them", names.join(" and "));
    }
    is_there.then_some(folder)
}

#[test]
fn twelve_months_of_five_places() {
    let Some(data) = data_folder(&["michigan_12months", "train_outdoor"]) else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (training, sequence) = (data.join("train_outdoor"), data.join("michigan_12months"));
    let (training, sequence) = (training.display().to_string(), sequence.display().to_string());
    let trained = waypost_eval(&[
        "train",
        "--images",
        &training,
        "--feature",
        "rootsift",
        "--words",
        "1000",
        "--seed",
        "1",
        "--max-features",
        "300",
        "--image-width",
        "480",
        "--out",
        &path("model"),
        "--json",
    ]);
    assert_eq!(trained.json()["images"], 90);

    let run = |threads: usize, out: &str, more: &[&str]| {
        let (model, out) = (path("model"), path(out));
        let arguments =
            ["sequence", "--sequence", &sequence, "--gap", "5", "--model", &model, "--out", &out, "--json"];
        waypost_eval_on_threads(threads, &[&arguments[..], more].concat()).json()
    };
    let report = run(2, "first", &[]);
    assert_eq!((report["frames"].as_u64(), report["queries_with_loop"].as_u64()), (Some(60), Some(55)));
    let recall = report["recall_at_100_precision"].as_f64().unwrap();
    let average_precision = report["average_precision"].as_f64().unwrap();
    assert!(
        (0.0..=1.0).contains(&recall) && recall <= average_precision && average_precision <= 1.0,
        "{report}"
    );
    let rows = frame_rows(&folder.path().join("first"));
    assert_eq!(rows.len(), 60);
    assert!(
        rows.iter().enumerate().all(|(index, row)| proposal(row).is_none_or(|earlier| earlier + 5 <= index))
    );

    run(5, "again", &[]);
    let frames = |out: &str| fs::read(folder.path().join(out).join("frames.csv")).unwrap();
    assert_eq!(frames("first"), frames("again"), "two runs of the same input differ");

    let baseline = run(2, "baseline", &["--ranking", "tf-idf"]);
    assert!(baseline["average_precision"].as_f64().unwrap() > 0.5, "{baseline}");
}
