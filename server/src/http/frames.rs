use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use utoipa::openapi::schema::{KnownFormat, SchemaFormat, Type};
use utoipa::openapi::{ObjectBuilder, RefOr, Schema};
use utoipa::{IntoParams, PartialSchema, ToSchema};
use waypost_proto::v1;

use super::HttpError;
use super::description::Refusals;
use super::parameters::{FramePath, InPath, InQuery, Nothing, Parameters};
use crate::error::ServiceError;
use crate::service::Service;
use crate::service::frames::{FrameImage, ImageSize};
use crate::wire::sessions::frame_record;

impl FramePath {
    /// `maps/{map}/sessions/{session}/frames/{sequence}`.
    pub(super) fn name(&self) -> String {
        let Self { map, session, sequence } = self;
        format!("maps/{map}/sessions/{session}/frames/{sequence}")
    }
}

/// A frame: what was decided about it, where the wheels put the robot, and its words.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}/frames/{sequence}", tag = "sessions",
    params(FramePath),
    responses((status = 200, description = "The frame.", body = v1::FrameRecord), Refusals))]
pub(super) async fn get_frame(
    State(service): State<Arc<Service>>,
    InPath(path): InPath<FramePath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::FrameRecord>, HttpError> {
    Ok(Json(frame_record(service.frames.get(&path.name()).await?)))
}

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ImageChoice {
    /// `largest`: the image if it is kept, otherwise the thumbnail.
    #[param(inline)]
    size: Size,
}

#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Size {
    #[default]
    Largest,
    Original,
    Thumbnail,
}

impl Parameters for ImageChoice {
    const TAKES: &str = "size=largest, original or thumbnail";
}

/// What a frame looked like, as far as the map keeps it.
///
/// With `If-None-Match` and the `ETag` of an earlier answer, an image that is still the same is not sent again.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}/frames/{sequence}/image", tag = "sessions",
    operation_id = "get_frame_image", params(FramePath, ImageChoice,
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the image that is there already.")),
    responses(
        (status = 200, description = "The image.", headers(("ETag" = String, description = "Hash of the image.")),
            content((ImageFile = "image/jpeg"), (ImageFile = "image/png"))),
        (status = 304, description = "The image is still the one that the caller has."),
        Refusals))]
pub(super) async fn get_frame_image(
    State(service): State<Arc<Service>>,
    InPath(path): InPath<FramePath>,
    InQuery(ImageChoice { size }): InQuery<ImageChoice>,
    headers: HeaderMap,
) -> Result<Response, HttpError> {
    let size = match size {
        Size::Largest => ImageSize::Best,
        Size::Original => ImageSize::Original,
        Size::Thumbnail => ImageSize::Thumbnail,
    };
    let FrameImage { content_type, image } = service.frames.image(&path.name(), size).await?;
    unless_known(&headers, content_type, image).await
}

/// The image, unless the caller says that it is there already.
pub(super) async fn unless_known(
    headers: &HeaderMap,
    content_type: &'static str,
    image: Vec<u8>,
) -> Result<Response, HttpError> {
    let hashed = tokio::task::spawn_blocking(move || (entity_tag(&image), image)).await;
    let (tag, image) = hashed.map_err(ServiceError::internal)?;
    let is_there = is_known(headers, &tag);
    // A map that is deleted and made again can have another image under this name: ask, and be told that
    // it is the same.
    let caching = [(CACHE_CONTROL, "private, no-cache".to_owned()), (ETAG, tag)];
    if is_there {
        return Ok((StatusCode::NOT_MODIFIED, caching).into_response());
    }
    Ok((caching, [(CONTENT_TYPE, content_type)], image).into_response())
}

/// The bytes of an image, for the description alone.
pub(super) enum ImageFile {}

impl PartialSchema for ImageFile {
    fn schema() -> RefOr<Schema> {
        let binary = SchemaFormat::KnownFormat(KnownFormat::Binary);
        ObjectBuilder::new().schema_type(Type::String).format(Some(binary)).into()
    }
}

impl ToSchema for ImageFile {}

/// The name of these very bytes, as `ETag` has it.
pub(super) fn entity_tag(content: &[u8]) -> String {
    use std::fmt::Write;
    let mut tag = String::from("\"");
    for byte in Sha256::digest(content) {
        // Writing to a string cannot fail.
        let _ = write!(tag, "{byte:02x}");
    }
    tag + "\""
}

/// Whether the caller says that it has what `tag` names.
pub(super) fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    headers.get_all(IF_NONE_MATCH).iter().any(|known| names(known.as_bytes(), tag))
}

/// Whether a list of entity tags, as `If-None-Match` has it, names `tag` or all. No tag of ours has a comma.
fn names(list: &[u8], tag: &str) -> bool {
    let mut known = list.split(|&byte| byte == b',').map(<[u8]>::trim_ascii);
    known.any(|known| known == b"*" || known.strip_prefix(b"W/").unwrap_or(known) == tag.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entity_tags_are_found_in_lists() {
        let tag = entity_tag(b"an image");
        assert_eq!(tag.len(), 66);
        for list in [tag.clone(), format!("W/{tag}"), format!("\"a\" , {tag}"), "*".to_owned()] {
            assert!(names(list.as_bytes(), &tag), "{list}");
        }
        for list in ["", "\"a\"", tag.trim_matches('"'), entity_tag(b"another").as_str()] {
            assert!(!names(list.as_bytes(), &tag), "{list}");
        }
    }
}
