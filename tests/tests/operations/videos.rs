//! Videos are streamed by the images that ffmpeg takes of them.

use std::process::Command;

use crate::harness::{Built, CommandLine, folder, path, run_to_its_end};

/// A video of the shipped drive's first images, four a second; none where there is no ffmpeg.
fn video(images: usize) -> Option<tempfile::TempDir> {
    let folder = folder(images);
    let made = Command::new("ffmpeg")
        .args(["-nostdin", "-loglevel", "error", "-framerate", "4", "-i"])
        .arg(folder.path().join("%06d.jpg"))
        .args(["-c:v", "mjpeg", "-q:v", "2"])
        .arg(folder.path().join("drive.avi"))
        .output();
    match made {
        Ok(made) => {
            assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
            Some(folder)
        }
        Err(error) => {
            eprintln!("skipped: there is no ffmpeg ({error})");
            None
        }
    }
}

#[test]
fn a_video_is_streamed_by_its_images() {
    let Some(folder) = video(12) else { return };
    let video = folder.path().join("drive.avi");
    let waypost = CommandLine::new();
    waypost.prepare();
    let stream = |rate: &[&str], session: &str| {
        let arguments = ["stream", path(&video), "--map", "drive", "--session", session];
        waypost.json(&[&arguments[..], rate].concat())
    };
    let all = stream(&["--video-rate", "4"], "all");
    let names: Vec<&str> =
        all["frames"].as_array().unwrap().iter().map(|frame| frame["image"].as_str().unwrap()).collect();
    assert_eq!((names.len(), names[0], names[11]), (12, "drive.avi 0.000 s", "drive.avi 2.750 s"));
    // Two a second, and they are what was there: each is where it was before.
    let half = stream(&[], "half");
    let frames = half["frames"].as_array().unwrap();
    assert_eq!((frames.len(), frames[5]["image"].as_str().unwrap()), (6, "drive.avi 2.500 s"));
    assert_eq!(frames[5]["stamp_ns"], 2_500_000_000_i64);
    let explained = waypost.text(&["explain", "drive", "half", "drive.avi 2.500 s"]);
    assert!(explained.starts_with("maps/drive/sessions/half/frames/6 (drive.avi 2.500 s): "), "{explained}");
    // A run that was stopped goes on.
    let again = stream(&[], "half");
    assert_eq!(again["resumed_after_sequence"], 6);
}

#[test]
fn what_is_no_video_is_said() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let images = folder(1);
    let (code, said) = waypost.fails(&["stream", path(images.path()), "--map", "drive", "--video-rate", "4"]);
    assert!(code == 1 && said.contains("--video-rate is for videos"), "{code}: {said}");
    let file = images.path().join("drive.mp4");
    std::fs::write(&file, "no video").unwrap();
    let arguments = ["stream", path(&file), "--map", "drive"];
    if Command::new("ffmpeg").arg("-version").output().is_ok() {
        let (code, said) = waypost.fails(&arguments);
        assert!(code == 1 && said.contains("ffmpeg cannot read it"), "{code}: {said}");
    }
    // Where there is no ffmpeg, what to install.
    let mut command = Built::command("waypost");
    command.args(arguments).args(["--server", &waypost.endpoint()]).env("PATH", images.path());
    let output = run_to_its_end(command);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(1) && said.contains("there is no ffmpeg"), "{said}");
}
