use std::sync::Arc;

use axum::Extension;
use axum::extract::State;
use axum::http::header::CONTENT_SECURITY_POLICY;
use axum::http::{HeaderMap, HeaderValue};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::IntoParams;

use super::HttpError;
use super::description::Refusals;
use super::frames::{ImageFile, unless_known};
use super::parameters::{FramePath, InPath, InQuery, Parameters};
use crate::error::ServiceError;
use crate::service::Service;
use crate::service::pictures::{Beside, FramePicture};
use crate::service::tokens::Caller;

/// The images within a picture are all that it loads.
const IMAGES_WITHIN: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; \
     frame-ancestors 'none'",
);

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PictureQuery {
    /// Number of the place whose frame is shown beside it: the one that was compared, or else the one of its latest
    /// 100 with the most words in common. Left out, the place that was, or could have been, matched.
    place_number: Option<u32>,
    /// `maps/{map}/sessions/{session}/frames/{sequence}`: the frame that is shown beside it, in place of one of a place.
    /// It may be of another map with the same model.
    beside_frame: String,
    /// Words that were expected and not seen, as `words_against` of an explanation has them, as in `17,4,230`: squares mark
    /// where the frame beside shows them. At most 100.
    #[param(pattern = "^[0-9]+(,[0-9]+)*$")]
    expected_words: String,
}

impl Parameters for PictureQuery {
    const TAKES: &str = "place_number=NUMBER or beside_frame=FRAME, and expected_words=NUMBER,NUMBER";
}

impl PictureQuery {
    fn expected_words(&self) -> Result<Vec<u32>, ServiceError> {
        let given = self.expected_words.as_str();
        let numbers = given.split(',').filter(|_| !given.is_empty()).map(str::parse);
        numbers.collect::<Result<_, _>>().map_err(|_| {
            ServiceError::invalid(format_args!(
                "expected_words is {given:?}; send numbers of words with commas between them, as in 17,4,230"
            ))
        })
    }
}

/// A frame beside an earlier one, or any other, with what they have in common.
///
/// Features are green whose word both frames show, or that one motion joins, and red otherwise. The picture refers to
/// nothing outside: the images are within. One that is not kept is shown as a thumbnail, or as a grey rectangle.
#[utoipa::path(get, path = "/v1/maps/{map}/sessions/{session}/frames/{sequence}/picture", tag = "sessions",
    params(FramePath, PictureQuery,
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the picture that is there already.")),
    responses(
        (status = 200, description = "The picture.", headers(("ETag" = String, description = "Hash of the picture.")),
            content((ImageFile = "image/svg+xml"))),
        (status = 304, description = "The picture is still the one that the caller has."),
        Refusals))]
pub(super) async fn get_frame_picture(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InPath(path): InPath<FramePath>,
    InQuery(query): InQuery<PictureQuery>,
    headers: HeaderMap,
) -> Result<Response, HttpError> {
    let expected_words = query.expected_words()?;
    caller.check_resource(&query.beside_frame)?;
    let beside = Beside::asked(query.place_number, query.beside_frame)?;
    let FramePicture { content_type, picture } =
        service.pictures.frame(&path.name(), beside, &expected_words).await?;
    let response = unless_known(&headers, content_type, picture).await?;
    Ok(([(CONTENT_SECURITY_POLICY, IMAGES_WITHIN)], response).into_response())
}
