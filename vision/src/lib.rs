#![doc = include_str!("../README.md")]

mod camera;
pub mod depth;
pub mod feature_record;
pub mod features;
pub mod image;
pub mod look_alikes;
mod mat;
mod matching;
pub mod panorama;
pub mod structure;
pub mod verification;

pub use feature_record::FeatureRecord;
pub use features::{Extractor, Feature, FeatureSettings, Features, Keypoint};
pub use image::GreyImage;
pub use topomap::evidence::{TwoView, VerificationSettings};
pub use verification::{Pinhole, Verifier, View};
