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
    assert!(unknown.0 == 2 && unknown.1.contains("possible values: office"), "{unknown:?}");
}

/// The same for a robot that sees all around and has no odometry: its map has links by looks, and it is led by headings.
#[test]
fn a_simulated_robot_that_sees_all_around_makes_a_map_and_is_led_along_it() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let by_looks = ["--navigation-strategy", "appearance"];
    waypost.text(&[&["map", "create", "house", "--model", "shipped"][..], &by_looks].concat());
    let picture = tempfile::tempdir().unwrap();
    let picture = picture.path().join("drive.svg");
    let in_the_office = ["simulate", "--map", "house", "--world", "booij-office", "--route", "b-to-c"];
    let all_around = [&in_the_office[..], &["--panorama", "cylindrical"]].concat();
    let mapping = ["--session", "first", "--picture", picture.to_str().unwrap()];
    let mapped = waypost.json(&[&all_around[..], &mapping].concat());
    let number = |field: &str| mapped[field].as_f64().unwrap();
    assert_eq!(mapped["session"], "maps/house/sessions/first");
    let places = mapped["map"]["places"].as_u64().unwrap();
    assert!((20..40).contains(&places) && mapped["frames"].as_u64().unwrap() >= places, "{mapped}");
    // Each place is linked to those beside it, and to none that is elsewhere.
    assert!(number("links_by_looks") > 2.0 * places as f64, "{mapped}");
    assert!(number("links_apart_median_m") < 2.5 && number("links_apart_most_m") < 8.0, "{mapped}");
    let drawn = std::fs::read_to_string(&picture).unwrap();
    assert!(drawn.contains("<svg") && drawn.contains("links by looks"), "{drawn}");

    // Another robot, whose panoramas have other noise, starts where the route did. It drives in real time, so not far.
    let led = waypost.json(&[&all_around[..], &["--navigate", "--to", "5"]].concat());
    assert_eq!(led["navigation"], "maps/house/navigations/simulated");
    let [driven_m, x_m, y_m] = ["driven_m", "x_m", "y_m"].map(|field| led[field].as_f64().unwrap());
    assert!(driven_m > 1.2 && led["recognised"].as_u64().unwrap() > 2, "{led}");
    // Through the room, which it began at 4.5 m, to its door.
    assert!((x_m - 5.0).abs() < 0.5 && y_m < 3.0, "{led}");

    for (what, arguments, fragment) in [
        ("a camera ahead", &in_the_office[..], "--panorama cylindrical"),
        (
            "no panoramas",
            &["simulate", "--map", "drive", "--panorama", "equirectangular"],
            "created with --navigation-strategy appearance",
        ),
    ] {
        let refused = waypost.fails(arguments);
        assert!(refused.0 == 1 && refused.1.contains(fragment), "{what}: {refused:?}");
    }
}
