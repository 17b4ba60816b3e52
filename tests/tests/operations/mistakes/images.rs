//! Folders and images that are none, or not those that are wanted.

use std::path::Path;

use super::Beginner;
use crate::harness::{images, path};

#[test]
fn folders_and_images_that_are_wrong() {
    let beginner = Beginner::new();
    let file = beginner.file("notes.txt", "x");
    beginner.file("empty/notes.txt", "x");
    let empty = beginner.files.path().join("empty");
    let stream = |mistake: &str, folder: &Path, code, fragment: &str| {
        let arguments = ["stream", path(folder), "--map", "hall", "--session", "new"];
        beginner.says(mistake, &arguments, code, fragment);
    };
    stream("no folder", Path::new("/nope"), 1, "there is no folder /nope");
    stream("no images", &empty, 1, "no images in");
    stream("a file", &file, 1, "give the folder");
    let folder = path(beginner.images.path());
    beginner.says("photos for panoramas", &["stream", folder, "--map", "looks"], 4, "--panorama");
    for projection in ["cylindrical", "equirectangular"] {
        let arguments = ["stream", folder, "--map", "looks", "--panorama", projection];
        beginner.says("photos called panoramas", &arguments, 1, "at least twice as wide as high");
    }
    let arguments = ["stream", folder, "--map", "hall", "--session", "new", "--camera", "500,500,320,240"];
    beginner.says("the camera of other images", &arguments, 1, "give the calibration of these images");
    let simulate = ["simulate", "--map", "looks", "--world", "office"];
    beginner.says("a camera ahead for panoramas", &simulate, 1, "name a map of metres");
    beginner.says(
        "more words than images give",
        &["model", "train", "--images", folder, "--words", "500000", "--name", "large"],
        1,
        "at most",
    );

    // Another folder into the session of this one, whatever its files are called.
    let other = beginner.files.path().join("other");
    std::fs::create_dir(&other).unwrap();
    for (index, image) in images().iter().skip(50).take(8).enumerate() {
        std::fs::write(other.join(format!("{index:06}.jpg")), image).unwrap();
    }
    let arguments = ["stream", path(&other), "--map", "hall", "--session", "monday"];
    beginner.says("another folder", &arguments, 1, "was begun with other images");
    for index in (0..8).rev() {
        std::fs::rename(other.join(format!("{index:06}.jpg")), other.join(format!("{:06}.jpg", index + 100)))
            .unwrap();
    }
    beginner.says(
        "a folder of other names",
        &arguments,
        1,
        "its frame 6 is 000005.jpg, and here it is 000105.jpg",
    );
    // The same one goes on.
    std::fs::write(beginner.images.path().join("000006.jpg"), &images()[6]).unwrap();
    let said = beginner.waypost.text(&["stream", folder, "--map", "hall", "--session", "monday"]);
    assert!(said.contains("resumed after frame 6"), "{said}");
}

#[test]
fn formats_that_are_not_read() {
    let beginner = Beginner::new();
    let bmp = bitmap();
    for (name, content, fragment) in [
        ("truncated", &images()[0][..500], "refused"),
        ("nothing", &[], "refused"),
        ("text", b"no image", "neither JPEG nor PNG but a text file; convert it"),
        ("webp", b"RIFF\x24\0\0\0WEBPVP8 ", "but WebP; convert it to JPEG or PNG"),
        ("bmp", &bmp, "but BMP; convert it to JPEG or PNG"),
        ("tiff", b"II*\0\x08\0\0\0\0\0", "but TIFF; convert it to JPEG or PNG"),
        ("gif", b"GIF89a\x01\0\x01\0\0\0\0;", "but GIF; convert it to JPEG or PNG"),
        ("heic", b"\0\0\0\x18ftypheic\0\0\0\0", "but HEIF, AVIF or video; convert it"),
    ] {
        let bad = beginner.file(&format!("{name}/1.jpg"), content);
        let arguments = ["stream", path(bad.parent().unwrap()), "--map", "hall", "--session", name];
        beginner.says(name, &arguments, 5, fragment);
    }
    // By their endings: they are told, whether there are others or not.
    let bitmaps = beginner.file("bitmaps/1.bmp", &bmp);
    let arguments = |folder: &Path, session: &str| {
        ["stream", path(folder), "--map", "hall", "--session", session].map(str::to_owned)
    };
    let says = |mistake: &str, arguments: [String; 6], code, fragment: &str| {
        beginner.says(mistake, &arguments.each_ref().map(String::as_str), code, fragment);
    };
    let bitmaps = arguments(bitmaps.parent().unwrap(), "bitmaps");
    says("bitmaps alone", bitmaps.clone(), 1, "(1 file .bmp: convert them to JPEG or PNG)");
    beginner.file("bitmaps/2.jpg", &images()[0]);
    says("a bitmap among others", bitmaps, 0, "1 file .bmp beside the images, left out");
    // A PNG that is called JPEG is what it is.
    let photo = image::load_from_memory(&images()[0]).unwrap();
    let renamed = beginner.file("renamed/1.jpg", "");
    photo.save_with_format(&renamed, image::ImageFormat::Png).unwrap();
    says("a PNG of another name", arguments(renamed.parent().unwrap(), "renamed"), 0, "");
}

/// A Windows bitmap of 64 x 64 grey pixels, as many tools save them.
fn bitmap() -> Vec<u8> {
    let mut file = b"BM".to_vec();
    let header = [54 + 3 * 64 * 64, 0, 54, 40, 64, 64, 24 << 16 | 1, 0, 3 * 64 * 64, 2835, 2835, 0, 0_u32];
    file.extend(header.into_iter().flat_map(u32::to_le_bytes));
    file.resize(54 + 3 * 64 * 64, 128);
    file
}
