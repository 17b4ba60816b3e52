use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};
use waypost_proto::v1;

use super::HttpError;
use super::bodies::{InBody, JsonBody};
use super::description::{BodyRefusals, Refusals};
use super::parameters::{InPath, InQuery, ModelPath, Nothing, Paging, Parameters};
use super::uploads::{BinaryFile, Upload};
use crate::error::ServiceError;
use crate::names::model_name;
use crate::pages::Page;
use crate::service::Service;
use crate::service::models::MAX_MODEL_BYTES;
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

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Naming {
    /// What people call it; at most 100 characters.
    #[param(example = "site")]
    display_name: String,
}

impl Parameters for Naming {
    const TAKES: &str = "display_name=NAME";
}

/// Takes in a model file. One that is there already stays as it is, its display name among it. For administrators.
#[utoipa::path(post, path = "/v1/models", tag = "models", params(Naming),
    request_body(content = BinaryFile, content_type = "application/octet-stream", description = "The file, of at most 512 MiB."),
    responses((status = 200, description = "The model.", body = v1::Model), Refusals))]
pub(super) async fn import_model(
    State(service): State<Arc<Service>>,
    InQuery(Naming { display_name }): InQuery<Naming>,
    body: Body,
) -> Result<Json<v1::Model>, HttpError> {
    let mut upload = Upload::of(&service, body);
    let mut file = Vec::new();
    while let Some(piece) = upload.next().await? {
        file.extend_from_slice(&piece);
        if file.len() > MAX_MODEL_BYTES {
            let message =
                format!("a model file has at most {MAX_MODEL_BYTES} bytes; train one with fewer words");
            return Err(ServiceError::ResourceExhausted { message }.into());
        }
    }
    Ok(Json(message(service.models.import(&display_name, file).await?)))
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

/// A model as a file.
#[utoipa::path(get, path = "/v1/models/{model}/export", tag = "models", params(ModelPath),
    responses((status = 200, description = "The file.", body = BinaryFile, content_type = "application/octet-stream"), Refusals))]
pub(super) async fn export_model(
    State(service): State<Arc<Service>>,
    InPath(ModelPath { model }): InPath<ModelPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Response, HttpError> {
    let hash = service.models.find(&model).await?.hash;
    let file = service.models.export(&model_name(&hash)).await?;
    let name = format!("attachment; filename=\"{hash}.waypost\"");
    let about = [(CONTENT_TYPE, "application/octet-stream".to_owned()), (CONTENT_DISPOSITION, name)];
    Ok((about, file).into_response())
}

/// What a model is to be called.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({ "display_name": "site" }))]
pub(super) struct Renaming {
    /// At most 100 characters, without slashes and control characters.
    display_name: String,
}

impl JsonBody for Renaming {
    const TAKES: &str = r#"{"display_name": "site"}"#;
}

/// Gives a model another display name. For administrators.
#[utoipa::path(put, path = "/v1/models/{model}/display-name", tag = "models", params(ModelPath),
    request_body(content = Renaming, description = "What people call it from now on."),
    responses((status = 200, description = "The model.", body = v1::Model), Refusals, BodyRefusals))]
pub(super) async fn rename_model(
    State(service): State<Arc<Service>>,
    InPath(ModelPath { model }): InPath<ModelPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    InBody(Renaming { display_name }): InBody<Renaming>,
) -> Result<Json<v1::Model>, HttpError> {
    Ok(Json(message(service.models.rename(&model, &display_name).await?)))
}

/// Deletes a model that no map uses. For administrators.
#[utoipa::path(delete, path = "/v1/models/{model}", tag = "models", params(ModelPath),
    responses((status = 200, description = "It is gone.", body = v1::DeleteModelResponse), Refusals))]
pub(super) async fn delete_model(
    State(service): State<Arc<Service>>,
    InPath(ModelPath { model }): InPath<ModelPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::DeleteModelResponse>, HttpError> {
    service.models.delete(&model).await?;
    Ok(Json(v1::DeleteModelResponse {}))
}
