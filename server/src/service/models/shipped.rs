//! The model that ships: what a server without models begins with.

use super::{ModelRow, Models};
use crate::error::ServiceError;

/// Trained on images of floors that are not in the demo; part of the program, so that it cannot be missing.
const FILE: &[u8] = include_bytes!("../../../../demo/model.waypost");

/// What people call it.
const DISPLAY_NAME: &str = "shipped";

impl Models {
    /// Takes in the model that ships, unless there is any model already: whoever has models of their own chose them.
    pub(crate) async fn take_in_shipped(&self) -> Result<(), ServiceError> {
        if self.storage.models(None, 1).await?.is_empty() {
            self.import(DISPLAY_NAME, FILE.to_vec()).await?;
            tracing::info!(name = DISPLAY_NAME, "there was no model; the one that ships was taken in");
        }
        Ok(())
    }

    /// As [`Models::find`]; where nothing is named, the only model that there is.
    pub(crate) async fn find_or_only(&self, reference: &str) -> Result<ModelRow, ServiceError> {
        if !reference.is_empty() {
            return self.find(reference).await;
        }
        let mut models = self.storage.models(None, 2).await?;
        match (models.pop(), models.is_empty()) {
            (Some(model), true) => Ok(model),
            (Some(_), false) => Err(ServiceError::invalid(
                "the server has more than one model, so name one: by its hash, the beginning of it, or its display \
                 name; list the models to see what there is",
            )),
            (None, _) => Err(ServiceError::not_found("the server has no model; train or import one")),
        }
    }
}
