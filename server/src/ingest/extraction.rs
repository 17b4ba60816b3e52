//! Images to words, off the async threads, or on another server.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use bytes::Bytes;
use fabmap::observation::Observation;
use rustls::ClientConfig;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::task::AbortOnDropHandle;
use tracing::{Instrument, Span};
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::{ExtractError, Extractor, FeatureError, Features};
use waypost_vision::image::{self, GreyImage, ImageError};
use waypost_vision::look_alikes::TrainingImage;
use waypost_vision::panorama;

use super::admission::{Admission, Backlog};
use super::helpers::{Helpers, NotSeen};
use super::model::LoadedModel;
use super::observed::Observed;
use super::panoramic::PanoramicOptics;
use crate::error::ServiceError;
use crate::map_settings::Keep;
use crate::storage::{HelperRow, Medium, MediumKind};

/// Bounds how many images are worked on at once, one a core, over all senders; and how many wait.
#[derive(Clone, Debug)]
pub(crate) struct Extraction {
    cores: Arc<Semaphore>,
    /// How many cores there are here.
    own: usize,
    helpers: Helpers,
    admission: Admission,
    /// Robots' images that were looked at here.
    looked_at: Arc<AtomicU64>,
}

impl Extraction {
    pub(crate) fn new(cores: usize) -> Self {
        Self {
            cores: Arc::new(Semaphore::new(cores)),
            own: cores,
            helpers: Helpers::default(),
            admission: Admission::new(cores),
            looked_at: Arc::default(),
        }
    }

    /// Which servers look at images for this one from now on.
    pub(crate) fn set_helpers(&self, rows: &[HelperRow], secret: &Arc<str>, tls: Option<&Arc<ClientConfig>>) {
        self.helpers.set(rows, secret, tls);
        self.admission.set_cores(self.own + self.helpers.cores());
    }

    /// Cores of servers that look at images for this one, and how many they have looked at.
    pub(crate) fn help(&self) -> Help {
        Help { cores: self.helpers.cores(), images: self.helpers.helped() }
    }

    /// Robots' images that were looked at here.
    pub(crate) fn looked_at(&self) -> u64 {
        self.looked_at.load(Ordering::Relaxed)
    }

    /// Images that the helper of that number has looked at; `None` if it is not asked.
    pub(crate) fn helped_by(&self, id: i64) -> Option<u64> {
        self.helpers.helped_by(id)
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
        let observed = self.observe_anywhere(model, image, keep, optics).await;
        admitted.done(Instant::now());
        observed
    }

    /// On the first core that is free, here or at a helper.
    async fn observe_anywhere(
        &self,
        model: Arc<LoadedModel>,
        image: Bytes,
        keep: Keep,
        optics: Option<PanoramicOptics>,
    ) -> Result<Observed, ServiceError> {
        let (extraction, span) = (self.clone(), Span::current());
        // A task of its own, as in `run`.
        let task = AbortOnDropHandle::new(tokio::spawn(
            async move {
                let place = tokio::select! {
                    biased;
                    core = extraction.cores.clone().acquire_owned() => {
                        let core = core.map_err(|_closed| ServiceError::stopping())?;
                        let look = move || observe(&model, image, keep, optics.as_ref());
                        return extraction.counted(on_core(core, look).await);
                    }
                    place = extraction.helpers.place() => place,
                };
                match place.observe(&model, &image, keep, optics.as_ref()).await {
                    Ok(observed) => Ok(observed),
                    Err(NotSeen::Refused(error)) => Err(error),
                    Err(not_seen) => {
                        place.give_up(&not_seen);
                        drop(place);
                        let look = move || observe(&model, image, keep, optics.as_ref());
                        extraction.counted(extraction.run(look).await)
                    }
                }
            }
            .instrument(span),
        ));
        task.await.map_err(ServiceError::internal)?
    }

    /// Counts an image that was looked at here.
    fn counted(&self, observed: Result<Observed, ServiceError>) -> Result<Observed, ServiceError> {
        if observed.is_ok() {
            self.looked_at.fetch_add(1, Ordering::Relaxed);
        }
        observed
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
        let waiting = async move {
            let core = cores.acquire_owned().await.map_err(|_closed| ServiceError::stopping())?;
            on_core(core, work).await
        };
        let task = AbortOnDropHandle::new(tokio::spawn(waiting.instrument(Span::current())));
        task.await.map_err(ServiceError::internal)?
    }
}

async fn on_core<T: Send + 'static>(
    core: OwnedSemaphorePermit,
    work: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
) -> Result<T, ServiceError> {
    let span = Span::current();
    let blocking = tokio::task::spawn_blocking(move || {
        let result = span.in_scope(work);
        drop(core);
        result
    });
    blocking.await.map_err(ServiceError::internal)?
}

/// What other servers do for this one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Help {
    /// Cores that they look at images with.
    pub(crate) cores: usize,
    /// Images that they have looked at.
    pub(crate) images: u64,
}

/// Thumbnails are to be recognised by people, not by robots.
const THUMBNAIL_WIDTH_PX: u32 = 160;
const THUMBNAIL_QUALITY: u8 = 75;

/// What an image shows to a model, and what is to be kept of it.
pub(super) fn observe(
    model: &LoadedModel,
    bytes: Bytes,
    keep: Keep,
    optics: Option<&PanoramicOptics>,
) -> Result<Observed, ServiceError> {
    let start = Instant::now();
    let (image, features) = match optics {
        Some(optics) => extract_around(&model.extractor, &bytes, optics)?,
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
