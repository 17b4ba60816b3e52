//! Images of a folder, in the order of their names: frame2 before frame10.

mod dataset;
mod video;

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub(crate) use self::dataset::LAYOUTS;
use self::dataset::{DatasetError, images_of_dataset};
pub(crate) use self::video::{DEFAULT_RATE_HZ, Video, VideoError, images_of_video, is_video};
use crate::file_stamps::stamps_of;

/// One image file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ImageFile {
    /// File name, as shown to people.
    pub(crate) name: String,
    pub(crate) path: PathBuf,
    /// When it was taken, if that is told beside it or by its name.
    pub(crate) stamp_ns: Option<i64>,
}

/// Why a folder has no usable images.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ListingError {
    #[error("there is no folder {}; check the path", .0.display())]
    Missing(PathBuf),
    #[error("{} is a file; give the folder that the images are in", .0.display())]
    NotAFolder(PathBuf),
    #[error(
        "no images in {}; they have to end in .jpg, .jpeg or .png{}{}", folder.display(), converting(others), deeper(inner)
    )]
    NoImages {
        folder: PathBuf,
        /// A folder in it that has images.
        inner: Option<PathBuf>,
        /// How many images of other formats there are, in words.
        others: Option<String>,
    },
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    #[error("cannot list {}: {source}", path.display())]
    Unreadable { path: PathBuf, source: std::io::Error },
}

/// The images of a data set by its table, or else those in `folder/images`, or in `folder`: by the stamps that all their
/// names end with, or else by name, with numbers in it as numbers.
pub(crate) fn images_of(folder: &Path) -> Result<Vec<ImageFile>, ListingError> {
    if !folder.exists() {
        return Err(ListingError::Missing(folder.to_owned()));
    }
    if !folder.is_dir() {
        return Err(ListingError::NotAFolder(folder.to_owned()));
    }
    let unreadable = |source| ListingError::Unreadable { path: folder.to_owned(), source };
    if let Some(images) = images_of_dataset(folder, |inner| listed(inner).map_err(unreadable))? {
        return Ok(images);
    }
    let inner = folder.join("images");
    let folder = if inner.is_dir() { inner } else { folder.to_owned() };
    let unreadable = |source| ListingError::Unreadable { path: folder.clone(), source };
    let mut images = listed(&folder).map_err(unreadable)?;
    if images.is_empty() {
        let others = of_other_formats(&folder).map_err(unreadable)?;
        let inner = folder_of_images(&folder).map_err(unreadable)?;
        return Err(ListingError::NoImages { folder, inner, others });
    }
    let names: Vec<&str> = images.iter().map(|image| image.name.as_str()).collect();
    if let Some(stamps) = stamps_of(&names) {
        images.iter_mut().zip(stamps).for_each(|(image, stamp_ns)| image.stamp_ns = Some(stamp_ns));
        images.sort_by_key(|image| image.stamp_ns);
    }
    Ok(images)
}

/// The images in a folder, in the order of their names.
fn listed(folder: &Path) -> std::io::Result<Vec<ImageFile>> {
    let mut images = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if is_image(&path) && path.is_file() {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            images.push(ImageFile { name, path, stamp_ns: None });
        }
    }
    images.sort_by(|one, other| natural_order(&one.name, &other.name).then(one.path.cmp(&other.path)));
    Ok(images)
}

/// Endings of images that are not read.
const OTHER_FORMATS: [&str; 12] =
    ["avif", "bmp", "gif", "heic", "heif", "jp2", "pgm", "ppm", "raw", "tif", "tiff", "webp"];

/// That beside the images lie others that are not read, if there are any.
pub(crate) fn told_of_others(images: &[ImageFile]) -> Option<String> {
    let folder = images.first()?.path.parent()?;
    // The images themselves were listed.
    let others = of_other_formats(folder).ok()??;
    Some(format!("{others} beside the images, left out: convert them to JPEG or PNG to have them, too"))
}

/// How many images of formats that are not read there are in a folder, as in `2 files .bmp`.
fn of_other_formats(folder: &Path) -> std::io::Result<Option<String>> {
    let mut counts = BTreeMap::<String, usize>::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        let ending = ending_of(&path);
        if OTHER_FORMATS.contains(&ending.as_str()) && path.is_file() {
            *counts.entry(ending).or_default() += 1;
        }
    }
    let counted = counts.iter().map(|(ending, count)| {
        let files = if *count == 1 { "file" } else { "files" };
        format!("{count} {files} .{ending}")
    });
    Ok((!counts.is_empty()).then(|| counted.collect::<Vec<_>>().join(", ")))
}

/// The first folder in this one that has images, by name.
fn folder_of_images(folder: &Path) -> std::io::Result<Option<PathBuf>> {
    let entries: Vec<_> = std::fs::read_dir(folder)?.collect::<Result<_, _>>()?;
    let mut folders: Vec<PathBuf> =
        entries.into_iter().map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
    folders.sort();
    // One that may not be read is passed over.
    let has_images = |folder: &PathBuf| listed(folder).is_ok_and(|images| !images.is_empty());
    Ok(folders.into_iter().find(has_images))
}

fn deeper(inner: &Option<PathBuf>) -> String {
    inner.as_ref().map(|inner| format!("; {} has some", inner.display())).unwrap_or_default()
}

fn converting(others: &Option<String>) -> String {
    let convert = |others: &String| format!(" ({others}: convert them to JPEG or PNG)");
    others.as_ref().map(convert).unwrap_or_default()
}

/// As people count: numbers by their value, all else byte by byte.
fn natural_order(one: &str, other: &str) -> Ordering {
    let (mut one, mut other) = (one.as_bytes(), other.as_bytes());
    loop {
        let [digits, other_digits] =
            [one, other].map(|text| text.iter().take_while(|byte| byte.is_ascii_digit()).count());
        if digits > 0 && other_digits > 0 {
            let (number, rest) = one.split_at(digits);
            let (other_number, other_rest) = other.split_at(other_digits);
            let [number, other_number] = [number, other_number].map(without_zeros);
            let order = number.len().cmp(&other_number.len()).then(number.cmp(other_number));
            if order != Ordering::Equal {
                return order;
            }
            (one, other) = (rest, other_rest);
            continue;
        }
        let (Some((first, rest)), Some((other_first, other_rest))) = (one.split_first(), other.split_first())
        else {
            return one.len().cmp(&other.len());
        };
        if first != other_first {
            return first.cmp(other_first);
        }
        (one, other) = (rest, other_rest);
    }
}

fn without_zeros(digits: &[u8]) -> &[u8] {
    let zeros = digits.iter().take_while(|digit| **digit == b'0').count();
    &digits[zeros..]
}

fn is_image(path: &Path) -> bool {
    matches!(ending_of(path).as_str(), "jpg" | "jpeg" | "png")
}

fn ending_of(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder_of(files: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            std::fs::write(folder.path().join(file), b"x").unwrap();
        }
        folder
    }

    fn names(folder: &Path) -> Vec<String> {
        images_of(folder).unwrap().into_iter().map(|image| image.name).collect()
    }

    #[test]
    fn images_come_sorted_and_nothing_else_does() {
        let folder = folder_of(&["b.png", "a.JPG", "c.jpeg", "loops.csv", "README.md"]);
        std::fs::create_dir(folder.path().join("d.jpg")).unwrap();
        assert_eq!(names(folder.path()), ["a.JPG", "b.png", "c.jpeg"]);
    }

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let folder =
            folder_of(&["frame10.png", "frame2.png", "frame1.png", "frame002b.png", "g.png", "frame.png"]);
        let sorted = ["frame.png", "frame1.png", "frame2.png", "frame002b.png", "frame10.png", "g.png"];
        assert_eq!(names(folder.path()), sorted);
    }

    #[test]
    fn stamps_in_names_count_as_times() {
        let folder = folder_of(&["1305031102.9.png", "1305031102.175304.png", "1305031101.png.png"]);
        // Not all end with a stamp: then numbers are numbers.
        assert_eq!(names(folder.path())[1..], ["1305031102.9.png", "1305031102.175304.png"]);
        std::fs::remove_file(folder.path().join("1305031101.png.png")).unwrap();
        assert_eq!(names(folder.path()), ["1305031102.175304.png", "1305031102.9.png"]);
        let first = &images_of(folder.path()).unwrap()[0];
        assert_eq!(first.stamp_ns, Some(1_305_031_102_175_304_000));
    }

    #[test]
    fn a_folder_called_images_is_preferred() {
        let folder = folder_of(&["cover.jpg"]);
        std::fs::create_dir(folder.path().join("images")).unwrap();
        std::fs::write(folder.path().join("images/000000.jpg"), b"x").unwrap();
        assert_eq!(names(folder.path()), ["000000.jpg"]);
    }

    #[test]
    fn images_of_formats_that_are_not_read_are_told() {
        let folder = folder_of(&["a.bmp", "b.BMP", "c.webp", "notes.txt"]);
        let said = images_of(folder.path()).unwrap_err().to_string();
        assert!(said.ends_with("(2 files .bmp, 1 file .webp: convert them to JPEG or PNG)"), "{said}");
        std::fs::write(folder.path().join("d.png"), b"x").unwrap();
        let told = told_of_others(&images_of(folder.path()).unwrap()).unwrap();
        assert!(told.starts_with("2 files .bmp, 1 file .webp beside the images, left out"), "{told}");
        let plain = folder_of(&["d.png", "notes.txt"]);
        assert_eq!(told_of_others(&images_of(plain.path()).unwrap()), None);
    }

    #[test]
    fn what_is_no_folder_of_images_is_refused() {
        let folder = folder_of(&["notes.txt"]);
        let file = folder.path().join("notes.txt");
        assert!(matches!(images_of(folder.path()), Err(ListingError::NoImages { others: None, .. })));
        assert!(matches!(images_of(&file), Err(ListingError::NotAFolder(_))));
        assert!(matches!(images_of(&folder.path().join("nowhere")), Err(ListingError::Missing(_))));
    }
}
