//! Images to words, off the async threads. The only module of the server that calls `vision`.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use fabmap::descriptor::Descriptors;
use fabmap::model::Model;
use fabmap::observation::Observation;
use tokio::sync::Semaphore;
use tokio_util::task::AbortOnDropHandle;
use waypost_vision::features::{ExtractError, Extractor, FeatureError, FeatureSettings, SettingsError};
use waypost_vision::image::ImageError;

use crate::error::ServiceError;

/// Bounds how many images are worked on at once: one a core, whoever sends them.
#[derive(Clone, Debug)]
pub(crate) struct Extraction {
    cores: Arc<Semaphore>,
}

/// A model with the extractor that its words are made by.
#[derive(Debug)]
pub(crate) struct LoadedModel {
    pub(crate) model: Model,
    pub(crate) hash: String,
    extractor: Extractor,
}

/// What an image shows, and how long it took to see it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Observed {
    pub(crate) observation: Observation,
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
        Ok(Self { hash: model.hash().to_string(), extractor, model })
    }
}

/// The extractor of a canonical text; the default one for an empty text.
pub(crate) fn extractor(text: &str) -> Result<Extractor, SettingsError> {
    let settings = if text.is_empty() { FeatureSettings::default() } else { text.parse()? };
    Ok(Extractor::new(settings))
}

impl Extraction {
    pub(crate) fn new(cores: usize) -> Self {
        Self { cores: Arc::new(Semaphore::new(cores)) }
    }

    /// Decodes an image and turns it into words.
    pub(crate) async fn observe(
        &self,
        model: Arc<LoadedModel>,
        image: Bytes,
    ) -> Result<Observed, ServiceError> {
        self.run(move || {
            let start = Instant::now();
            let descriptors = describe(&model.extractor, &image)?;
            let extract = start.elapsed();
            let observation =
                model.model.vocabulary().observe(&descriptors).map_err(ServiceError::internal)?;
            Ok(Observed { observation, extract, quantize: start.elapsed() - extract })
        })
        .await
    }

    /// Decodes an image and describes its features.
    pub(crate) async fn describe(
        &self,
        extractor: Extractor,
        image: Bytes,
    ) -> Result<Descriptors, ServiceError> {
        self.run(move || describe(&extractor, &image)).await
    }

    async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let cores = self.cores.clone();
        // A task of its own: a stream that is not polled, because its client does not read, must not
        // sit on a core that it was given.
        let task = AbortOnDropHandle::new(tokio::spawn(async move {
            let core = cores.acquire_owned().await.map_err(|_| ServiceError::stopping())?;
            let blocking = tokio::task::spawn_blocking(move || {
                let result = work();
                drop(core);
                result
            });
            blocking.await.map_err(ServiceError::internal)?
        }));
        task.await.map_err(ServiceError::internal)?
    }
}

fn describe(extractor: &Extractor, image: &[u8]) -> Result<Descriptors, ServiceError> {
    match extractor.extract_encoded(image) {
        Ok((_, features)) => Ok(features.descriptors),
        Err(ExtractError::Image(error)) => Err(image_error(&error)),
        Err(ExtractError::Feature(error)) => Err(feature_error(&error)),
    }
}

fn image_error(error: &ImageError) -> ServiceError {
    match error {
        ImageError::Empty
        | ImageError::TooManyBytes { .. }
        | ImageError::UnknownFormat { .. }
        | ImageError::Unsupported { .. }
        | ImageError::TooLarge { .. }
        | ImageError::TooSmall { .. }
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
