//! Folders of data sets are streamed by their tables: the images that these name, with their stamps.

use std::path::Path;

use serde_json::Value;

use crate::harness::{CommandLine, images, json_object, path};

/// What came of a folder that was streamed.
struct Streamed {
    waypost: CommandLine,
    /// On stderr.
    said: String,
    /// As the server has them.
    frames: Vec<Value>,
}

impl Streamed {
    #[track_caller]
    fn of(folder: &Path, options: &[&str]) -> Self {
        let waypost = CommandLine::new();
        waypost.prepare();
        let stream = ["stream", path(folder), "--map", "drive", "--session", "robot", "--json"];
        let output = waypost.run(&[&stream[..], options].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        let summary = json_object(&String::from_utf8(output.stdout).unwrap());
        assert_eq!(summary["refused"], 0, "{summary}");
        let listed = waypost.json(&["session", "frames", "drive", "robot"]);
        let frames = listed["frames"].as_array().unwrap().clone();
        let rows = summary["frames"].as_array().unwrap();
        assert_eq!(rows.len(), frames.len(), "{summary}");
        for (row, frame) in rows.iter().zip(&frames) {
            assert_eq!((&row["image"], &row["stamp_ns"]), (&frame["note"], &frame["stamp_ns"]), "{row}");
        }
        Self { waypost, said, frames }
    }

    /// Notes and stamps of the frames.
    fn named(&self) -> Vec<(&str, i64)> {
        let frames = self.frames.iter();
        frames.map(|frame| (frame["note"].as_str().unwrap(), frame["stamp_ns"].as_i64().unwrap())).collect()
    }

    /// The camera that the session declares.
    fn camera(&self) -> Value {
        self.waypost.json(&["session", "ls", "drive"])["sessions"][0]["camera"].clone()
    }
}

fn write(file: &Path, content: impl AsRef<[u8]>) {
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    std::fs::write(file, content).unwrap();
}

/// An image of the shipped drive, as data sets have them.
fn write_png(file: &Path, index: usize) {
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    image::load_from_memory(&images()[index]).unwrap().save(file).unwrap();
}

#[test]
fn tum_rgbd_is_streamed_with_its_stamps_and_its_ground_truth() {
    let folder = tempfile::tempdir().unwrap();
    let stamps_s = ["1305031102.175304", "1305031103.211214", "1305031104.243211", "1305031105.275326"];
    let mut table = "# color images\n# file: 'walk.bag'\n# timestamp filename\n".to_owned();
    for (index, stamp_s) in stamps_s.iter().enumerate() {
        let name = format!("rgb/{stamp_s}.png");
        write_png(&folder.path().join(&name), index);
        write_png(&folder.path().join(format!("depth/{stamp_s}.png")), index);
        table += &format!("{stamp_s} {name}\n");
    }
    // That the table does not name.
    write_png(&folder.path().join("rgb/1305031102.000000.png"), 4);
    write(&folder.path().join("rgb.txt"), &table);
    write(&folder.path().join("depth.txt"), table.replace("rgb/", "depth/"));
    let truth = folder.path().join("groundtruth.txt");
    // Half a metre a second, from 1305031102.1 on.
    let poses: Vec<String> = (0..40)
        .map(|n| {
            format!("{:.4} {:.4} 0 0 0 0 0 1", 1_305_031_102.1 + 0.1 * f64::from(n), 0.05 * f64::from(n))
        })
        .collect();
    write(
        &truth,
        format!("# ground truth trajectory\n# timestamp tx ty tz qx qy qz qw\n{}\n", poses.join("\n")),
    );

    let streamed = Streamed::of(folder.path(), &["--odometry", path(&truth)]);
    assert_eq!(
        streamed.named(),
        [
            ("rgb/1305031102.175304.png", 1_305_031_102_175_304_000),
            ("rgb/1305031103.211214.png", 1_305_031_103_211_214_000),
            ("rgb/1305031104.243211.png", 1_305_031_104_243_211_000),
            ("rgb/1305031105.275326.png", 1_305_031_105_275_326_000),
        ]
    );
    let said = &streamed.said;
    assert!(said.contains("groundtruth.txt: 40 poses, joined to 4 images by time"), "{said}");
    assert!(!said.contains("without odometry"), "{said}");
    for (frame, since_s) in streamed.frames.iter().zip([0.075304, 1.111214, 2.143211, 3.175326]) {
        let x_m = frame["odometry"]["pose"]["position_m"]["x"].as_f64().unwrap();
        assert!((x_m - 0.5 * since_s).abs() < 1e-6, "{x_m} m after {since_s} s");
    }
}

#[test]
fn euroc_is_streamed_by_its_left_camera_with_its_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let mav = folder.path().join("mav0");
    let stamps_ns = [1_403_636_579_763_555_584_i64, 1_403_636_580_763_555_584, 1_403_636_581_763_555_584];
    let names = stamps_ns.map(|stamp_ns| format!("{stamp_ns}.png"));
    let rows: String =
        stamps_ns.iter().zip(&names).map(|(stamp_ns, name)| format!("{stamp_ns},{name}\r\n")).collect();
    for (camera, first) in [("cam0", 0), ("cam1", 10)] {
        write(&mav.join(camera).join("data.csv"), format!("#timestamp [ns],filename\r\n{rows}"));
        for (index, name) in names.iter().enumerate() {
            write_png(&mav.join(camera).join("data").join(name), first + index);
        }
    }
    write(&mav.join("imu0/data.csv"), "#timestamp [ns],w_RS_S_x [rad s^-1]\n1403636579758555392,-0.1\n");
    let calibration = mav.join("cam0/sensor.yaml");
    write(
        &calibration,
        "#Default\nsensor_type: camera\nresolution: [640, 360]\ncamera_model: pinhole\n\
         intrinsics: [458.654, 457.296, 320.215, 180.375] #fu, fv, cu, cv\n\
         distortion_model: radial-tangential\n\
         distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]\n",
    );

    let streamed = Streamed::of(folder.path(), &["--camera", path(&calibration)]);
    let expected: Vec<(&str, i64)> = names.iter().map(String::as_str).zip(stamps_ns).collect();
    assert_eq!(streamed.named(), expected);
    let camera = streamed.camera();
    assert_eq!(camera["pinhole"]["fx_px"], 458.654, "{camera}");
    assert_eq!(camera["pinhole"]["distortion"][0], -0.28340811, "{camera}");
    // It is the left one whose images were sent.
    let left = Streamed::of(&mav.join("cam0"), &[]);
    assert_eq!(left.named(), expected);
    let words = |of: &Streamed| {
        of.frames.iter().map(|frame| frame["answer"]["words"].as_u64().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(words(&streamed), words(&left));
}

/// A folder of KITTI odometry whose table has as many times as are given for its four images.
fn kitti(times_s: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (camera, first) in [("image_0", 0), ("image_1", 10)] {
        for index in 0..4 {
            write_png(&folder.path().join(camera).join(format!("{index:06}.png")), first + index);
        }
    }
    write(&folder.path().join("times.txt"), times_s.join("\n"));
    folder
}

#[test]
fn kitti_is_streamed_by_its_times_with_its_calibration() {
    let folder = kitti(&["0.000000e+00", "1.036224e-01", "2.073281e-01", "3.110076e-01"]);
    let calibration = folder.path().join("calib.txt");
    write(
        &calibration,
        "P0: 718.856 0 320.5 0 0 718.856 180.25 0 0 0 1 0\n\
         P1: 718.856 0 320.5 -386.1448 0 718.856 180.25 0 0 0 1 0\n\
         Tr: 0 -1 0 0.1 0 0 -1 0 1 0 0 0\n",
    );
    let streamed = Streamed::of(folder.path(), &["--camera", path(&calibration)]);
    // No stamp is 0, so that all are a nanosecond later.
    assert_eq!(
        streamed.named(),
        [
            ("000000.png", 1),
            ("000001.png", 103_622_401),
            ("000002.png", 207_328_101),
            ("000003.png", 311_007_601)
        ]
    );
    let said = &streamed.said;
    let told = "stamps begin at 0.000 s, and have to be above 0: 1 ns are added to each";
    assert!(said.contains(told), "{said}");
    let camera = streamed.camera();
    assert_eq!(camera["pinhole"]["cx_px"], 320.5, "{camera}");
}

#[test]
fn a_table_that_does_not_fit_its_images_streams_nothing() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let folder = kitti(&["0", "0.1", "0.2", "0.3", "0.4"]);
    let (code, said) = waypost.fails(&["stream", path(folder.path()), "--map", "drive"]);
    assert_eq!(code, 1, "{said}");
    assert!(said.contains("times.txt has 5 times for 4 images in "), "{said}");
    assert!(said.contains("there has to be one line for each image"), "{said}");
    let sessions = waypost.json(&["session", "ls", "drive"]);
    assert_eq!(sessions["sessions"].as_array().unwrap().len(), 0, "{sessions}");
}
