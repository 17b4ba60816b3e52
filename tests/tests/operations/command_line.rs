//! The real command line against a real server.

use std::path::Path;

use prost_reflect::{DescriptorPool, FieldDescriptor, Kind};
use serde_json::Value;

use crate::harness::{Built, CommandLine, folder, json_object, model_file, path, reference, run_to_its_end};

#[test]
fn models_are_imported_listed_shown_exported_and_removed() {
    let waypost = CommandLine::new();
    let imported = waypost.json(&["model", "import", path(&model_file()), "--name", "shipped"]);
    let name = imported["name"].as_str().unwrap();
    assert!(name.starts_with("models/") && name.len() == "models/".len() + 64, "{name}");
    assert_eq!(waypost.json(&["model", "show", "shipped"]), imported);
    assert_eq!(waypost.json(&["model", "show", &name["models/".len()..][..8]]), imported);
    assert_eq!(waypost.json(&["model", "ls"])["models"], Value::from(vec![imported.clone()]));
    for command in [&["model", "ls"][..], &["model", "show", "shipped"]] {
        let text = waypost.text(command);
        assert!(text.contains("shipped") && text.contains(&name["models/".len()..][..12]), "{text}");
    }

    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("copy.waypost");
    waypost.json(&["model", "export", "shipped", path(&file)]);
    assert!(std::fs::read(&file).unwrap() == std::fs::read(model_file()).unwrap(), "the copy differs");
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1, "something was left beside the copy");

    waypost.text(&["map", "create", "drive", "--model", "shipped"]);
    let (code, stderr) = waypost.fails(&["model", "rm", "shipped", "--yes"]);
    assert_eq!(code, 4, "{stderr}");
    assert!(stderr.contains("delete the map first"), "{stderr}");
    waypost.text(&["map", "rm", "drive", "--yes"]);
    waypost.text(&["model", "rm", "shipped", "--yes"]);
    assert_eq!(waypost.json(&["model", "ls"])["models"].as_array().unwrap().len(), 0);
}

/// Flags are made from the contract, so that a setting that is added there is tried here.
#[test]
fn every_setting_given_arrives_at_the_map() {
    let waypost = CommandLine::new();
    waypost.text(&["model", "import", path(&model_file()), "--name", "shipped"]);
    let contract = DescriptorPool::decode(waypost_proto::FILE_DESCRIPTOR_SET).unwrap();
    let settings = contract.get_message_by_name("waypost.v1.MapSettings").unwrap();
    let mut made = 0;
    for field in settings.fields() {
        for value in values_of(&field) {
            made += 1;
            let map = format!("map-{made}");
            let flag = format!("--{}", field.name().replace('_', "-"));
            let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            let mut line = vec!["map", "create", map.as_str(), "--model", "shipped", &flag, &text];
            // The detector's rates go together.
            match field.name() {
                "true_positive_rate" => line.extend(["--false-positive-rate", "0.01"]),
                "false_positive_rate" => line.extend(["--true-positive-rate", "0.4"]),
                _ => {}
            }
            assert_eq!(waypost.json(&line)["settings"][field.name()], value, "{line:?}");
            assert_eq!(waypost.json(&["map", "show", &map])["settings"][field.name()], value, "{line:?}");
        }
    }
    assert!(made >= 21, "this test sees no settings");
}

/// What a setting can be: every choice, or a number that is nobody's default.
fn values_of(field: &FieldDescriptor) -> Vec<Value> {
    match field.kind() {
        Kind::Enum(choices) => {
            let prefix = format!("{}_", field.name().to_uppercase());
            let names = choices.values().filter(|value| value.number() != 0);
            names.map(|value| value.name().strip_prefix(&prefix).unwrap().to_lowercase().into()).collect()
        }
        Kind::Double => vec![Value::from(0.25)],
        Kind::Uint32 => vec![Value::from(7)],
        other => panic!("{}: {other:?} has no flag", field.name()),
    }
}

#[test]
fn maps_are_made_listed_shown_and_removed() {
    let waypost = CommandLine::new();
    waypost.text(&["model", "import", path(&model_file()), "--name", "shipped"]);
    let made = waypost.json(&["map", "create", "drive", "--model", "shipped", "--closure-threshold", "0.8"]);
    assert_eq!((made["name"].as_str(), made["frames"].as_u64()), (Some("maps/drive"), Some(0)));
    assert_eq!(made["settings"]["closure_threshold"], 0.8);
    // What is shown has also the hash and the weight, which take time.
    let shown = waypost.json(&["map", "show", "drive"]);
    let mut basic = shown.clone();
    for part in ["state_hash", "storage"] {
        assert!(!basic[part].is_null(), "{part} is not shown");
        basic[part] = Value::Null;
    }
    assert_eq!(basic, made);
    assert_eq!(waypost.json(&["map", "show", "maps/drive"]), shown);
    assert_eq!(waypost.json(&["map", "ls"])["maps"], Value::from(vec![made]));
    assert!(waypost.text(&["map", "ls"]).contains("drive"));
    assert_eq!(shown["state_hash"].as_str().unwrap().len(), 64);
    assert!(waypost.text(&["map", "show", "drive"]).contains("maps/drive"));
    let by_words = waypost.text(&["map", "create", "words", "--model", "shipped", "--keep", "words"]);
    assert!(by_words.contains("nothing is verified: words decide"), "{by_words}");
    waypost.text(&["map", "delete", "words", "--yes"]);
    waypost.text(&["map", "rm", "drive", "--yes"]);
    assert_eq!(waypost.json(&["map", "ls"])["maps"].as_array().unwrap().len(), 0);
}

#[test]
fn a_folder_is_streamed_and_told_frame_by_frame() {
    const FRAMES: usize = 12;
    let waypost = CommandLine::new();
    waypost.prepare();
    let (folder, out) = (folder(FRAMES), tempfile::tempdir().unwrap());
    let csv = out.path().join("frames.csv");
    let stream = ["stream", path(folder.path()), "--map", "drive", "--session", "robot", "--csv", path(&csv)];
    let summary = waypost.json(&stream);
    assert_eq!(summary["session"], "maps/drive/sessions/robot");
    assert_eq!(
        (summary["frame_count"].as_u64(), summary["refused"].as_u64()),
        (Some(FRAMES as u64), Some(0))
    );
    let rows = summary["frames"].as_array().unwrap();
    assert_eq!(rows.len(), FRAMES);
    for (index, (row, event)) in rows.iter().zip(&reference().events).enumerate() {
        assert_eq!(row["sequence"].as_u64(), Some(event.sequence));
        assert_eq!(row["image"], format!("{index:06}.jpg"));
        assert_eq!(row["place_number"].as_u64(), event.decision.place.map(u64::from));
        let posterior = event.decision.posterior;
        let written = row["posterior"].as_f64().unwrap();
        assert!((written - posterior).abs() <= 4.0 * f64::EPSILON, "{written} is not {posterior}");
    }
    let first = check_csv(&csv, FRAMES);

    let session = waypost.json(&["session", "show", "drive", "robot"]);
    assert_eq!(
        (session["name"].as_str(), session["frames"].as_u64()),
        (summary["session"].as_str(), Some(FRAMES as u64))
    );
    let shown = waypost.text(&["session", "get", "drive", "robot"]);
    for line in ["maps/drive/sessions/robot", "frames          12", "numbers         1 to 12", "not declared"]
    {
        assert!(shown.contains(line), "no {line:?} in {shown}");
    }
    // Where nothing is added, nothing is closed.
    assert!(summary["recognised"].is_null() && summary["loop_closures"].is_u64(), "{summary}");
    let localized =
        waypost.json(&["stream", path(folder.path()), "--map", "drive", "--session", "seen", "--localize"]);
    assert!(localized["loop_closures"].is_null() && localized["recognised"].is_u64(), "{localized}");

    // Again: the session is complete, and its rows come from the store.
    let (code, refused) = waypost.fails(&stream);
    assert!(code == 1 && refused.contains("--force"), "{refused}");
    let again = waypost.json(&[&stream[..], &["--force"]].concat());
    assert_eq!(again["resumed_after_sequence"].as_u64(), Some(FRAMES as u64));
    assert!(again["frames"].as_array().unwrap().iter().all(|row| row["resent"] == true));
    assert_eq!(check_csv(&csv, FRAMES), first);
    let map = waypost.json(&["map", "show", "drive"]);
    assert_eq!(map["frames"].as_u64(), Some(FRAMES as u64));
    assert_eq!(map["state_hash"], reference().maps[FRAMES].state_hash);
    assert_eq!(
        waypost.json(&["map", "places", "drive"])["places"].as_array().unwrap().len() as u64,
        map["places"]
    );
    assert_eq!(
        waypost.json(&["map", "loop-closures", "drive"])["loop_closures"].as_array().unwrap().len() as u64,
        map["loop_closures"]
    );
    let text = waypost.text(&["stream", path(folder.path()), "--map", "drive", "--session", "text"]);
    let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        text.contains("maps/drive/sessions/text begun") && words.contains("agree frames 12 somewhere new"),
        "{text}"
    );
}

/// Header and a row per frame; gives sequence and place of each.
fn check_csv(file: &Path, frames: usize) -> Vec<(String, String)> {
    let text = std::fs::read_to_string(file).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = lines.next().unwrap();
    let column =
        |name: &str| header.iter().position(|column| *column == name).unwrap_or_else(|| panic!("no {name}"));
    let (sequence, place) = (column("sequence"), column("place_number"));
    let rows: Vec<_> = lines.map(|row| (row[sequence].to_owned(), row[place].to_owned())).collect();
    assert_eq!(rows.len(), frames, "{text}");
    rows
}

#[test]
fn list_is_another_name_for_ls() {
    let waypost = CommandLine::new();
    waypost.prepare();
    for (ls, list) in [
        (&["model", "ls"][..], &["model", "list"][..]),
        (&["map", "ls"], &["map", "list"]),
        (&["token", "ls"], &["token", "list"]),
        (&["job", "ls"], &["job", "list"]),
        (&["session", "ls", "drive"], &["session", "list", "drive"]),
    ] {
        assert_eq!(waypost.json(list), waypost.json(ls), "{list:?}");
        let help = waypost.text(&[ls[0], "--help"]);
        assert!(help.contains("[aliases: list]") || help.contains("[alias: list]"), "{help}");
    }
}

#[test]
fn the_port_for_people_is_told_from_the_one_for_robots() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let folder = folder(1);
    for arguments in [&["map", "ls"][..], &["stream", path(folder.path()), "--map", "drive"]] {
        let mut command = Built::command("waypost");
        command.args(arguments).args(["--server", &waypost.http()]);
        let output = run_to_its_end(command);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(3), "{stderr}");
        assert!(stderr.contains("may be the server's HTTP port") && !stderr.contains("flag"), "{stderr}");
    }
}

#[test]
fn exit_codes_tell_what_went_wrong() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let folder = folder(3);
    let missing = folder.path().join("missing.waypost");
    let image = folder.path().join("000000.jpg");
    let cases: [(&[&str], i32, &str); 8] = [
        (&["map", "show", "nowhere"], 4, "there is no map nowhere"),
        (&["map", "create", "drive", "--model", "shipped"], 4, "there is a map drive already"),
        (&["map", "create", "new", "--model", "nowhere"], 4, "there is no model"),
        (&["map", "create", "new", "--model", "shipped", "--closure-threshold", "2"], 4, "at most 1, not 2"),
        (&["model", "import", path(&image)], 4, "not a Waypost model file"),
        (&["model", "import", path(&missing)], 1, "missing.waypost"),
        (&["stream", path(folder.path()), "--map", "nowhere"], 4, "there is no map nowhere"),
        (&["map", "frobnicate"], 2, "frobnicate"),
    ];
    for (arguments, expected, fragment) in cases {
        for json in [&[][..], &["--json"]] {
            let (code, stderr) = waypost.fails(&[arguments, json].concat());
            assert_eq!(code, expected, "{arguments:?}: {stderr}");
            assert!(stderr.contains(fragment), "{arguments:?}: {stderr}");
        }
    }

    std::fs::write(folder.path().join("000001.jpg"), b"no picture").unwrap();
    let output = waypost.run(&["stream", path(folder.path()), "--map", "drive", "--json"]);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(5), "{stderr}");
    assert!(stderr.contains("000001.jpg") && stderr.contains("neither JPEG nor PNG"), "{stderr}");
    let summary = json_object(&String::from_utf8(output.stdout).unwrap());
    assert_eq!((summary["frame_count"].as_u64(), summary["refused"].as_u64()), (Some(3), Some(1)));

    let endpoint = waypost.endpoint();
    waypost.kill_server();
    let mut command = Built::command("waypost");
    command.args(["map", "ls", "--server", &endpoint]);
    let output = run_to_its_end(command);
    assert_eq!(output.status.code(), Some(3));
    assert!(String::from_utf8(output.stderr).unwrap().contains(&endpoint));
}

#[test]
fn a_model_is_trained_from_the_command_line() {
    let waypost = CommandLine::new();
    let folder = folder(12);
    let train = ["model", "train", "--images", path(folder.path()), "--words", "60", "--name", "small"];
    let model = waypost.json(&[&train[..], &["--extractor", "orb features=200 width=320"]].concat());
    assert_eq!((model["display_name"].as_str(), model["words"].as_u64()), (Some("small"), Some(60)));
    assert_eq!(waypost.json(&["model", "show", "small"]), model);
    // The same images make the same model, which keeps its name.
    let again =
        [&train[..train.len() - 1], &["again", "--extractor", "orb features=200 width=320", "--detach"]]
            .concat();
    let job = waypost.json(&again)["name"].as_str().unwrap().to_owned();
    assert_eq!(waypost.json(&["job", "watch", &job])["state"], "succeeded");
    assert_eq!(waypost.json(&["job", "show", &job])["state"], "succeeded");
    assert_eq!(waypost.json(&["job", "get", job.trim_start_matches("jobs/")])["state"], "succeeded");
    let (code, stderr) = waypost.fails(&["job", "show", "jobs/9"]);
    assert_eq!(code, 4, "{stderr}");
}

/// A map that is made without settings has the defaults that the help tells of.
#[test]
fn the_help_has_the_numbers_of_the_defaults() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let settings = waypost.json(&["map", "show", "drive"])["settings"].clone();
    let help = waypost.text(&["map", "create", "--help"]);
    let help = help.split_whitespace().collect::<Vec<_>>().join(" ");
    for (setting, unit) in [
        ("closure_threshold", ""),
        ("guard_frames", " frames"),
        ("new_place_prior", ""),
        ("place_spacing_m", " m"),
    ] {
        let default = format!("{}{unit} by default", settings[setting]);
        assert!(help.contains(&default), "{setting}: no {default:?} in {help}");
    }
    let merge = waypost.text(&["map", "merge", "--help"]);
    let least = topomap::merging::MergeSettings::default().min_support;
    assert!(merge.contains(&format!("at least 3; {least} by default")), "{merge}");
    let train = waypost.text(&["model", "train", "--help"]);
    let extractor = waypost_vision::features::FeatureSettings::default();
    let train = train.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(train.contains(&format!("\"{extractor}\" by default")), "{train}");
    let degrees = settings["place_spacing_rad"].as_f64().unwrap().to_degrees().round();
    assert!(help.contains(&format!("{degrees} degrees by default")), "{degrees}");
}

#[test]
fn models_are_renamed_and_maps_are_watched() {
    let waypost = CommandLine::new();
    waypost.prepare();
    assert_eq!(waypost.json(&["model", "rename", "shipped", "site"])["display_name"], "site");
    assert_eq!(waypost.json(&["model", "show", "site"])["display_name"], "site");
    let (code, said) = waypost.fails(&["model", "rename", "site", "a/b"]);
    assert!(code == 4 && said.contains("no slash"), "{said}");
    let again = waypost.run(&["model", "import", path(&model_file()), "--name", "other"]);
    let said = String::from_utf8(again.stderr).unwrap();
    assert!(
        said.contains("has this model already, as \"site\"") && said.contains("waypost model rename"),
        "{said}"
    );
    let (code, said) = waypost.fails(&["map", "watch", "drive", "--from", "5"]);
    assert!(code == 4 && said.contains("no position 5"), "{said}");
}
