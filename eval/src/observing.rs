//! From images to words and what geometry needs of them, and the comparison of a frame with those before it.

use std::sync::Arc;

use anyhow::{Result, anyhow};
use fabmap::model::Model;
use fabmap::observation::Observation;
use topomap::evidence::TwoView;
use topomap::ids::FrameId;
use topomap::in_memory::Views;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::{Extractor, Features};
use waypost_vision::image::GreyImage;
use waypost_vision::structure::RobotCamera;
use waypost_vision::verification::{Verifier, View};

use crate::event_log::EventLog;
use crate::timing::FrameWatch;

/// What a frame shows.
#[derive(Clone)]
pub(crate) struct Observed {
    pub(crate) observation: Observation,
    pub(crate) features: FeatureRecord,
}

impl Observed {
    /// What the image shows of a JPEG or PNG file.
    pub(crate) fn in_file(
        encoded: &[u8],
        model: &Model,
        extractor: Extractor,
        watch: &mut FrameWatch,
    ) -> Result<Self> {
        let (image, features) = extractor.extract_encoded(encoded)?;
        watch.extracted();
        Self::in_words((image.width(), image.height()), features, model, watch)
    }

    /// What an image shows.
    pub(crate) fn in_image(
        image: &GreyImage,
        model: &Model,
        extractor: Extractor,
        watch: &mut FrameWatch,
    ) -> Result<Self> {
        let features = extractor.extract(image)?;
        watch.extracted();
        Self::in_words((image.width(), image.height()), features, model, watch)
    }

    fn in_words(
        size_px: (u32, u32),
        features: Features,
        model: &Model,
        watch: &mut FrameWatch,
    ) -> Result<Self> {
        let Features { keypoints, descriptors } = features;
        let words = model.vocabulary().words(&descriptors).map_err(|reason| {
            anyhow!(
                "the model's vocabulary does not fit its own extractor ({reason}); train the model anew with \
                 `waypost-eval train`"
            )
        })?;
        let observation = Observation::from_words(words.iter().copied(), model.vocabulary().len())
            .unwrap_or_else(|_| unreachable!("a vocabulary's own words"));
        watch.quantized();
        let features = FeatureRecord::new(size_px, keypoints, words, Some(descriptors))
            .unwrap_or_else(|_| unreachable!("a keypoint, a word and a descriptor for each feature"));
        Ok(Self { observation, features })
    }
}

/// The frame that is being decided, beside all before it.
pub(crate) struct CurrentView<'a> {
    pub(crate) current: &'a FeatureRecord,
    pub(crate) log: &'a EventLog,
    /// By sequence number.
    pub(crate) earlier: &'a [Arc<FeatureRecord>],
    pub(crate) verifier: Verifier,
    /// `None` if nothing is known of it.
    pub(crate) camera: Option<RobotCamera>,
}

impl Views for CurrentView<'_> {
    fn compare(&self, earlier: FrameId) -> Option<TwoView> {
        let earlier = self.earlier.get(self.log.index(earlier)?)?;
        let view = |features| View { features, camera: self.camera };
        Some(self.verifier.compare(view(earlier), view(self.current)))
    }

    fn focal_length_widths(&self) -> Option<f64> {
        Some(self.camera?.pinhole.focal_length_widths(self.current.image_size_px().0))
    }
}
