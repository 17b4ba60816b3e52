use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{InPath, InQuery, ModelPath, Nothing, Paging};
use crate::pages::Page;
use crate::service::Service;
use crate::wire::models::model as message;

/// All models, newest first.
#[utoipa::path(get, path = "/v1/models", tag = "models", params(Paging),
    responses((status = 200, description = "A page of models.", body = v1::ListModelsResponse), Refusals))]
pub(super) async fn list_models(
    State(service): State<Arc<Service>>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListModelsResponse>, HttpError> {
    let Page { items, next } = service.models.list(page_size, &page_token).await?;
    let models = items.into_iter().map(message).collect();
    Ok(Json(v1::ListModelsResponse { models, next_page_token: next }))
}

/// A model.
#[utoipa::path(get, path = "/v1/models/{model}", tag = "models", params(ModelPath),
    responses((status = 200, description = "The model.", body = v1::Model), Refusals))]
pub(super) async fn get_model(
    State(service): State<Arc<Service>>,
    InPath(ModelPath { model }): InPath<ModelPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Model>, HttpError> {
    Ok(Json(message(service.models.find(&model).await?)))
}
