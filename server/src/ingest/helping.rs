//! A server that does not own the database looks at images for the one that does.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use fabmap::model::Model;
use tokio::sync::Semaphore;

use super::extraction;
use super::looking::{Look, Seen};
use super::model::{LoadedModel, file_of};
use super::observed::Observed;
use crate::error::ServiceError;
use crate::storage::{MediumKind, model_file};

/// Models that are kept ready at most; a fleet has few.
const MODELS: usize = 8;

/// Looks at images, one on each core. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Helping {
    /// The address of the database, which has the models.
    database: Arc<str>,
    models: Arc<Mutex<HashMap<String, Arc<LoadedModel>>>>,
    cores: Arc<Semaphore>,
}

impl Helping {
    pub(crate) fn new(database: &str, cores: usize) -> Self {
        Self { database: database.into(), models: Arc::default(), cores: Arc::new(Semaphore::new(cores)) }
    }

    /// What an image shows.
    pub(crate) async fn look(&self, look: Look) -> Result<Seen, ServiceError> {
        let model = self.model(&look.model).await?;
        let core = self.cores.clone().acquire_owned().await.map_err(|_closed| ServiceError::stopping())?;
        let looking = tokio::task::spawn_blocking(move || {
            let _core = core;
            extraction::observe(&model, look.image.clone(), look.keep(), look.optics()?.as_ref())
        });
        match looking.await.map_err(ServiceError::internal)? {
            Ok(observed) => Ok(seen(observed)),
            Err(ServiceError::InvalidArgument { message }) => {
                Ok(Seen { refusal: message, ..Seen::default() })
            }
            Err(other) => Err(other),
        }
    }

    async fn model(&self, hash: &str) -> Result<Arc<LoadedModel>, ServiceError> {
        let known = || self.models.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(model) = known().get(hash) {
            return Ok(model.clone());
        }
        let file = file_of(hash, model_file(&self.database, hash).await)?;
        let load = move || LoadedModel::new(Model::from_bytes(&file).map_err(ServiceError::internal)?);
        let loaded = Arc::new(tokio::task::spawn_blocking(load).await.map_err(ServiceError::internal)??);
        let mut models = known();
        if models.len() >= MODELS {
            models.clear();
        }
        models.insert(hash.to_owned(), loaded.clone());
        Ok(loaded)
    }
}

fn seen(observed: Observed) -> Seen {
    let Observed { observation: _, features, media, extract, quantize } = observed;
    let thumbnail = media.into_iter().find(|medium| medium.kind == MediumKind::Thumbnail);
    Seen {
        features: features.map(|features| features.to_bytes()).unwrap_or_default(),
        thumbnail: thumbnail.map(|thumbnail| thumbnail.content).unwrap_or_default(),
        extract_s: extract.as_secs_f64(),
        quantize_s: quantize.as_secs_f64(),
        refusal: String::new(),
    }
}
