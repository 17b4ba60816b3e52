use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, ModelPath, Nothing, Paging};
use crate::service::Service;
use crate::service::models::Page;
use crate::service::names::model_name;
use crate::storage::ModelRow;

/// All models, newest first.
#[utoipa::path(get, path = "/v1/models", tag = "models", params(Paging),
    responses((status = 200, description = "A page of models.", body = ModelList), Refusals))]
pub(super) async fn list_models(
    State(service): State<Arc<Service>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<ModelList>, HttpError> {
    let Page { items, next } = service.list_models(page_size, &page_token).await?;
    Ok(Json(ModelList { models: items.into_iter().map(Model::from).collect(), next_page_token: next }))
}

/// A model.
#[utoipa::path(get, path = "/v1/models/{model}", tag = "models", params(ModelPath),
    responses((status = 200, description = "The model.", body = Model), Refusals))]
pub(super) async fn get_model(
    State(service): State<Arc<Service>>,
    InPath(ModelPath { model }): InPath<ModelPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<Model>, HttpError> {
    Ok(Json(service.find_model(&model).await?.into()))
}

/// A page of models.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ModelList {
    models: Vec<Model>,
    /// Asks for the next page; empty on the last.
    next_page_token: String,
}

/// What is learnt before a robot drives: immutable, named by the hash of its content.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Model {
    /// `models/{64 hexadecimal digits}`
    #[schema(pattern = "^models/[0-9a-f]{64}$")]
    name: String,
    /// A name for people; need not be unique.
    display_name: String,
    /// Feature and settings that its words are made of.
    #[schema(example = "rootsift features=500 width=640")]
    extractor: String,
    /// Words of its vocabulary.
    words: u64,
    /// Observations in its sampling set.
    samples: u64,
    /// Hash of extractor and vocabulary: words of models with the same mean the same.
    #[schema(pattern = "^[0-9a-f]{64}$")]
    words_hash: String,
    /// Size of the model file.
    size_bytes: u64,
    /// When it came here, in nanoseconds since 1970.
    create_time_ns: i64,
}

impl From<ModelRow> for Model {
    fn from(row: ModelRow) -> Self {
        let ModelRow { hash, display_name, extractor, words, samples, words_hash, size_bytes, created_ns } =
            row;
        Self {
            name: model_name(&hash),
            display_name,
            extractor,
            words,
            samples,
            words_hash,
            size_bytes,
            create_time_ns: created_ns,
        }
    }
}
