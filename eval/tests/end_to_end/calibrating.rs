//! Probabilities, and what a model learns for them of its own training images.

use std::fs;

use crate::synthetic::{GAP, World};
use crate::tool::{frame_rows, proposal, waypost_eval};

#[test]
fn the_likelihood_alone_recognises_and_has_no_map() {
    let world = World::new();
    world.train("model");
    let report = world.run("model", "out", &["--ranking", "likelihood"]);
    assert!(report["average_precision"].as_f64().unwrap() > 0.8, "{report}");
    assert!(report["places"].is_null() && report["loop_closures"].is_null());
    assert!((0.0..=1.0).contains(&report["ece"].as_f64().unwrap()));
    for (index, row) in frame_rows(&world.path("out")).iter().enumerate() {
        assert_eq!(proposal(row).is_some(), index >= GAP);
        assert!(proposal(row).is_none_or(|earlier| earlier + GAP <= index));
    }
    let accepting = world.run("model", "out", &["--ranking", "likelihood", "--threshold", "0.5"]);
    assert!(accepting["loop_closures"].as_u64().unwrap() >= 4, "{accepting}");
}

#[test]
fn a_run_says_how_far_its_probabilities_can_be_trusted() {
    let world = World::new();
    world.train("model");
    let report = world.run("model", "out", &[]);
    assert!((0.0..=1.0).contains(&report["ece"].as_f64().unwrap()), "{report}");
    let diagram = fs::read_to_string(world.path("out/reliability.svg")).unwrap();
    assert!(diagram.contains("expected calibration error"));
    assert!(world.run("model", "baseline", &["--ranking", "tf-idf"])["ece"].is_null());
}

#[test]
fn a_model_learns_from_images_that_overlap_and_says_where_none_do() {
    let world = World::new();
    world.train("model");
    let calibrate = |model: &str, detector: &str, out: &str| {
        let (model, out) = (world.text(model), world.text(out));
        waypost_eval(&["train", "--recalibrate", &model, "--detector", detector, "--out", &out, "--json"])
    };
    let refusal = calibrate("model", "tempered", "none");
    assert!(refusal.refusal(1).contains("in order of time"), "{}", refusal.stderr);
    assert!(!world.path("none").exists());
    let typical = calibrate("model", "learned", "typical").json();
    assert!(typical["pairs"].is_null() && typical["images"].is_null(), "{typical}");
    assert!(typical["evidence_exponent"].as_f64().unwrap() < 1.0, "{typical}");

    world.train_on_walk("walked");
    let learnt = calibrate("walked", "learned", "learnt").json();
    assert!(learnt["pairs"].as_u64().unwrap() >= 50, "{learnt}");
    let exponent = learnt["evidence_exponent"].as_f64().unwrap();
    assert!(exponent > 0.0 && exponent <= 1.0);
    let tempered = calibrate("walked", "tempered", "tempered").json();
    assert!(learnt["loss_nats"].as_f64().unwrap() <= tempered["loss_nats"].as_f64().unwrap());
    let report = world.run("learnt", "out", &[]);
    assert!(report["average_precision"].as_f64().unwrap() > 0.8, "{report}");

    let fixed = calibrate("learnt", "fixed", "fixed").json();
    assert_eq!(fixed["evidence_exponent"], 1.0);
    let plain = calibrate("walked", "fixed", "plain").json();
    assert_eq!(fixed["model_hash"], plain["model_hash"]);
    let both = ["train", "--recalibrate", "model", "--images", "training", "--out", "none"];
    assert!(waypost_eval(&both).refusal(2).contains("--images"));
}
