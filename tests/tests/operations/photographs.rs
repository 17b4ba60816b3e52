//! Photographs whose files lie on their side, and say so, as phones write them.

use serde_json::Value;

use crate::harness::{CommandLine, images, path};

/// A JPEG with how its camera stood: EXIF of one entry, after the two bytes that every JPEG begins with.
fn with_orientation(jpeg: &[u8], orientation: u8) -> Vec<u8> {
    let entry = [b"\x01\x12\0\x03\0\0\0\x01\0".as_slice(), &[orientation], b"\0\0"].concat();
    let exif = [b"Exif\0\0MM\0*\0\0\0\x08\0\x01".as_slice(), &entry, b"\0\0\0\0"].concat();
    let length = u16::try_from(exif.len() + 2).unwrap().to_be_bytes();
    [&jpeg[..2], b"\xff\xe1", &length, &exif, &jpeg[2..]].concat()
}

#[test]
fn turned_photographs_and_their_camera_are_taken_as_the_camera_stood() {
    let waypost = CommandLine::new();
    waypost.prepare();
    waypost.text(&["map", "create", "upright", "--model", "shipped"]);
    let (lying, upright) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    for (number, jpeg) in (1..=4).zip(images()) {
        // To be turned to the right by a quarter.
        std::fs::write(lying.path().join(format!("{number}.jpg")), with_orientation(jpeg, 6)).unwrap();
        let turned = image::load_from_memory(jpeg).unwrap().rotate90();
        turned.save(upright.path().join(format!("{number}.png"))).unwrap();
    }
    let stream = |folder: &tempfile::TempDir, map: &str| {
        let arguments = ["stream", path(folder.path()), "--map", map, "--camera", "500,500,180,320"];
        let streamed = waypost.json(&arguments);
        assert_eq!(streamed["frame_count"], 4, "{streamed}");
        assert_eq!(streamed["refused"], 0, "{streamed}");
        let decided =
            |row: &Value| ["reason", "place_number", "posterior", "words"].map(|of| row[of].clone());
        streamed["frames"].as_array().unwrap().iter().map(decided).collect::<Vec<_>>()
    };
    let seen = stream(&lying, "drive");
    assert_eq!(seen, stream(&upright, "upright"));
    assert!(seen.iter().all(|[.., words]| words.as_u64() > Some(0)), "{seen:?}");
    let sessions = waypost.json(&["session", "ls", "drive"]);
    let camera = &sessions["sessions"][0]["camera"];
    assert_eq!(camera["image_width_px"], 360, "{camera}");
    assert_eq!(camera["image_height_px"], 640, "{camera}");

    // The calibration of the file as it lies is not that of the camera.
    let arguments = ["stream", path(lying.path()), "--map", "drive", "--camera", "500,500,320,180"];
    let (code, said) = waypost.fails(&arguments);
    assert_eq!(code, 1, "{said}");
    let expected = "(320, 180) pixels, is far from that of the first image, which has 360 x 640; give the \
                    calibration of these images";
    assert!(said.contains(expected), "{said}");
    assert_eq!(waypost.json(&["session", "ls", "drive"]), sessions);
}
