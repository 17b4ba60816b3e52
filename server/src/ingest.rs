//! From what a robot sends to what it shows: cameras, images, words. The only folder of the server that
//! names `waypost_vision`; the others have its types from here.

mod admission;
pub(crate) mod content;
pub(crate) mod extraction;
pub(crate) mod helpers;
pub(crate) mod helping;
pub(crate) mod intrinsics;
pub(crate) mod looking;
pub(crate) mod model;
pub(crate) mod observed;
pub(crate) mod panoramic;

pub(crate) use waypost_vision::feature_record::FeatureRecord;
pub(crate) use waypost_vision::features::{Extractor, Features, Keypoint};
pub(crate) use waypost_vision::look_alikes;
pub(crate) use waypost_vision::panorama::PanoramicView;
pub(crate) use waypost_vision::structure::{RobotCamera, TrackedFrame, Tracker};
pub(crate) use waypost_vision::verification::{Comparison, Verifier, View};
