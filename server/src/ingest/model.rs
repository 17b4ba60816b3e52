//! Models, ready for work.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, OnceLock, PoisonError};

use fabmap::model::Model;
use waypost_navigation::appearance::signature::Signatures;
use waypost_vision::features::{Extractor, FeatureSettings, SettingsError};

use crate::error::ServiceError;
use crate::storage::{Storage, StorageError};

/// The model that ships: trained on images of floors that are not in the demo; part of the program, so that it cannot be missing.
pub(crate) const SHIPPED: &[u8] = include_bytes!("../../../demo/model.waypost");

static SHIPPED_HASH: LazyLock<Option<String>> =
    LazyLock::new(|| Model::from_bytes(SHIPPED).ok().map(|model| model.hash().to_string()));

/// A model with the extractor that its words are made by.
#[derive(Debug)]
pub(crate) struct LoadedModel {
    pub(crate) model: Model,
    pub(crate) hash: String,
    /// Hash of extractor and vocabulary.
    pub(crate) words_hash: String,
    pub(super) extractor: Extractor,
    signatures: OnceLock<Signatures>,
}

impl LoadedModel {
    pub(crate) fn new(model: Model) -> Result<Self, ServiceError> {
        let extractor = extractor(model.extractor()).map_err(|error| {
            ServiceError::invalid(format_args!("the model's extractor is not known here: {error}"))
        })?;
        let feature = extractor.settings().feature();
        let vocabulary = model.vocabulary();
        if (feature.descriptor_kind(), feature.descriptor_width()) != (vocabulary.kind(), vocabulary.width())
        {
            return Err(ServiceError::invalid(format_args!(
                "the model's vocabulary is not of {} descriptors, which its extractor makes; train it anew",
                feature.name()
            )));
        }
        let hash = model.hash().to_string();
        let words_hash = model.words_hash().to_string();
        Ok(Self { hash, words_hash, extractor, model, signatures: OnceLock::new() })
    }

    /// Of the model's words. They are made when a map without metres first needs them.
    pub(crate) fn signatures(&self) -> &Signatures {
        self.signatures.get_or_init(|| Signatures::new(self.model.vocabulary()))
    }
}

/// The models in use, by hash; they are immutable. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct LoadedModels {
    storage: Storage,
    cached: Arc<Mutex<HashMap<String, Arc<LoadedModel>>>>,
}

impl LoadedModels {
    pub(crate) fn new(storage: Storage) -> Self {
        Self { storage, cached: Arc::default() }
    }

    /// A model ready for work, read from the database if need be.
    pub(crate) async fn get(&self, hash: &str) -> Result<Arc<LoadedModel>, ServiceError> {
        if let Some(model) = self.cached().get(hash) {
            return Ok(model.clone());
        }
        let file = file_of(hash, self.storage.model_file(hash).await)?;
        let load = move || LoadedModel::new(Model::from_bytes(&file).map_err(ServiceError::internal)?);
        let loaded = tokio::task::spawn_blocking(load).await.map_err(ServiceError::internal)??;
        let loaded = Arc::new(loaded);
        self.cached().insert(hash.to_owned(), loaded.clone());
        Ok(loaded)
    }

    pub(crate) fn forget(&self, hash: &str) {
        self.cached().remove(hash);
    }

    /// Forgets the models that nobody holds.
    pub(crate) fn forget_unused(&self) {
        self.cached().retain(|_, model| Arc::strong_count(model) > 1);
    }

    fn cached(&self) -> MutexGuard<'_, HashMap<String, Arc<LoadedModel>>> {
        self.cached.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The file of a model, as it was read. The one that ships is taken from the program where it is damaged on the disk.
pub(super) fn file_of(
    hash: &str,
    read: Result<Option<Vec<u8>>, StorageError>,
) -> Result<Vec<u8>, ServiceError> {
    match read {
        Err(StorageError::DamagedModel { hash, found }) if SHIPPED_HASH.as_deref() == Some(&hash) => {
            tracing::error!(
                found,
                "damage on the disk; the model is taken from the program, which has it, too"
            );
            Ok(SHIPPED.to_vec())
        }
        read => read?.ok_or_else(|| ServiceError::not_found(format_args!("there is no model {hash}"))),
    }
}

/// The extractor of a canonical text; the default one for an empty text.
pub(crate) fn extractor(text: &str) -> Result<Extractor, SettingsError> {
    let settings = if text.is_empty() { FeatureSettings::default() } else { text.parse()? };
    Ok(Extractor::new(settings))
}
