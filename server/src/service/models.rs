//! Models: train, list, get, export, import, delete.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::ingest::look_alikes::{self, LearnError, TrainingImage};
use crate::ingest::{Extractor, Features};
use bytes::Bytes;
use fabmap::calibration;
use fabmap::chow_liu::TreeTrainingSettings;
use fabmap::detector::DetectorModel;
use fabmap::model::{Model, ModelTrainingError, ModelTrainingSettings, TrainingStage};
use fabmap::vocabulary::VocabularySettings;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::jobs::{JobOutcome, JobReporter, JobRequest, JobStatus, Jobs};
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::ingest::extraction::Extraction;
use crate::ingest::model::{LoadedModel, LoadedModels, extractor};
use crate::names::{id_in, model_name};
use crate::pages::{Page, bad_page_token, named_page, page_after, page_size};
pub(crate) use crate::storage::ModelRow;
use crate::storage::{JobKind, Storage, StorageError};

mod shipped;

/// Largest model file that is taken in.
pub(crate) const MAX_MODEL_BYTES: usize = 512 << 20;

/// Most bytes of descriptors that one training may hold: about 16,000 images of 500 features.
const MAX_TRAINING_BYTES: usize = 1 << 30;

/// Trainings that may upload, wait or run at the same time.
const MAX_UPLOADS: usize = 3;

const MAX_DISPLAY_NAME_CHARS: usize = 100;

/// How long the deletion of a model waits for the rows of deleted maps to go.
const MAP_REMOVAL: Duration = Duration::from_secs(5);
const REMOVAL_POLL: Duration = Duration::from_millis(20);

/// Fewest digits of a hash that name a model.
const MIN_HASH_DIGITS: usize = 6;

/// Training images as they come in: features are extracted at once, pixels are not kept.
#[derive(Debug)]
pub(crate) struct TrainingUpload {
    display_name: String,
    extractor: Extractor,
    settings: ModelTrainingSettings,
    images: Vec<TrainingImage>,
    bytes: usize,
    /// How many images the sender said would come: a cancelled upload can look like a complete one.
    announced: Option<u32>,
    /// Held until the training ends: there is memory for a few only.
    room: OwnedSemaphorePermit,
}

/// Models: trained, imported, looked up. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Models {
    storage: Storage,
    loaded: LoadedModels,
    extraction: Extraction,
    jobs: Jobs,
    uploads: Arc<Semaphore>,
}

impl Models {
    pub(super) fn new(storage: Storage, loaded: LoadedModels, extraction: Extraction, jobs: Jobs) -> Self {
        Self { storage, loaded, extraction, jobs, uploads: Arc::new(Semaphore::new(MAX_UPLOADS)) }
    }

    /// Begins a training: settings first, then images, then [`Models::start_training`].
    pub(crate) fn begin_training(
        &self,
        display_name: &str,
        extractor_text: &str,
        words: u32,
        seed: u64,
        announced: Option<u32>,
    ) -> Result<TrainingUpload, ServiceError> {
        let vocabulary = VocabularySettings { words, seed, ..VocabularySettings::default() };
        if !(VocabularySettings::MIN_WORDS..=VocabularySettings::MAX_WORDS).contains(&words) {
            return Err(ServiceError::invalid(format_args!(
                "a vocabulary needs at least {} words, not {words}, and has at most {}; 5000 suit a building",
                VocabularySettings::MIN_WORDS,
                VocabularySettings::MAX_WORDS
            )));
        }
        let room = self.uploads.clone().try_acquire_owned().map_err(|_| ServiceError::ResourceExhausted {
            message: format!("{MAX_UPLOADS} trainings are under way already; try again when one has ended"),
        })?;
        Ok(TrainingUpload {
            room,
            display_name: check_display_name(display_name)?,
            extractor: extractor(extractor_text).map_err(ServiceError::invalid)?,
            settings: ModelTrainingSettings {
                vocabulary,
                tree: TreeTrainingSettings::default(),
                detector: DetectorModel::default(),
            },
            images: Vec::new(),
            bytes: 0,
            announced,
        })
    }

    /// Takes one more training image.
    pub(crate) async fn add_training_image(
        &self,
        upload: &mut TrainingUpload,
        image: Bytes,
    ) -> Result<(), ServiceError> {
        let number = upload.images.len() + 1;
        let described =
            self.extraction.describe(upload.extractor, image).await.map_err(|error| match error {
                ServiceError::InvalidArgument { message } => {
                    ServiceError::invalid(format_args!("training image {number}: {message}"))
                }
                other => other,
            })?;
        let Features { keypoints, descriptors } = &described.features;
        upload.bytes += descriptors.as_bytes().len() + size_of_val(keypoints.as_slice());
        if upload.bytes > MAX_TRAINING_BYTES {
            return Err(ServiceError::ResourceExhausted {
                message: format!(
                    "{number} images have more features than a training may hold; send fewer images"
                ),
            });
        }
        upload.images.push(described);
        Ok(())
    }

    /// Trains in the background.
    pub(crate) async fn start_training(&self, upload: TrainingUpload) -> Result<JobStatus, ServiceError> {
        if upload.images.is_empty() {
            return Err(ServiceError::invalid("no training image was sent; send the settings, then images"));
        }
        let came = upload.images.len();
        if let Some(announced) = upload.announced.filter(|&announced| announced as usize != came) {
            return Err(ServiceError::invalid(format_args!(
                "{announced} images were announced and {came} came; send them all, or announce none"
            )));
        }
        self.check_name_is_free(&upload.display_name, None).await?;
        let models = self.clone();
        let work = move |reporter: JobReporter| async move { models.train(upload, &reporter).await };
        self.jobs.start(JobRequest::of_this_server(JobKind::TrainModel, &[]), work).await
    }

    async fn train(&self, upload: TrainingUpload, reporter: &JobReporter) -> JobOutcome {
        let Some(_turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
        let TrainingUpload { display_name, extractor, settings, images, room: _room, .. } = upload;
        let progress = reporter.clone();
        let trained = tokio::task::spawn_blocking(move || {
            // A pool of its own, one core short: robots want likelihoods meanwhile.
            let cores = std::thread::available_parallelism().map_or(1, usize::from);
            let threads = (cores - 1).max(1);
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .map_err(ServiceError::internal)?;
            let name = extractor.settings().to_string();
            let mut observer =
                |p: fabmap::model::ModelTrainingProgress| progress.progress(stage_name(p.stage), p.fraction);
            let trained = pool.install(|| {
                let model = Model::train(&name, &images, &settings, &mut observer)?;
                let mut observer = |fraction| progress.progress("learning how reliable words are", fraction);
                let model = match calibration::calibrate(&model, &mut observer) {
                    ControlFlow::Continue((model, _)) => model,
                    ControlFlow::Break(()) => return Err(ModelTrainingError::Cancelled),
                };
                let mut observer = |fraction| progress.progress("learning what look-alikes show", fraction);
                knowing_look_alikes(model, &images, &mut observer)
            });
            Ok(trained.map(|model| {
                let file = model.to_bytes();
                (row_of(&model, display_name, &file), file)
            }))
        })
        .await;
        let (row, file) = match trained {
            Ok(Ok(Ok(trained))) => trained,
            Ok(Ok(Err(ModelTrainingError::Cancelled))) => return JobOutcome::Cancelled,
            Ok(Ok(Err(error))) => return JobOutcome::Failed(ServiceError::invalid(error)),
            Ok(Err(error)) => return JobOutcome::Failed(error),
            Err(panic) => return JobOutcome::Failed(ServiceError::internal(panic)),
        };
        if reporter.progress("storing", 0.0) == ControlFlow::Break(()) {
            return JobOutcome::Cancelled;
        }
        let end = reporter.succeeded(model_name(&row.hash));
        if let Err(error) = self.storage.put_trained_model(&row, &file, &end).await {
            return JobOutcome::Failed(error.into());
        }
        JobOutcome::Stored(end)
    }

    /// Takes in a model file.
    pub(crate) async fn import(&self, display_name: &str, file: Vec<u8>) -> Result<ModelRow, ServiceError> {
        let display_name = check_display_name(display_name)?;
        let decode = move || {
            let model = Model::from_bytes(&file).map_err(ServiceError::invalid)?;
            // Refused here rather than at the first frame.
            let loaded = LoadedModel::new(model)?;
            Ok::<_, ServiceError>((row_of(&loaded.model, display_name, &file), file))
        };
        let (row, file) = tokio::task::spawn_blocking(decode).await.map_err(ServiceError::internal)??;
        self.check_name_is_free(&row.display_name, Some(&row.hash)).await?;
        // Whoever brings one again since it is damaged is not told that it is there.
        if !self.storage.put_model(&row, &file).await? {
            self.storage.model_file(&row.hash).await?;
        }
        self.find(&row.hash).await
    }

    /// Refuses a display name that another model has: commands that name it would stand for either. `hash` is of the
    /// model that is to have it, if there is one.
    async fn check_name_is_free(&self, display_name: &str, hash: Option<&str>) -> Result<(), ServiceError> {
        if display_name.is_empty() {
            return Ok(());
        }
        let called = self.storage.models_by_display_name(display_name).await?;
        match called.iter().find(|model| Some(model.hash.as_str()) != hash) {
            None => Ok(()),
            Some(other) => Err(ServiceError::AlreadyExists {
                message: format!(
                    "the model {} is called {display_name:?} already; choose another name, or rename that one first",
                    other.hash
                ),
            }),
        }
    }

    /// A model by `models/{hash}`, a beginning of its hash, or its display name.
    pub(crate) async fn find(&self, reference: &str) -> Result<ModelRow, ServiceError> {
        let (hash, display_name) = match reference.strip_prefix("models/") {
            Some(_) => (id_in("models", reference)?, None),
            None if reference.is_empty() => {
                let message = "name a model: by its hash, the beginning of it, or its display name";
                return Err(ServiceError::invalid(message));
            }
            None => (reference, Some(reference)),
        };
        let is_hash = hash.len() >= MIN_HASH_DIGITS && hash.chars().all(|digit| digit.is_ascii_hexdigit());
        let mut found = if is_hash { self.storage.models_by_hash(hash).await? } else { Vec::new() };
        if let (true, Some(name)) = (found.is_empty(), display_name) {
            found = self.storage.models_by_display_name(name).await?;
        }
        match (found.pop(), found.is_empty()) {
            (Some(model), true) => Ok(model),
            (Some(_), false) => Err(ServiceError::precondition(format_args!(
                "more than one model is called {reference:?}; name it by its hash"
            ))),
            (None, _) => {
                let is_short =
                    hash.len() < MIN_HASH_DIGITS && hash.chars().all(|digit| digit.is_ascii_hexdigit());
                let digits = format!(" (the beginning of a hash has at least {MIN_HASH_DIGITS} digits)");
                let digits = if is_short { digits.as_str() } else { "" };
                Err(ServiceError::not_found(format_args!(
                    "there is no model {reference:?}{digits}; list the models to see what there is (waypost model ls), or train or \
                     import one"
                )))
            }
        }
    }

    pub(crate) async fn list(&self, size: u32, token: &str) -> Result<Page<ModelRow>, ServiceError> {
        let size = page_size(size)?;
        let last = named_page(token)?;
        let after = match last.split_once('.') {
            Some((created_ns, hash)) if is_full_hash(hash) => {
                Some((created_ns.parse().map_err(|_| bad_page_token())?, hash))
            }
            None if last.is_empty() => None,
            Some(_) | None => return Err(bad_page_token()),
        };
        let mut items = self.storage.models(after, size + 1).await?;
        let more = items.len() > size as usize;
        items.truncate(size as usize);
        let last = items.last().filter(|_| more);
        let next = last
            .map_or_else(String::new, |model| page_after(&format!("{}.{}", model.created_ns, model.hash)));
        Ok(Page { items, next })
    }

    /// The model file.
    pub(crate) async fn export(&self, reference: &str) -> Result<Vec<u8>, ServiceError> {
        let model = self.find(reference).await?;
        let file = self.storage.model_file(&model.hash).await?;
        file.ok_or_else(|| ServiceError::not_found(format_args!("the model {} was just deleted", model.hash)))
    }

    /// Gives a model another display name.
    pub(crate) async fn rename(&self, reference: &str, display_name: &str) -> Result<ModelRow, ServiceError> {
        let display_name = check_display_name(display_name)?;
        if display_name.is_empty() {
            return Err(ServiceError::invalid(
                "a model without a display name can be named by its hash alone; give one",
            ));
        }
        let model = self.find(reference).await?;
        self.check_name_is_free(&display_name, Some(&model.hash)).await?;
        self.storage.rename_model(&model.hash, &display_name).await?;
        self.find(&model_name(&model.hash)).await
    }

    pub(crate) async fn delete(&self, reference: &str) -> Result<(), ServiceError> {
        let model = self.find(reference).await?;
        let deadline = Instant::now() + MAP_REMOVAL;
        loop {
            match self.storage.delete_model(&model.hash).await {
                Ok(_) => {
                    self.loaded.forget(&model.hash);
                    return Ok(());
                }
                // Rows of a map that was deleted just now may still be there.
                Err(StorageError::InUse) if !self.storage.only_retired_maps_use(&model.hash).await? => {
                    return Err(ServiceError::precondition(format_args!(
                        "a map uses the model {}; delete the map first, or keep the model",
                        model.hash
                    )));
                }
                Err(StorageError::InUse) if Instant::now() < deadline => {
                    tokio::time::sleep(REMOVAL_POLL).await;
                }
                Err(StorageError::InUse) => {
                    return Err(ServiceError::precondition(format_args!(
                        "a map that uses the model {} is still being deleted; try again in a moment",
                        model.hash
                    )));
                }
                Err(error) => return Err(error.into()),
            }
        }
    }
}

fn is_full_hash(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|digit| digit.is_ascii_hexdigit())
}

/// Hashes the model: not for the async threads.
pub(super) fn row_of(model: &Model, display_name: String, file: &[u8]) -> ModelRow {
    ModelRow {
        hash: model.hash().to_string(),
        display_name,
        extractor: model.extractor().to_owned(),
        words: model.vocabulary().len() as u64,
        samples: model.sampling_set().len() as u64,
        words_hash: model.words_hash().to_string(),
        size_bytes: file.len() as u64,
        created_ns: now_ns(),
    }
}

pub(super) fn check_display_name(name: &str) -> Result<String, ServiceError> {
    let fits = name.chars().count() <= MAX_DISPLAY_NAME_CHARS && !name.chars().any(char::is_control);
    if fits && !name.contains('/') {
        return Ok(name.to_owned());
    }
    Err(ServiceError::invalid(format_args!(
        "a display name has at most {MAX_DISPLAY_NAME_CHARS} characters and no slash or control character"
    )))
}

/// The same model, which knows what look-alikes of its training images show, if those tell.
fn knowing_look_alikes(
    model: Model,
    images: &[TrainingImage],
    observer: &mut dyn FnMut(f64) -> ControlFlow<()>,
) -> Result<Model, ModelTrainingError> {
    match look_alikes::learn(&model, images, observer) {
        Ok(look_alikes) => Ok(model.with_look_alikes(look_alikes)),
        Err(LearnError::Cancelled) => Err(ModelTrainingError::Cancelled),
        Err(
            error @ (LearnError::TooFew { .. }
            | LearnError::NoOrder
            | LearnError::Vocabulary(_)
            | LearnError::Uneven(_)
            | LearnError::LookAlikes(_)),
        ) => {
            tracing::warn!(%error, "a model without look-alikes: its maps ask for more evidence");
            Ok(model)
        }
    }
}

fn stage_name(stage: TrainingStage) -> &'static str {
    match stage {
        TrainingStage::Vocabulary => "finding words",
        TrainingStage::Quantization => "turning images into words",
        TrainingStage::Tree => "learning which words go together",
    }
}
