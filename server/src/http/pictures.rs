use std::sync::Arc;

use axum::extract::State;
use axum::http::header::CONTENT_SECURITY_POLICY;
use axum::http::{HeaderMap, HeaderValue};
use axum::response::{IntoResponse, Response};
use fabmap::PlaceId;
use serde::Deserialize;
use utoipa::IntoParams;

use super::HttpError;
use super::description::Refusals;
use super::frames::{ImageFile, unless_known};
use super::parameters::{FramePath, InPath, InQuery, Parameters};
use crate::service::Service;
use crate::service::pictures::FramePicture;

/// The images within a picture are all that it loads.
const IMAGES_WITHIN: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; \
     frame-ancestors 'none'",
);

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Beside {
    /// Number of the place whose frame is shown beside it: the one that was compared, or else the one of its latest
    /// 100 with the most words in common. Left out, the place that was, or could have been, matched.
    place_number: Option<u32>,
}

impl Parameters for Beside {
    const TAKES: &str = "place_number=NUMBER";
}

/// A frame beside an earlier one, with what they have in common.
///
/// Features are green whose word both frames show, or that one motion joins, and red otherwise. The picture refers to
/// nothing outside: the images are within. One that is not kept is shown as a thumbnail, or as a grey rectangle.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}/frames/{sequence}/picture", tag = "sessions",
    params(FramePath, Beside,
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the picture that is there already.")),
    responses(
        (status = 200, description = "The picture.", headers(("ETag" = String, description = "Hash of the picture.")),
            content((ImageFile = "image/svg+xml"))),
        (status = 304, description = "The picture is still the one that the caller has."),
        Refusals))]
pub(super) async fn get_frame_picture(
    State(service): State<Arc<Service>>,
    InPath(path): InPath<FramePath>,
    InQuery(Beside { place_number }): InQuery<Beside>,
    headers: HeaderMap,
) -> Result<Response, HttpError> {
    let FramePicture { content_type, picture } =
        service.pictures.frame(&path.name(), place_number.map(PlaceId::new)).await?;
    let response = unless_known(&headers, content_type, picture).await?;
    Ok(([(CONTENT_SECURITY_POLICY, IMAGES_WITHIN)], response).into_response())
}
