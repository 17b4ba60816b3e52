//! Calibrating a model, comparing configurations, learning from visits.

use std::fs;

use crate::synthetic::{GAP, PLACES, World};
use crate::tool::{frame_rows, proposal, waypost_eval};

#[test]
fn the_likelihood_alone_recognises_and_has_no_map() {
    let world = World::new();
    world.train("model");
    let report = world.run("model", "out", &["--ranking", "likelihood"]);
    assert!(report["average_precision"].as_f64().unwrap() > 0.8, "{report}");
    assert!(report["places"].is_null() && report["accepted"].is_null());
    assert!((0.0..=1.0).contains(&report["ece"].as_f64().unwrap()));
    for (index, row) in frame_rows(&world.path("out")).iter().enumerate() {
        assert_eq!(proposal(row).is_some(), index >= GAP);
        assert!(proposal(row).is_none_or(|earlier| earlier + GAP <= index));
    }
    let accepting = world.run("model", "out", &["--ranking", "likelihood", "--threshold", "0.5"]);
    assert!(accepting["accepted"].as_u64().unwrap() >= 4, "{accepting}");
}

#[test]
fn a_run_says_how_far_its_probabilities_can_be_trusted() {
    let world = World::new();
    world.train("model");
    let report = world.run("model", "out", &[]);
    assert!((0.0..=1.0).contains(&report["ece"].as_f64().unwrap()), "{report}");
    assert_eq!(report["accepted"], report["loop_closures"]);
    assert_eq!(report["accepted_false"], report["loop_closures_false"]);
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
        waypost_eval(&["calibrate", "--model", &model, "--detector", detector, "--out", &out, "--json"])
    };
    let refusal = calibrate("model", "tempered", "none");
    assert!(refusal.refusal(1).contains("in order of time"), "{}", refusal.stderr);
    assert!(!world.path("none").exists());
    let typical = calibrate("model", "learned", "typical").json();
    assert!(typical["pairs"].is_null(), "{typical}");
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
}

#[test]
fn configurations_are_compared_in_one_table_and_one_plot() {
    let world = World::new();
    world.train("model");
    let text = format!(
        "[[sequence]]\npath = \"sequence\"\nname = \"two passes\"\ngap = {GAP}\nmodel = \"model\"\n\
         [[configuration]]\nname = \"as it is\"\n\
         [[configuration]]\nname = \"words alone\"\nflags = \"--ranking tf-idf\"\n"
    );
    fs::write(world.path("compare.toml"), &text).unwrap();
    let (file, out) = (world.text("compare.toml"), world.text("out"));
    let report = waypost_eval(&["compare", &file, "--out", &out, "--json"]).json();
    let single = world.run("model", "single", &[]);
    let runs = report["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 2);
    assert_eq!(runs[0]["configuration"], "as it is");
    assert_eq!(runs[0]["average_precision"], single["average_precision"]);
    assert!(runs[1]["ece"].is_null());

    let read = |name: &str| fs::read_to_string(world.path("out").join(name)).unwrap();
    assert_eq!(read("compare.csv").lines().count(), 3);
    assert_eq!(read("compare.md").lines().filter(|line| line.contains("| two passes |")).count(), 2);
    let plot = read("compare.svg");
    assert!(["two passes", "as it is", "words alone"].iter().all(|name| plot.contains(name)));
    assert_eq!(frame_rows(&world.path("out/0-two passes")).len(), 2 * PLACES);

    let refused = |from: &str, to: &str| {
        fs::write(world.path("wrong.toml"), text.replace(from, to)).unwrap();
        let file = world.text("wrong.toml");
        waypost_eval(&["compare", &file, "--out", &out]).refusal(2).to_owned()
    };
    let message = refused("tf-idf", "tfidf");
    assert!(message.contains("words alone") && message.contains("tf-idf"), "{message}");
    assert!(refused("gap = 4", "gap = 0").contains("at least 1"));
    assert!(refused("flags", "flag").contains("unknown field"));
    let message = refused("--ranking tf-idf", "--ranking tf-idf --smoothing 0.9");
    assert!(message.contains("leave out"), "{message}");
}

#[test]
fn more_visits_are_learnt_from() {
    let world = World::new();
    world.train("model");
    world.visits(4);
    let (visits, model) = (world.text("visits"), world.text("model"));
    let run = |places: &str| {
        waypost_eval(&["visits", "--sequence", &visits, "--places", places, "--model", &model, "--json"])
    };
    let report = run(&PLACES.to_string()).json();
    assert_eq!(report["visits"], 4);
    // Visits 2 and 3 after each of 2 + 3 single visits, and after each of 1 + 3 pairs.
    assert_eq!(report["after"][0]["queries"], 5 * PLACES);
    assert_eq!(report["after"][1]["queries"], 4 * PLACES);
    for after in report["after"].as_array().unwrap() {
        assert!(after["nearest"].as_f64().unwrap() > 0.8, "{report}");
        assert!(after["recognised"].as_f64().unwrap() <= after["nearest"].as_f64().unwrap());
    }
    assert!(run("5").refusal(2).contains("not three or more visits of 5 places"));
    assert!(run("4").refusal(2).contains("is no loop"));
}
