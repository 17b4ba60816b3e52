use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::State;
use axum::extract::rejection::BytesRejection;
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};
use waypost_proto::v1;

use super::description::{QueryRefusals, Refusals};
use super::frames::ImageFile;
use super::parameters::{InPath, InQuery, MapPath, Parameters};
use super::{HttpError, error_response};
use crate::error::ServiceError;
use crate::ingest::content::{self, Content};
use crate::names::map_name;
use crate::service::Service;
use crate::service::tokens::Caller;
use crate::wire::recognition::query_response;

/// Largest body taken in, as over gRPC: an image that is too large is refused with a reason.
pub(super) const MAX_BODY_BYTES: usize = 16 << 20;

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Asked {
    /// Explains the most probable place, with this many words for it and as many against it. No explanation if left out.
    #[param(minimum = 0, maximum = 100)]
    explained_words: Option<u32>,
}

impl Parameters for Asked {
    const TAKES: &str = "explained_words=NUMBER";
}

/// Where one image, or one bag of words, was taken.
///
/// There is no session, and nothing is remembered: every place is as likely beforehand.
#[utoipa::path(post, path = "/v1/maps/{map}/query", tag = "maps", params(MapPath, Asked),
    request_body(description = "An image of at most 4 MiB and 16 megapixels, or words.",
        content((ImageFile = "image/jpeg"), (ImageFile = "image/png"), (WordQuery = "application/json"))),
    responses((status = 200, description = "Where it was taken.", body = v1::QueryResponse), Refusals, QueryRefusals))]
pub(super) async fn query(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Asked { explained_words }): InQuery<Asked>,
    Extension(caller): Extension<Arc<Caller>>,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<Json<v1::QueryResponse>, QueryError> {
    let (content, words_hash) = shown(&headers, body).await?;
    let answer =
        service.queries.query(&caller, &map_name(&map), content, &words_hash, explained_words).await?;
    Ok(Json(query_response(answer)))
}

/// What a body shows, and of which words it is.
pub(super) async fn shown(
    headers: &HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<(Content, String), QueryError> {
    let declared = headers.get(CONTENT_TYPE).map_or("", |declared| declared.to_str().unwrap_or("not text"));
    let kind = declared.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    if !["image/jpeg", "image/png", "application/json"].contains(&kind.as_str()) {
        return Err(QueryError::UnsupportedMediaType { declared: declared.to_owned() });
    }
    let body = body.map_err(|rejection| match rejection.status() {
        StatusCode::PAYLOAD_TOO_LARGE => QueryError::TooLarge,
        _ => ServiceError::invalid(format_args!("{}; send the whole body", rejection.body_text())).into(),
    })?;
    if kind != "application/json" {
        return Ok((Content::Image(body), String::new()));
    }
    // Megabytes of numbers are not for the async threads.
    let parsed = tokio::task::spawn_blocking(move || serde_json::from_slice(&body)).await;
    let query: WordQuery = parsed.map_err(ServiceError::internal)?.map_err(|error| {
        ServiceError::invalid(format_args!(
            "the body holds no words in JSON: {error}; send words_hash with either histogram or words"
        ))
    })?;
    Ok(query.content()?)
}

/// Words that a robot made itself. Either a histogram or a list.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "words_hash": "5f0c6a1be1a54e6a1c65cf0d9e07b4c3f1d1ab0a53a2b6d53a0d0e6c1f6c5a11",
    "histogram": {"words": [3, 17, 1204], "counts": [1, 2, 1]}
}))]
pub(super) struct WordQuery {
    /// `words_hash` of the model that the words were made with.
    words_hash: String,
    #[serde(default)]
    histogram: Option<Histogram>,
    #[serde(default)]
    words: Option<WordList>,
}

/// How often words were seen in an image.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Histogram {
    /// Each word once, in any order, below the vocabulary's size.
    #[schema(max_items = 65536)]
    words: Vec<u32>,
    /// How often each was seen; as many as words. Left out: each was seen once.
    #[serde(default)]
    #[schema(max_items = 65536)]
    counts: Vec<u32>,
}

/// The features of an image; position i of each list is feature i. In pixels: x to the right and y down,
/// (0, 0) the centre of the top left pixel.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct WordList {
    /// Below the vocabulary's size. A word that was seen at several points is there as often.
    #[schema(max_items = 65536)]
    words: Vec<u32>,
    x_px: Vec<f32>,
    y_px: Vec<f32>,
    /// Diameter of the neighbourhood described; left out if not known.
    #[serde(default)]
    size_px: Vec<f32>,
    /// Orientation, from x to the right towards y down; left out if not known.
    #[serde(default)]
    angle_rad: Vec<f32>,
    /// Size of the image that the points are in.
    #[schema(minimum = 1, maximum = 65535)]
    image_width_px: u32,
    #[schema(minimum = 1, maximum = 65535)]
    image_height_px: u32,
}

impl WordQuery {
    fn content(self) -> Result<(Content, String), ServiceError> {
        let Self { words_hash, histogram, words } = self;
        let content = match (histogram, words) {
            (Some(Histogram { words, counts }), None) => {
                Content::Histogram { words: words.into_iter().map(Into::into).collect(), counts }
            }
            (None, Some(list)) => Content::Words(list.into()),
            (None, None) => {
                return Err(ServiceError::invalid("the body shows nothing; send a histogram or words"));
            }
            (Some(_), Some(_)) => {
                return Err(ServiceError::invalid("send a histogram or words, not both"));
            }
        };
        Ok((content, words_hash))
    }
}

impl From<WordList> for content::WordList {
    fn from(list: WordList) -> Self {
        let WordList { words, x_px, y_px, size_px, angle_rad, image_width_px, image_height_px } = list;
        let words = words.into_iter().map(Into::into).collect();
        Self { words, x_px, y_px, size_px, angle_rad, image_width_px, image_height_px }
    }
}

/// Why a query, or a frame, is not answered.
#[derive(Debug)]
pub(super) enum QueryError {
    Service(ServiceError),
    /// The body is beyond [`MAX_BODY_BYTES`].
    TooLarge,
    UnsupportedMediaType {
        declared: String,
    },
}

impl From<ServiceError> for QueryError {
    fn from(error: ServiceError) -> Self {
        Self::Service(error)
    }
}

impl From<HttpError> for QueryError {
    fn from(HttpError(error): HttpError) -> Self {
        Self::Service(error)
    }
}

impl IntoResponse for QueryError {
    fn into_response(self) -> Response {
        match self {
            QueryError::Service(error) => HttpError(error).into_response(),
            QueryError::TooLarge => {
                let message = format!(
                    "a body has at most {MAX_BODY_BYTES} bytes here, and an image 4 MiB of them; send a smaller image"
                );
                error_response(StatusCode::PAYLOAD_TOO_LARGE, "payload_too_large", message)
            }
            QueryError::UnsupportedMediaType { declared } => {
                let message = if declared.is_empty() {
                    "there is no Content-Type; send image/jpeg, image/png or application/json as it"
                        .to_owned()
                } else {
                    format!(
                        "the Content-Type {declared:?} is none that is taken here; send image/jpeg, image/png or \
                         application/json"
                    )
                };
                error_response(StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_media_type", message)
            }
        }
    }
}
