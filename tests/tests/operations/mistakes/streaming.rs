//! What is streamed in another order, unit or projection than it should be, and what rows say of it.

use waypost_client::FrameContent;
use waypost_sim::robot::WheelErrors;
use waypost_sim::worlds::NamedWorld;

use super::Beginner;
use crate::harness::{CommandLine, Drive, folder, images, json_object, path};

/// Frames that came into the map.
fn frames(beginner: &Beginner, map: &str) -> Option<u64> {
    beginner.waypost.json(&["map", "show", map])["frames"].as_u64()
}

#[test]
fn odometry_of_more_rows_than_images_streams_nothing() {
    let beginner = Beginner::new();
    let rows: Vec<String> =
        (1..=8).map(|second| format!("{second}000000000,{},0,0", 0.5 * f64::from(second))).collect();
    let rows = format!("stamp_ns,x_m,y_m,yaw_rad\n{}\n", rows.join("\n"));
    let odometry = beginner.file("odometry.csv", rows);
    let arguments = ["stream", path(beginner.images.path()), "--map", "drive", "--odometry", path(&odometry)];
    // It is no matter of opinion: a yes makes no poses fit.
    for yes in [&[][..], &["--yes"]] {
        let (code, said) = beginner.waypost.fails(&[&arguments[..], yes].concat());
        assert_eq!(code, 1, "{said}");
        let expected = "odometry.csv has 8 poses for 6 images that have no stamps to join them by";
        assert!(said.contains(expected), "{said}");
        assert!(said.contains("write one row per image, in the order of the images"), "{said}");
    }
    let sessions = beginner.waypost.json(&["session", "ls", "drive"]);
    assert_eq!(sessions["sessions"].as_array().unwrap().len(), 0, "{sessions}");
    assert_eq!(frames(&beginner, "drive"), Some(0));
}

#[test]
fn millimetres_are_noticed_before_anything_is_streamed() {
    let beginner = Beginner::new();
    let images = path(beginner.images.path());
    // Half a metre a second.
    let csv = |per_metre: f64| {
        let rows: Vec<String> =
            (1..=6).map(|n| format!("{n}000000000,{},0,0", per_metre * 0.5 * f64::from(n))).collect();
        format!("stamp_ns,x_m,y_m,yaw_rad\n{}\n", rows.join("\n"))
    };
    let tum: Vec<String> = (1..=6).map(|n| format!("{n} {} 0 0 0 0 0 1", 500 * n)).collect();
    for (name, rows) in [("odometry.csv", csv(1000.0)), ("odometry.tum", tum.join("\n"))] {
        let odometry = beginner.file(name, rows);
        let stream = ["stream", images, "--map", "drive", "--odometry", path(&odometry)];
        let (code, said) = beginner.waypost.fails(&stream);
        assert_eq!(code, 1, "{name}: {said}");
        for expected in [
            "by its odometry the robot drives 500 m/s, 1800 km/h: are positions in centimetres or millimetres",
            "and not in metres",
            "nothing was sent; mend that, or give --yes if it is right",
        ] {
            assert!(said.contains(expected), "{name}: {said}");
        }
    }
    assert_eq!(frames(&beginner, "drive"), Some(0));
    // The same in metres.
    let odometry = beginner.file("metres.csv", csv(1.0));
    beginner.waypost.text(&["stream", images, "--map", "drive", "--odometry", path(&odometry)]);
    assert_eq!(frames(&beginner, "drive"), Some(6));
}

/// A session keeps the camera and the odometry that it was begun with: to give others later changes nothing, and is refused.
#[test]
fn a_session_that_goes_on_keeps_its_camera_and_odometry() {
    let beginner = Beginner::new();
    let images = path(beginner.images.path());
    let csv = |step_m: f64| {
        let rows: Vec<String> =
            (1..=6).map(|n| format!("{n}000000000,{},0,0", step_m * f64::from(n))).collect();
        format!("stamp_ns,x_m,y_m,yaw_rad\n{}\n", rows.join("\n"))
    };
    let (odometry, other) = (beginner.file("odometry.csv", csv(0.5)), beginner.file("other.csv", csv(0.4)));
    let with = |session: &'static str, more: &[&str]| {
        let arguments = ["stream", images, "--map", "drive", "--yes", "--session", session];
        [&arguments[..], more].concat().into_iter().map(str::to_owned).collect::<Vec<String>>()
    };
    let stream = |arguments: Vec<String>| {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let output = beginner.waypost.run(&arguments);
        let said = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
        (output.status.success(), said)
    };
    let measured = ["--odometry", path(&odometry)];
    let (done, said) = stream(with("bare", &[]));
    assert!(done, "{said}");
    let (done, said) = stream(with("wheels", &measured));
    assert!(done && said.contains("no --camera: closures say which place it is"), "{said}");
    let (done, said) = stream(with("seeing", &[&measured[..], &["--camera", "fov:65"]].concat()));
    assert!(done && !said.contains("no --camera"), "{said}");
    assert!(said.contains("the camera's field of view was not checked"), "{said}");
    for (session, more, says) in [
        ("bare", &measured[..], "was begun without odometry, and stays so"),
        ("bare", &["--camera", "fov:65"], "was begun without a camera, and stays so"),
        ("wheels", &["--odometry", path(&other)], "was begun with other odometry, and stays so"),
        ("seeing", &[&measured[..], &["--camera", "fov:80"]].concat(), "was begun with another camera"),
    ] {
        let (done, said) = stream(with(session, more));
        assert!(!done && said.contains(says) && said.contains("waypost session rm"), "{session}: {said}");
    }
    for (session, more) in [("bare", &[][..]), ("seeing", &[&measured[..], &["--camera", "fov:65"]].concat())]
    {
        let (done, said) = stream(with(session, more));
        assert!(done && said.contains("all 6 frames were sent before"), "{session}: {said}");
    }
    assert_eq!(frames(&beginner, "drive"), Some(18));
}

#[test]
fn images_are_streamed_by_the_numbers_in_their_names() {
    let beginner = Beginner::new();
    let folder = tempfile::tempdir().unwrap();
    for (number, image) in (1..=12).zip(images()) {
        std::fs::write(folder.path().join(format!("frame{number}.jpg")), image).unwrap();
    }
    let arguments = ["stream", path(folder.path()), "--map", "hall", "--session", "new"];
    let streamed = beginner.waypost.json(&arguments);
    let rows = streamed["frames"].as_array().unwrap();
    let names: Vec<&str> = rows.iter().map(|row| row["image"].as_str().unwrap()).collect();
    let expected: Vec<String> = (1..=12).map(|number| format!("frame{number}.jpg")).collect();
    assert_eq!(names, expected);
}

/// A row that matched a place is no closure unless its reason is one: counting the columns of the match gives more.
#[test]
fn rows_of_a_stream_tell_closures_from_what_merely_matched() {
    let waypost = CommandLine::new();
    waypost.prepare_by_words();
    let images = folder(images().len());
    let csv = images.path().join("rows.csv");
    let arguments = ["stream", path(images.path()), "--map", "drive", "--csv", path(&csv)];
    let streamed = waypost.json(&arguments);
    let mut rows = csv::Reader::from_path(&csv).unwrap();
    let header = rows.headers().unwrap().clone();
    let column = |name: &str| header.iter().position(|column| column == name).unwrap();
    assert!(!header.iter().any(|column| column.starts_with("closure_")), "{header:?}");
    let (reason, matched) = (column("reason"), column("match_place_number"));
    let rows: Vec<csv::StringRecord> = rows.records().map(Result::unwrap).collect();
    let closures = rows.iter().filter(|row| &row[reason] == "loop_closure").count();
    assert_eq!(Some(closures as u64), streamed["loop_closures"].as_u64());
    assert!(closures > 0);
    for row in &rows {
        let may_match = matches!(&row[reason], "loop_closure" | "below_threshold" | "geometry_refused");
        assert_eq!(!row[matched].is_empty(), may_match, "{row:?}");
    }
}

#[test]
fn panoramas_for_a_map_of_metres_are_told() {
    let beginner = Beginner::new();
    let folder = tempfile::tempdir().unwrap();
    let photo = image::load_from_memory(&images()[0]).unwrap();
    let wide = photo.resize_exact(640, 160, image::imageops::FilterType::Triangle);
    wide.save(folder.path().join("1.png")).unwrap();
    let arguments = ["stream", path(folder.path()), "--map", "hall", "--panorama", "cylindrical"];
    let output = beginner.waypost.run(&arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && said.contains("--navigation-strategy appearance"), "{said}");
}

/// A robot so slow that its centimetres are no doubtful speed: images say so, while it streams and in the end.
#[test]
fn centimetres_of_a_slow_robot_are_told_while_it_streams() {
    let wheels = WheelErrors { scale: 0.01, ..WheelErrors::NONE };
    let drive = Drive::new(NamedWorld::Gallery, 12, "rooms", wheels);
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("images");
    std::fs::create_dir(&images).unwrap();
    let mut rows = [String::new(), String::new()];
    for (input, frame) in drive.inputs().zip(&drive.frames).take(70) {
        let FrameContent::Image(image) = input.content else { panic!("no image") };
        std::fs::write(images.join(format!("{:03}.png", input.sequence)), image).unwrap();
        let pose = frame.odometry.pose;
        for (rows, scale) in rows.iter_mut().zip([1.0, 100.0]) {
            // Four times as slow as it was: 0.1 m/s, and 10 "m/s" by its centimetres.
            let stamp_ns = 4 * frame.stamp_ns + 1;
            let [x_m, y_m] = [scale * pose.x_m, scale * pose.y_m];
            rows.push_str(&format!("{stamp_ns},{x_m},{y_m},{}\n", pose.heading_rad));
        }
    }
    let waypost = CommandLine::new();
    waypost.prepare();
    for (session, rows) in ["metres", "centimetres"].into_iter().zip(rows) {
        let odometry = folder.path().join(format!("{session}.csv"));
        std::fs::write(&odometry, format!("stamp_ns,x_m,y_m,yaw_rad\n{rows}")).unwrap();
        waypost.text(&["map", "create", session, "--model", "shipped"]);
        let arguments = ["stream", path(&images), "--map", session, "--odometry", path(&odometry)];
        // Slowly enough for an answer while it streams.
        let camera = ["--camera", "174.6,174.6,159.5,119.5", "--rate", "6", "--json"];
        let output = waypost.run(&[&arguments[..], &camera].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{session}: {said}");
        let summary = json_object(&String::from_utf8(output.stdout).unwrap());
        let finding = summary["odometry_finding"].as_str();
        if session == "metres" {
            assert_eq!((finding, said.contains("centimetres")), (None, false), "{said}");
        } else {
            assert!(finding.unwrap().contains("in centimetres or millimetres"), "{summary}");
            assert!(said.contains("after 40 frames: ") && said.contains("do not go together"), "{said}");
        }
    }
}

/// Somebody who is there is asked; a script goes on.
#[test]
fn images_without_odometry_are_asked_about_where_a_map_has_metres() {
    let beginner = Beginner::with_metres();
    let folder = path(beginner.images.path());
    let into = |map, session| ["stream", folder, "--map", map, "--session", session];
    let doubt = "the map ways has metres, and these images bring no odometry: was --odometry left out?";
    let (code, screen) = beginner.waypost.on_a_terminal(&into("ways", "tuesday"), "n\n");
    assert!(code == 1 && screen.contains(doubt) && screen.contains("go on? [y/N]"), "{screen}");
    let sessions = beginner.waypost.json(&["session", "ls", "ways"]);
    assert_eq!(sessions["sessions"].as_array().unwrap().len(), 1, "{sessions}");
    beginner.says("without odometry", &into("ways", "tuesday"), 0, doubt);
    for arguments in
        [into("hall", "tuesday").to_vec(), [&into("ways", "localized")[..], &["--localize"]].concat()]
    {
        let said = String::from_utf8(beginner.waypost.run(&arguments).stderr).unwrap();
        assert!(!said.contains("bring no odometry"), "{said}");
    }
}
