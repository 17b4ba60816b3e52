//! Input that is wrong is refused with a message that says how to mend it.

use std::fs;

use fabmap::model::Model;

use crate::synthetic::World;
use crate::tool::{Run, waypost_eval};

fn sequence(world: &World, model: &str, more: &[&str]) -> Run {
    let (sequence, model, out) = (world.text("sequence"), world.text(model), world.text("out"));
    let mut arguments =
        vec!["sequence", "--sequence", &sequence, "--gap", "4", "--model", &model, "--out", &out];
    arguments.extend(more);
    waypost_eval(&arguments)
}

fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "\"{part}\" is missing in: {message}");
    }
}

#[test]
fn wrong_arguments_exit_with_2() {
    let world = World::new();
    world.train("model");
    assert_says(waypost_eval(&["sequence"]).refusal(2), &["--sequence", "--gap", "--model", "--out"]);
    assert_says(
        sequence(&world, "model", &["--threshold", "1.5"]).refusal(2),
        &["1.5", "leave it out for the default"],
    );
    assert_says(
        sequence(&world, "model", &["--ranking", "tf-idf", "--dependence", "chow_liu"]).refusal(2),
        &["tf-idf", "leave out"],
    );
    let images = world.text("training");
    let train = |more: &[&str]| {
        let out = world.text("other");
        waypost_eval(&[&["train", "--images", &images, "--out", &out], more].concat())
    };
    assert_says(train(&["--feature", "surf"]).refusal(2), &["surf", "rootsift", "akaze"]);
    assert_says(train(&["--image-width", "10"]).refusal(2), &["10", "out of range"]);
    assert_says(train(&["--words", "1000000"]).refusal(1), &["give more images or ask for at most"]);
    assert!(!world.path("other").exists());
}

#[test]
fn folders_and_images_that_are_not_there_are_named() {
    let world = World::new();
    let (nowhere, out) = (world.text("nowhere"), world.text("model"));
    let train = |images: &str| waypost_eval(&["train", "--images", images, "--out", &out]);
    assert_says(train(&nowhere).refusal(1), &["no folder", &nowhere]);
    fs::create_dir(world.path("nowhere")).unwrap();
    assert_says(train(&nowhere).refusal(1), &["has no image", ".jpg, .jpeg or .png"]);
    fs::write(world.path("nowhere/000.jpg"), b"\xff\xd8\xff\xe0 cut short").unwrap();
    assert_says(train(&nowhere).refusal(1), &["000.jpg"]);
    assert!(!world.path("model").exists());
}

#[test]
fn a_truth_that_cannot_be_true_is_refused_by_line() {
    let world = World::new();
    world.train("model");
    let loops = world.sequence().join("loops.csv");
    let refusal = |text: &str| {
        fs::write(&loops, text).unwrap();
        sequence(&world, "model", &[]).refusal(1).to_owned()
    };
    assert_says(&refusal("query_index,match_index\n9,1\nx,1\n"), &["loops.csv line 3", "\"x\""]);
    assert_says(&refusal("query_index,match_index\n16,1\n"), &["line 2", "frame 16", "16 frames"]);
    assert_says(&refusal("query_index,match_index\n3,7\n"), &["line 2", "not earlier", "later frame first"]);
    fs::remove_file(&loops).unwrap();
    assert_says(sequence(&world, "model", &[]).refusal(1), &["there is no", "loops.csv", "header"]);
}

#[test]
fn a_file_that_is_no_model_of_ours_is_refused() {
    let world = World::new();
    world.train("model");
    assert_says(sequence(&world, "nowhere", &[]).refusal(1), &["nowhere", "cannot be read"]);
    assert_says(sequence(&world, "sequence/loops.csv", &[]).refusal(1), &["not a Waypost model"]);

    let bytes = fs::read(world.path("model")).unwrap();
    fs::write(world.path("cut"), &bytes[..bytes.len() / 2]).unwrap();
    assert_says(sequence(&world, "cut", &[]).refusal(1), &["cut"]);

    let model = Model::from_bytes(&bytes).unwrap();
    let foreign = Model::new(
        "surf features=500 width=640".to_owned(),
        model.vocabulary().clone(),
        model.tree().clone(),
        *model.detector(),
        model.sampling_set().to_vec(),
    );
    fs::write(world.path("foreign"), foreign.unwrap().to_bytes()).unwrap();
    assert_says(
        sequence(&world, "foreign", &[]).refusal(1),
        &["extractor", "surf", "use sift, rootsift, upright-rootsift, orb or akaze", "train it anew"],
    );
    let other_width = Model::new(
        "rootsift features=500 width=640".to_owned(),
        model.vocabulary().clone(),
        model.tree().clone(),
        *model.detector(),
        model.sampling_set().to_vec(),
    );
    fs::write(world.path("mixed"), other_width.unwrap().to_bytes()).unwrap();
    assert_says(sequence(&world, "mixed", &[]).refusal(1), &["does not fit its own extractor", "train"]);
}

#[test]
fn a_damaged_frame_is_named() {
    let world = World::new();
    world.train("model");
    fs::write(world.sequence().join("images/000005.png"), b"").unwrap();
    assert_says(sequence(&world, "model", &[]).refusal(1), &["000005.png", "empty"]);
}
