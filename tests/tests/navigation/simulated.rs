//! `waypost simulate`: everything can be tried on one's own server before a robot is there.

use crate::harness::CommandLine;

#[test]
fn a_simulated_robot_makes_a_map_and_is_led_along_it() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let picture = tempfile::tempdir().unwrap();
    let picture = picture.path().join("drive.svg");
    let in_the_loop = ["simulate", "--map", "drive", "--world", "loop"];
    let mapping = ["--session", "first", "--picture", picture.to_str().unwrap()];
    let mapped = waypost.json(&[&in_the_loop[..], &mapping].concat());
    assert_eq!(mapped["session"], "maps/drive/sessions/first");
    let [by_wheels_m, by_map_m] =
        ["wheels_error_m", "map_error_m"].map(|error| mapped[error].as_f64().unwrap());
    assert!(by_map_m < 0.5 && by_map_m < by_wheels_m, "{mapped}");
    assert!(!mapped["closures"].as_array().unwrap().is_empty(), "{mapped}");
    assert!(std::fs::read_to_string(&picture).unwrap().contains("<svg"));

    let led = waypost.text(&[&in_the_loop[..], &["--navigate", "--to", "5"]].concat());
    assert!(led.contains("maps/drive/navigations/simulated has arrived"), "{led}");
    // Before it is told anything, it waits.
    assert!(led.lines().any(|line| line == "waiting") && !led.contains("unspecified"), "{led}");

    let nowhere = waypost.fails(&[&in_the_loop[..], &["--navigate", "--to", "9999"]].concat());
    assert!(nowhere.1.contains("9999"), "{nowhere:?}");
    let unknown = waypost.fails(&["simulate", "--map", "drive", "--world", "moon"]);
    assert!(unknown.0 == 1 && unknown.1.contains("office"), "{unknown:?}");
}
