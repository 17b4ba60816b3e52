//! Images to words, off the async threads. The only module of the server that calls `vision`.

mod admission;

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use bytes::Bytes;
use fabmap::descriptor::Descriptors;
use fabmap::model::Model;
use fabmap::observation::Observation;
use fabmap::signature::Signatures;
use tokio::sync::Semaphore;
use tokio_util::task::AbortOnDropHandle;
use tracing::Span;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::{
    ExtractError, Extractor, FeatureError, FeatureSettings, Features, SettingsError,
};
use waypost_vision::image::{self, GreyImage, ImageError};
use waypost_vision::panorama;

use self::admission::Admission;
use crate::error::ServiceError;
use crate::service::camera::PanoramicOptics;
use crate::service::map_settings::Keep;
use crate::storage::{Medium, MediumKind};

/// Bounds how many images are worked on at once, one a core, whoever sends them; and how many wait.
#[derive(Clone, Debug)]
pub(crate) struct Extraction {
    cores: Arc<Semaphore>,
    admission: Admission,
}

/// A model with the extractor that its words are made by.
#[derive(Debug)]
pub(crate) struct LoadedModel {
    pub(crate) model: Model,
    pub(crate) hash: String,
    /// Hash of extractor and vocabulary.
    pub(crate) words_hash: String,
    extractor: Extractor,
    signatures: OnceLock<Signatures>,
}

/// What an image shows, and how long it took to see it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Observed {
    pub(crate) observation: Observation,
    /// Where it shows that; none if only how often is known.
    pub(crate) features: Option<Arc<FeatureRecord>>,
    /// What is kept of it beside its words.
    pub(crate) media: Vec<Medium>,
    pub(crate) extract: Duration,
    pub(crate) quantize: Duration,
}

impl LoadedModel {
    pub(crate) fn new(model: Model) -> Result<Self, ServiceError> {
        let extractor = extractor(model.extractor()).map_err(|error| {
            ServiceError::invalid(format_args!("the model's extractor is not known here: {error}"))
        })?;
        let (feature, vocabulary) = (extractor.settings().feature(), model.vocabulary());
        if (feature.descriptor_kind(), feature.descriptor_width()) != (vocabulary.kind(), vocabulary.width())
        {
            return Err(ServiceError::invalid(format_args!(
                "the model's vocabulary is not of {} descriptors, which its extractor makes; train it anew",
                feature.name()
            )));
        }
        let (hash, words_hash) = (model.hash().to_string(), model.words_hash().to_string());
        Ok(Self { hash, words_hash, extractor, model, signatures: OnceLock::new() })
    }

    /// Of the model's words. They are made when a map without metres first needs them.
    pub(crate) fn signatures(&self) -> &Signatures {
        self.signatures.get_or_init(|| Signatures::new(self.model.vocabulary()))
    }
}

/// The extractor of a canonical text; the default one for an empty text.
pub(crate) fn extractor(text: &str) -> Result<Extractor, SettingsError> {
    let settings = if text.is_empty() { FeatureSettings::default() } else { text.parse()? };
    Ok(Extractor::new(settings))
}

impl Extraction {
    pub(crate) fn new(cores: usize) -> Self {
        Self { cores: Arc::new(Semaphore::new(cores)), admission: Admission::new(cores) }
    }

    /// Decodes a robot's image and turns it into words, and into what is to be kept of it; `optics` are those of a
    /// camera that sees all around. Refused, with the time to wait, if too many are waiting already: then the next turn is that of its `stream`.
    pub(crate) async fn observe(
        &self,
        model: Arc<LoadedModel>,
        image: Bytes,
        keep: Keep,
        optics: Option<PanoramicOptics>,
        stream: Option<u64>,
    ) -> Result<Observed, ServiceError> {
        let admitted = self.admission.admit(stream, Instant::now()).map_err(ServiceError::overloaded)?;
        self.run(move || {
            let observed = observe(&model, image, keep, optics);
            admitted.done(Instant::now());
            observed
        })
        .await
    }

    /// Decodes an image and describes its features.
    pub(crate) async fn describe(
        &self,
        extractor: Extractor,
        image: Bytes,
    ) -> Result<Descriptors, ServiceError> {
        self.run(move || Ok(extract(&extractor, &image)?.1.descriptors)).await
    }

    async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let cores = self.cores.clone();
        // A task of its own: a stream that is not polled, because its client does not read, must not
        // sit on a core that it was given.
        let span = Span::current();
        let task = AbortOnDropHandle::new(tokio::spawn(async move {
            let core = cores.acquire_owned().await.map_err(|_| ServiceError::stopping())?;
            let blocking = tokio::task::spawn_blocking(move || {
                let result = span.in_scope(work);
                drop(core);
                result
            });
            blocking.await.map_err(ServiceError::internal)?
        }));
        task.await.map_err(ServiceError::internal)?
    }
}

/// Thumbnails are to be recognised by people, not by robots.
const THUMBNAIL_WIDTH_PX: u32 = 160;
const THUMBNAIL_QUALITY: u8 = 75;

fn observe(
    model: &LoadedModel,
    bytes: Bytes,
    keep: Keep,
    optics: Option<PanoramicOptics>,
) -> Result<Observed, ServiceError> {
    let start = Instant::now();
    let (image, features) = match optics {
        Some(optics) => extract_around(&model.extractor, &bytes, &optics)?,
        None => extract(&model.extractor, &bytes)?,
    };
    let extracted = start.elapsed();
    let Features { keypoints, descriptors } = features;
    let words = model.model.vocabulary().words(&descriptors).map_err(ServiceError::internal)?;
    let quantize = start.elapsed() - extracted;
    let observation = Observation::from_words(words.iter().copied(), model.model.vocabulary().len())
        .map_err(ServiceError::internal)?;
    let size_px = (image.width(), image.height());
    let features = FeatureRecord::new(size_px, keypoints, words, Some(descriptors));
    let features = features.map_err(ServiceError::internal)?;
    let mut media = Vec::new();
    if keep >= Keep::Features {
        media.push(Medium { kind: MediumKind::Features, content: features.to_bytes() });
        let small = image.resize_to_width(THUMBNAIL_WIDTH_PX).map_err(ServiceError::internal)?;
        let content = small.encode_jpeg(THUMBNAIL_QUALITY).map_err(ServiceError::internal)?;
        media.push(Medium { kind: MediumKind::Thumbnail, content });
    }
    if keep >= Keep::Images {
        media.push(Medium { kind: MediumKind::Image, content: bytes.into() });
    }
    let (features, extract) = (Some(Arc::new(features)), start.elapsed() - quantize);
    Ok(Observed { observation, features, media, extract, quantize })
}

fn extract(extractor: &Extractor, image: &[u8]) -> Result<(GreyImage, Features), ServiceError> {
    match extractor.extract_encoded(image) {
        Ok(extracted) => Ok(extracted),
        Err(ExtractError::Image(error)) => Err(image_error(&error)),
        Err(ExtractError::Feature(error)) => Err(feature_error(&error)),
    }
}

/// The same of a camera that sees all around: what lies across the panorama's seam is whole.
fn extract_around(
    extractor: &Extractor,
    image: &[u8],
    optics: &PanoramicOptics,
) -> Result<(GreyImage, Features), ServiceError> {
    let image = image::decode(image).map_err(|error| image_error(&error))?;
    let panorama = optics.panorama(image, extractor.settings().image_width())?;
    let features = panorama::extract(extractor, &panorama).map_err(|error| feature_error(&error))?;
    let features = optics.of_the_world(features, (panorama.width(), panorama.height()));
    Ok((panorama, features))
}

fn image_error(error: &ImageError) -> ServiceError {
    match error {
        ImageError::Empty
        | ImageError::TooManyBytes { .. }
        | ImageError::UnknownFormat { .. }
        | ImageError::Unsupported { .. }
        | ImageError::TooLarge { .. }
        | ImageError::TooSmall { .. }
        | ImageError::TooLong { .. }
        | ImageError::TooMuchMemory
        | ImageError::Truncated
        | ImageError::Damaged { .. } => ServiceError::invalid(error),
        ImageError::NoPixels { .. }
        | ImageError::PixelCount { .. }
        | ImageError::Resize { .. }
        | ImageError::Quality { .. }
        | ImageError::Encode { .. } => ServiceError::internal(error),
    }
}

fn feature_error(error: &FeatureError) -> ServiceError {
    match error {
        FeatureError::TooSmall { .. } => ServiceError::invalid(error),
        FeatureError::Shrink(_) | FeatureError::OpenCv { .. } | FeatureError::Descriptors(_) => {
            ServiceError::internal(error)
        }
    }
}
