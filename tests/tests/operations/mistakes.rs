//! What a beginner does wrong, and what is said. TLS, tokens, ports and settings of the server have tables of their own
//! (`tls.rs`, `tokens.rs`, `startup.rs`, `config.rs`), bad frames have `robots/bad_frames.rs`.

mod asking;
mod images;
mod streaming;

use std::path::PathBuf;

use crate::harness::{Built, CommandLine, folder, images, path, run_to_its_end};

/// A command line with a map `hall` of words and metres that are not known, its session `monday` of the first six images of the
/// shipped drive, and an empty map `looks` for panoramas.
struct Beginner {
    waypost: CommandLine,
    images: tempfile::TempDir,
    files: tempfile::TempDir,
}

impl Beginner {
    fn new() -> Self {
        let waypost = CommandLine::new();
        waypost.prepare();
        waypost.text(&["map", "create", "hall", "--model", "shipped"]);
        waypost.text(&[
            "map",
            "create",
            "looks",
            "--model",
            "shipped",
            "--navigation-strategy",
            "appearance",
        ]);
        let images = folder(6);
        waypost.text(&["stream", path(images.path()), "--map", "hall", "--session", "monday"]);
        Self { waypost, images, files: tempfile::tempdir().unwrap() }
    }

    /// A file with this in it.
    fn file(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let file = self.files.path().join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(&file, content).unwrap();
        file
    }

    /// The same with a map `ways` that has metres: its session `monday` drove two metres from image to image.
    fn with_metres() -> Self {
        let beginner = Self::new();
        let rows: String = (0..6).map(|n| format!("{},{},0,0\n", 1 + n * 1_000_000_000_u64, 2 * n)).collect();
        let odometry = beginner.file("ways.csv", format!("stamp_ns,x_m,y_m,yaw_rad\n{rows}"));
        beginner.waypost.text(&["map", "create", "ways", "--model", "shipped"]);
        let drive = ["stream", path(beginner.images.path()), "--map", "ways", "--session", "monday"];
        beginner.waypost.text(&[&drive[..], &["--odometry", path(&odometry)]].concat());
        beginner
    }

    fn says(&self, mistake: &str, arguments: &[&str], code: i32, fragment: &str) {
        let output = self.waypost.run(arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{mistake}: {said}");
        assert!(said.contains(fragment), "{mistake}: {said}");
    }
}

#[test]
fn names_and_verbs_that_are_wrong() {
    let beginner = Beginner::new();
    let out = beginner.files.path().join("out");
    let out = path(&out);
    for (mistake, arguments, code, fragment) in [
        ("no name", &["map", "create"][..], 2, "<NAME>"),
        ("unknown model", &["map", "create", "new", "--model", "nosuch"], 4, "there is no model"),
        ("a short hash", &["model", "show", "8f7ce"], 4, "at least 6"),
        ("unknown map", &["map", "show", "nosuch"], 4, "there is no map nosuch; list the maps"),
        ("no map name", &["map", "create", "My Map", "--model", "shipped"], 4, "1 to 63 of a-z"),
        ("a map that exists", &["map", "create", "hall", "--model", "shipped"], 4, "choose another name"),
        ("a verb with a typo", &["map", "lss"], 2, "similar subcommand"),
        ("another verb", &["map", "delete", "nosuch", "--yes"], 4, "there is no map nosuch"),
        ("a map removed by a script", &["map", "rm", "hall"], 1, "nothing was done; give --yes"),
        ("a session, too", &["session", "rm", "hall", "monday"], 1, "nothing was done; give --yes"),
        ("and a model", &["model", "rm", "shipped"], 1, "`waypost model export` keeps a copy"),
        ("and a token", &["token", "rm", "robot"], 1, "nothing was done; give --yes"),
        ("a map compacted by a script", &["map", "compact", "hall"], 1, "no merge can be undone"),
        ("places dropped by one", &["map", "trim", "hall", "--places", "2", "--apply"], 1, "give --yes"),
        ("a yes to nothing", &["map", "trim", "hall", "--places", "2", "--yes"], 2, "--apply"),
        ("an unknown robot", &["navigate", "hall", "robot", "--to", "9999"], 4, "robot"),
        ("a frame that is not there", &["explain", "hall", "monday", "99"], 4, "list its frames"),
        (
            "a frame by a wrong file name",
            &["explain", "hall", "monday", "99.jpg"],
            4,
            "waypost session frames hall monday",
        ),
        ("a job that is not there", &["job", "show", "7"], 4, "jobs/7"),
        ("a session that is not there", &["session", "show", "hall", "sunday"], 4, "sunday"),
        ("a building that is not there", &["simulate", "--map", "hall", "--world", "ofice"], 2, "office"),
        ("a map without metres", &["map", "graph", "hall", "--out", out], 4, "it takes frames with odometry"),
        (
            "a trajectory of none",
            &["map", "trajectory", "hall", "monday", "--out", out],
            4,
            "it takes frames with odometry",
        ),
        (
            "a threshold above 1",
            &["map", "create", "new", "--model", "shipped", "--closure-threshold", "99"],
            4,
            "above 0 and at most 1",
        ),
        (
            "places of no size",
            &["map", "create", "new", "--model", "shipped", "--place-spacing-m", "0"],
            4,
            "must be a number above 0",
        ),
        (
            "words that views are to verify",
            &[
                "map",
                "create",
                "new",
                "--model",
                "shipped",
                "--keep",
                "words",
                "--verification",
                "similarity",
            ],
            4,
            "or let the map keep features or images",
        ),
    ] {
        beginner.says(mistake, arguments, code, fragment);
    }
    // Usage lines are those of the help, whatever else was given.
    let said = String::from_utf8(beginner.waypost.run(&["map", "create"]).stderr).unwrap();
    assert!(said.contains("Usage: waypost map create [OPTIONS] <NAME>"), "{said}");
    // Words alone verify nothing, and nothing else is said of them.
    beginner.waypost.text(&["map", "create", "words", "--model", "shipped", "--keep", "words"]);
    let words = beginner.waypost.json(&["map", "show", "words"]);
    assert_eq!(words["settings"]["verification"], "none", "{words}");
    // By the name of its file, a frame is found; nothing was removed.
    let explained = beginner.waypost.text(&["explain", "hall", "monday", "000003.jpg"]);
    assert!(explained.starts_with("maps/hall/sessions/monday/frames/4 (000003.jpg): "), "{explained}");
}

#[test]
fn models_of_few_images_and_of_one_name_are_told() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let images = folder(4);
    let train = |name: &str| {
        ["model", "train", "--images", path(images.path()), "--words", "50", "--name", name]
            .map(str::to_owned)
    };
    let run = |arguments: &[String]| waypost.run(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    let few = run(&train("few"));
    let said = String::from_utf8(few.stdout).unwrap();
    assert!(few.status.success() && said.contains("it was trained on 4 images"), "{said}");
    let again = run(&train("fewer"));
    let said = String::from_utf8(again.stderr).unwrap();
    assert!(
        again.status.success() && said.contains("the server has this model already, as \"few\""),
        "{said}"
    );
    // A name stands for one model: one that two had would be no name in any command.
    let taken = "is called \"shipped\" already; choose another name";
    for arguments in
        [train("shipped").to_vec(), ["model", "rename", "few", "shipped"].map(str::to_owned).to_vec()]
    {
        let output = run(&arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(4) && said.contains(taken), "{arguments:?}: {said}");
    }
    waypost.text(&["model", "rename", "few", "few"]);
    waypost.text(&["map", "create", "hall", "--model", "shipped"]);
}

#[test]
fn images_of_several_sizes_are_told() {
    let beginner = Beginner::new();
    let small = image::load_from_memory(&images()[6]).unwrap().thumbnail(320, 180);
    small.save(beginner.images.path().join("000006.jpg")).unwrap();
    let output = beginner.waypost.run(&[
        "stream",
        path(beginner.images.path()),
        "--map",
        "hall",
        "--session",
        "sizes",
    ]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.success() && said.contains("the images are of 2 sizes, 320 x 180 and 640 x 360"),
        "{said}"
    );
}

/// What look-alikes show in small images is not known to a model of large ones.
#[test]
fn images_that_are_small_for_the_model_are_told() {
    let beginner = Beginner::new();
    let folder = tempfile::tempdir().unwrap();
    for width_px in [160, 320] {
        for (number, file) in (1..=3).zip(images()) {
            let small = image::load_from_memory(file).unwrap().thumbnail(width_px, width_px);
            small.save(folder.path().join(format!("{number}.png"))).unwrap();
        }
        let session = format!("of-{width_px}");
        let stream = ["stream", path(folder.path()), "--map", "hall", "--session", &session];
        let said = String::from_utf8(beginner.waypost.run(&stream).stderr).unwrap();
        let told = said.contains("the images are 160 pixels wide, and the map's model is made for 640")
            && said.contains("--extractor \"rootsift features=500 width=160\"");
        assert_eq!(told, width_px == 160, "{said}");
    }
}

#[test]
fn an_orb_model_for_panoramas_is_doubted() {
    let waypost = CommandLine::new();
    let images = folder(12);
    let train = ["model", "train", "--images", path(images.path()), "--words", "50", "--name"];
    for (name, extractor, is_doubted) in
        [("orb", "orb features=200 width=320", true), ("sift", "rootsift features=200 width=320", false)]
    {
        waypost.text(&[&train[..], &[name, "--extractor", extractor]].concat());
        let create = ["map", "create", name, "--model", name];
        let by_looks = waypost.run(&[&create[..], &["--navigation-strategy", "appearance"]].concat());
        assert!(by_looks.status.success(), "{by_looks:?}");
        let said = String::from_utf8(by_looks.stderr).unwrap();
        assert_eq!(said.contains("falls into pieces"), is_doubted, "{name}: {said}");
    }
}

#[test]
fn addresses_that_are_wrong() {
    let waypost = CommandLine::new();
    let (grpc, http) = (waypost.endpoint(), waypost.http());
    for (mistake, address, code, fragment) in [
        ("no server", "http://127.0.0.1:1", 3, "start a server with `waypost-server`"),
        ("no scheme of ours", "ftp://127.0.0.1:7600", 2, "http://"),
        ("the HTTP port", &http, 3, "HTTP port"),
        ("https against plain", &grpc.replace("http://", "https://"), 3, "speaks no TLS"),
    ] {
        let mut command = Built::command("waypost");
        command.args(["map", "ls", "--server", address]);
        let output = run_to_its_end(command);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{mistake}: {said}");
        assert!(said.contains(fragment), "{mistake}: {said}");
    }
}

#[test]
fn odometry_that_is_wrong() {
    let beginner = Beginner::new();
    let stream = |mistake: &str, odometry: &str, code, fragment: &str| {
        let file = beginner.file("odometry.csv", odometry);
        let folder = path(beginner.images.path());
        let arguments = ["stream", folder, "--map", "drive", "--session", "new", "--odometry", path(&file)];
        beginner.says(mistake, &arguments, code, fragment);
    };
    let csv = |rows: &[&str]| format!("stamp_ns,x_m,y_m,yaw_rad\n{}\n", rows.join("\n"));
    stream("another header", "t,x,y,yaw\n", 1, "the header is `t,x,y,yaw`");
    stream("semicolons", "stamp_ns;x_m;y_m;yaw_rad\n1;0;0;0\n", 1, "parted by semicolons");
    stream("too few rows", &csv(&["1,0,0,0"]), 1, "1 poses for 6 images");
    stream("stamps with a point", &csv(&["1.5,0,0,0"]), 1, "whole number of nanoseconds");
    stream("stamps that fall", &csv(&["2,0,0,0", "1,0,0,0"]), 1, "sort the rows by time");
    stream("no number", &csv(&["1,nan,0,0"]), 1, "no number for x_m");
    stream("no rotation", "1 0 0 0 0 0 0 0\n", 1, "has length 0.0000; it has to be 1");
    let rows = |row: &dyn Fn(i64) -> String| {
        csv(&(1..=6).map(row).collect::<Vec<_>>().iter().map(String::as_str).collect::<Vec<_>>())
    };
    let second = 1_000_000_000;
    stream(
        "degrees",
        &rows(&|n| format!("{},{},0,{}", n * second / 10, 0.1 * n as f64, 20 * n)),
        1,
        "is yaw_rad in degrees, and not in radians?",
    );
    stream(
        "centimetres",
        &rows(&|n| format!("{},{},0,0", n * second, 50 * n)),
        1,
        "are positions in centimetres or millimetres",
    );
    stream(
        "axes of a camera",
        &(1..=6).map(|n| format!("{n} 0 0 {} 0 0 0 1", 0.5 * f64::from(n))).collect::<Vec<_>>().join("\n"),
        1,
        "are its axes those of a camera",
    );
    stream(
        "seconds for nanoseconds",
        &rows(&|n| format!("{n},{},0,0", 0.5 * n as f64)),
        1,
        "stamps not in their unit",
    );
    // Who knows better says so.
    let file = beginner.file("odometry.csv", rows(&|n| format!("{},{},0,0", n * second, 50 * n)));
    let folder = path(beginner.images.path());
    beginner.waypost.text(&[
        "stream",
        folder,
        "--map",
        "drive",
        "--session",
        "fast",
        "--odometry",
        path(&file),
        "--yes",
    ]);
    // It goes on with it.
    std::fs::write(beginner.images.path().join("000006.jpg"), &images()[6]).unwrap();
    let without = ["stream", folder, "--map", "drive", "--session", "fast"];
    beginner.says("odometry left out", &without, 1, "was --odometry left out?");
    let said = beginner.waypost.text(&[&without[..], &["--yes"]].concat());
    assert!(said.contains("resumed after frame 6"), "{said}");
}

#[test]
fn odometry_of_another_rate_is_joined_by_time_and_cameras_are_declared() {
    let beginner = Beginner::new();
    let stamped = beginner.files.path().join("stamped");
    std::fs::create_dir(&stamped).unwrap();
    // Fractions of unequal length: 1700000000.5 is after 1700000000.25.
    for (name, image) in
        ["1700000000.0", "1700000000.25", "1700000000.5", "1700000003.75"].iter().zip(images())
    {
        std::fs::write(stamped.join(format!("{name}.jpg")), image).unwrap();
    }
    let rows: Vec<String> = (0..20)
        .map(|n| format!("{:.1} {} 0 0 0 0 0 1", 1_700_000_000.0 + 0.1 * f64::from(n), 0.05 * f64::from(n)))
        .collect();
    let odometry = beginner.file("odometry.tum", rows.join("\n"));
    let arguments =
        ["stream", path(&stamped), "--map", "drive", "--session", "timed", "--odometry", path(&odometry)];
    let camera = ["--camera", "500,500,320,180", "--json"];
    let output = beginner.waypost.run(&[&arguments[..], &camera].concat());
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("20 poses, joined to 4 images by time"), "{said}");
    assert!(said.contains("1 of 4 frames are sent without odometry"), "{said}");
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let names: Vec<&str> =
        summary["frames"].as_array().unwrap().iter().map(|row| row["image"].as_str().unwrap()).collect();
    assert_eq!(names, ["1700000000.0.jpg", "1700000000.25.jpg", "1700000000.5.jpg", "1700000003.75.jpg"]);
    assert_eq!(summary["frames"][1]["stamp_ns"], 1_700_000_000_250_000_000_i64);
    let counted: u64 =
        summary["reasons"].as_object().unwrap().values().map(|count| count.as_u64().unwrap()).sum();
    assert_eq!(counted, 4, "{summary}");
    let sessions = beginner.waypost.json(&["session", "ls", "drive"]);
    assert_eq!(sessions["sessions"][0]["camera"]["pinhole"]["fx_px"], 500.0, "{sessions}");

    let other = beginner.file("clock.tum", "5 0 0 0 0 0 0 1\n6 0 0 0 0 0 0 1\n");
    let arguments = ["stream", path(&stamped), "--map", "drive", "--odometry", path(&other)];
    beginner.says("another clock", &arguments, 1, "both have to be by one clock");
    let gap = beginner.file("gap.tum", "1699999999 0 0 0 0 0 0 1\n1700000005 1 0 0 0 0 0 1\n");
    let arguments = ["stream", path(&stamped), "--map", "drive", "--odometry", path(&gap)];
    beginner.says("a gap in odometry", &arguments, 1, "at most 1 s apart");
    let arguments = ["stream", path(&stamped), "--map", "drive", "--camera", "nowhere.yaml"];
    beginner.says("no calibration", &arguments, 1, "cannot read nowhere.yaml");
}
