//! `waypost-eval train-scale`: what training and quantization cost, and how good they are, at the sizes of
//! large models.

mod tree;
mod vocabulary;

pub use tree::{TreeScaleOptions, TreeScaleReport, train_tree};
pub use vocabulary::{VocabularyScaleOptions, VocabularyScaleReport, train_vocabulary};

use std::path::PathBuf;

use fabmap::descriptor::Descriptors;
use serde::Serialize;
use waypost_vision::features::{Extractor, FeatureSettings};

use crate::commands::train;
use crate::dataset;
use crate::error::EvalError;
use crate::files;

/// What descriptors to write down.
#[derive(Clone, Debug, PartialEq)]
pub struct DescriptorOptions {
    /// Folders of images, or folders with a subfolder `images/` of them.
    pub images: Vec<PathBuf>,
    /// What to extract.
    pub features: FeatureSettings,
    /// The file to write: the rows alone, one after the other.
    pub out: PathBuf,
}

/// What was written.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DescriptorReport {
    /// Images.
    pub images: usize,
    /// Rows of the file.
    pub descriptors: usize,
    /// Bytes of a row.
    pub width: usize,
}

/// Extracts descriptors once, so that vocabularies of many sizes can be trained on them, by us and by others.
///
/// # Errors
/// [`EvalError`]; no file is written then.
pub fn write_descriptors(options: &DescriptorOptions) -> Result<DescriptorReport, EvalError> {
    let DescriptorOptions { images, features, out } = options;
    let mut paths = Vec::new();
    for folder in images {
        paths.extend(dataset::image_files(folder)?);
    }
    let of_images = train::extract_all(&paths, Extractor::new(*features))?;
    let rows: Vec<&[u8]> = of_images.iter().map(Descriptors::as_bytes).collect();
    files::write(out, &rows.concat())?;
    let descriptors = of_images.iter().map(Descriptors::len).sum();
    let report =
        DescriptorReport { images: paths.len(), descriptors, width: features.feature().descriptor_width() };
    eprintln!("{descriptors} descriptors of {} images in {}", paths.len(), out.display());
    Ok(report)
}
