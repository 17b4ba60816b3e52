//! What was mistaken for what: each false proposal beside the frame that it named.

use std::io::Cursor;
use std::path::Path;

use anyhow::{Context, Result};
use image::imageops::{self, FilterType};
use image::{ImageFormat, RgbImage};

use crate::dataset::Sequence;
use crate::files;

/// A frame and the earlier one that it was held for, by index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Mistake {
    /// The frame.
    pub frame: usize,
    /// What it was held for.
    pub held_for: usize,
}

/// Height that both images are shrunk to.
const HEIGHT_PX: u32 = 240;

/// Writes a picture for each mistake into `folder`: `<frame>-<held for>.jpg`, the frame to the left. What an
/// earlier run left there goes.
pub(crate) fn write_all(folder: &Path, sequence: &Sequence, mistakes: &[Mistake]) -> Result<()> {
    match std::fs::remove_dir_all(folder) {
        Err(reason) if reason.kind() != std::io::ErrorKind::NotFound => {
            return Err(files::not_written(folder)(reason));
        }
        Ok(()) | Err(_) => {}
    }
    if mistakes.is_empty() {
        return Ok(());
    }
    files::create_folder(folder)?;
    for Mistake { frame, held_for } in mistakes {
        let pair = [shrunk(&sequence.images[*frame])?, shrunk(&sequence.images[*held_for])?];
        let path = folder.join(format!("{frame:06}-{held_for:06}.jpg"));
        let mut bytes = Cursor::new(Vec::new());
        beside(&pair)
            .write_to(&mut bytes, ImageFormat::Jpeg)
            .with_context(|| format!("{} could not be drawn", path.display()))?;
        files::write(&path, bytes.get_ref())?;
    }
    Ok(())
}

fn shrunk(path: &Path) -> Result<RgbImage> {
    let image = image::load_from_memory(&files::read(path)?).with_context(|| path.display().to_string())?;
    Ok(image.resize(u32::MAX, HEIGHT_PX, FilterType::Triangle).into_rgb8())
}

fn beside([left, right]: &[RgbImage; 2]) -> RgbImage {
    let gap = 4;
    let mut both = RgbImage::new(left.width() + gap + right.width(), left.height().max(right.height()));
    imageops::replace(&mut both, left, 0, 0);
    imageops::replace(&mut both, right, i64::from(left.width() + gap), 0);
    both
}
