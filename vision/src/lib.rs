//! Pixels to features.
//!
//! An encoded picture is decoded safely ([`image`]), shrunk to the width the model asks for, and
//! described by local features ([`features`]) whose descriptors go to the vocabulary:
//!
//! ```
//! use waypost_vision::features::{Extractor, FeatureSettings};
//! use waypost_vision::image::{GreyImage, decode};
//!
//! let chequered = (0..200 * 160).map(|i: u32| if (i / 200 / 20 + i % 200 / 20) % 2 == 0 { 40 } else { 200 });
//! let jpeg = GreyImage::new(200, 160, chequered.collect())?.encode_jpeg(90)?;
//!
//! let extractor = Extractor::new(FeatureSettings::default());
//! let features = extractor.extract(&decode(&jpeg)?)?;
//! assert_eq!(features.keypoints.len(), features.descriptors.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! This is the only crate that links OpenCV. It holds no state between calls and may be called
//! from any number of threads; each call stays on the thread it was made from.

pub mod feature_record;
pub mod features;
pub mod image;
mod mat;
pub mod panorama;
pub mod verification;
