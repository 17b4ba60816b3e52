//! Vocabularies of other programs, told apart by what their files begin with.

use super::dbow_yaml::{self, DbowYamlError};
use super::fbow::{self, FbowError};
use super::orb_text::{self, OrbVocabularyError};
use crate::quantizer::DescentTree;

/// The beginning of DBoW3's own binary format, which may be packed by an algorithm of its own.
const DBOW3_BINARY: [u8; 8] = 88_877_711_233_u64.to_le_bytes();

/// The beginning of what gzip packs.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// Why bytes are not a vocabulary that can be imported.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImportError {
    /// A text as `ORBvoc.txt`, with a fault.
    #[error("as a vocabulary in DBoW2's text format: {0}")]
    Text(OrbVocabularyError),
    /// YAML of DBoW2 or DBoW3, with a fault.
    #[error("as a vocabulary of DBoW2 or DBoW3 in YAML: {0}")]
    Yaml(DbowYamlError),
    /// FBoW's format, with a fault.
    #[error("as a vocabulary of FBoW: {0}")]
    Fbow(FbowError),
    /// DBoW3's own binary format.
    #[error(
        "this is DBoW3's own binary format; load it by DBoW3, and save it to a file that ends in .yml.gz"
    )]
    Dbow3Binary,
    /// It is packed still.
    #[error("this is packed by gzip; unpack it first")]
    Packed,
    /// It is no text, and begins as no format that is known.
    #[error(
        "this is no vocabulary that is known; give ORBvoc.txt, a .yml or .yml.gz of DBoW2 or DBoW3, or a .fbow of FBoW"
    )]
    Unknown,
}

/// Reads the bytes of a whole file.
pub(super) fn parse(bytes: &[u8]) -> Result<DescentTree, ImportError> {
    if bytes.starts_with(&fbow::SIGNATURE) {
        return fbow::parse(bytes).map_err(ImportError::Fbow);
    }
    if bytes.starts_with(&DBOW3_BINARY) {
        return Err(ImportError::Dbow3Binary);
    }
    if bytes.starts_with(&GZIP) {
        return Err(ImportError::Packed);
    }
    let text = std::str::from_utf8(bytes).map_err(|_| ImportError::Unknown)?;
    if text.starts_with("%YAML") {
        return dbow_yaml::parse(text).map_err(ImportError::Yaml);
    }
    if text.starts_with(|sign: char| sign.is_ascii_digit() || sign.is_ascii_whitespace()) {
        return orb_text::parse(text).map_err(ImportError::Text);
    }
    Err(ImportError::Unknown)
}
