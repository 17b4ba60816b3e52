//! The model that ships: what a server without models begins with.

use super::{ModelRow, Models};
use crate::error::ServiceError;
use crate::ingest::model::SHIPPED;

/// What people call it.
const DISPLAY_NAME: &str = "shipped";

/// Models that are named to whoever has to choose one.
const MOST_NAMED: u32 = 5;

impl Models {
    /// Takes in the model that ships, unless there is any model already: whoever has models of their own chose them.
    pub(crate) async fn take_in_shipped(&self) -> Result<(), ServiceError> {
        if self.storage.models(None, 1).await?.is_empty() {
            self.import(DISPLAY_NAME, SHIPPED.to_vec()).await?;
            tracing::info!(name = DISPLAY_NAME, "there was no model; the one that ships was taken in");
        }
        Ok(())
    }

    /// As [`Models::find`]; where nothing is named, the only model that there is.
    pub(crate) async fn find_or_only(&self, reference: &str) -> Result<ModelRow, ServiceError> {
        if !reference.is_empty() {
            return self.find(reference).await;
        }
        let mut models = self.storage.models(None, MOST_NAMED + 1).await?;
        match (models.pop(), models.is_empty()) {
            (Some(model), true) => Ok(model),
            (Some(last), false) => {
                models.push(last);
                Err(ServiceError::invalid(format_args!(
                    "the server has more than one model, so name one, by its display name or its hash: {}",
                    named(&models)
                )))
            }
            (None, _) => Err(ServiceError::not_found("the server has no model; train or import one")),
        }
    }
}

/// Some models by what each is called, or by its hash.
fn named(models: &[ModelRow]) -> String {
    let name = |model: &ModelRow| match model.display_name.as_str() {
        "" => model.hash.chars().take(12).collect(),
        display_name => display_name.to_owned(),
    };
    let names: Vec<String> = models.iter().take(MOST_NAMED as usize).map(name).collect();
    let more = if models.len() > names.len() { ", and others" } else { "" };
    format!("{}{more}", names.join(", "))
}
