//! Images to words, off the async threads.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use fabmap::observation::Observation;
use tokio::sync::Semaphore;
use tokio_util::task::AbortOnDropHandle;
use tracing::Span;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::{ExtractError, Extractor, FeatureError, Features};
use waypost_vision::image::{self, GreyImage, ImageError};
use waypost_vision::look_alikes::TrainingImage;
use waypost_vision::panorama;

use super::admission::{Admission, Backlog};
use super::model::LoadedModel;
use super::panoramic::PanoramicOptics;
use crate::error::ServiceError;
use crate::map_settings::Keep;
use crate::storage::{Medium, MediumKind};

/// Bounds how many images are worked on at once, one a core, over all senders; and how many wait.
#[derive(Clone, Debug)]
pub(crate) struct Extraction {
    cores: Arc<Semaphore>,
    admission: Admission,
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

impl Extraction {
    pub(crate) fn new(cores: usize) -> Self {
        Self { cores: Arc::new(Semaphore::new(cores)), admission: Admission::new(cores) }
    }

    /// What waits just now.
    pub(crate) fn backlog(&self) -> Backlog {
        self.admission.backlog(Instant::now())
    }

    /// Decodes a robot's image and turns it into words, and into what is to be kept of it; `optics` are those of a
    /// camera that sees all around. Refused, with the time to wait, if too many are waiting already: then the next turn is that of its `stream`.
    pub(super) async fn observe_image(
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
    ) -> Result<TrainingImage, ServiceError> {
        self.run(move || {
            let (image, features) = extract(&extractor, &image)?;
            Ok(TrainingImage { size_px: (image.width(), image.height()), features })
        })
        .await
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
    let features = Some(Arc::new(features));
    let extract = start.elapsed() - quantize;
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
