//! What a request asks for, read out of its path and query. Whatever does not fit is refused in our
//! form of an error.

use axum::extract::{FromRequestParts, Path, Query};
use axum::http::request::Parts;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use utoipa::IntoParams;

use super::HttpError;
use crate::error::ServiceError;

/// The variable parts of a path.
#[derive(Debug)]
pub(super) struct InPath<T>(pub(super) T);

impl<S: Send + Sync, T: DeserializeOwned + Send> FromRequestParts<S> for InPath<T> {
    type Rejection = HttpError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Self::Rejection> {
        let path = Path::from_request_parts(parts, state).await.map_err(|rejection| {
            ServiceError::invalid(format_args!(
                "{}; write names as the lists have them, numbers as digits, and the rest as percent-encoded UTF-8",
                rejection.body_text()
            ))
        })?;
        let Path(path) = path;
        Ok(Self(path))
    }
}

/// What may stand behind the question mark of a route.
pub(super) trait Parameters: DeserializeOwned {
    /// All of it, for those who wrote something else.
    const TAKES: &str;
}

/// What stands behind the question mark.
#[derive(Debug)]
pub(super) struct InQuery<T>(pub(super) T);

impl<S: Send + Sync, T: Parameters> FromRequestParts<S> for InQuery<T> {
    type Rejection = HttpError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Self::Rejection> {
        let query = Query::from_request_parts(parts, state).await.map_err(|rejection| {
            ServiceError::invalid(format_args!("{}; this route takes {}", rejection.body_text(), T::TAKES))
        })?;
        let Query(query) = query;
        Ok(Self(query))
    }
}

/// Nothing.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Nothing {}

impl Parameters for Nothing {
    const TAKES: &str = "no parameters";
}

#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Paging {
    /// Most entries in one answer; 0 asks for the default.
    #[param(minimum = 0, maximum = 1000, default = 100, example = 100)]
    pub(super) page_size: u32,
    /// `next_page_token` of the page before. Left out, the first page comes.
    pub(super) page_token: String,
}

impl Parameters for Paging {
    const TAKES: &str = "page_size=NUMBER and page_token=TOKEN";
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct MapPath {
    /// Name of the map.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "demo")]
    pub(super) map: String,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct TilePath {
    /// Name of the map.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "demo")]
    pub(super) map: String,
    /// Zoom level.
    #[param(example = 0)]
    pub(super) level: u32,
    /// Which tile from above, from 0.
    #[param(example = 0)]
    pub(super) row: u32,
    /// Which tile from the left, from 0.
    #[param(example = 0)]
    pub(super) column: u32,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct PlacePath {
    /// Name of the map.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "demo")]
    pub(super) map: String,
    /// Number of the place; places are numbered from 0.
    #[param(value_type = u32, example = 0)]
    pub(super) place: String,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct WordPath {
    /// Name of the map.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "demo")]
    pub(super) map: String,
    /// Number of the word, below the size of the vocabulary.
    #[param(example = 17)]
    pub(super) word: u32,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct SessionPath {
    /// Name of the map.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "demo")]
    pub(super) map: String,
    /// Name of the session.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "monday")]
    pub(super) session: String,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct CorrectionPath {
    /// Name of the map.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "demo")]
    pub(super) map: String,
    /// Number of the correction.
    #[param(value_type = u64)]
    pub(super) correction: String,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct NavigationPath {
    /// Name of the map.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "demo")]
    pub(super) map: String,
    /// Name of the robot.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "robot-7")]
    pub(super) navigation: String,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct FramePath {
    /// Name of the map.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "demo")]
    pub(super) map: String,
    /// Name of the session.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "monday")]
    pub(super) session: String,
    /// Sequence number of the frame within its session.
    #[param(value_type = u64, example = 1)]
    pub(super) sequence: String,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct ModelPath {
    /// Hash of the model. An unambiguous beginning of at least 6 digits, or a display name that only one
    /// model has, will do.
    #[param(example = "site")]
    pub(super) model: String,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct JobPath {
    /// Number of the job.
    #[param(value_type = u64)]
    pub(super) job: String,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct MergePath {
    /// Number of the merge.
    #[param(value_type = u64)]
    pub(super) merge: String,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub(super) struct TokenPath {
    /// Name of the token.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,62}$", example = "robot-7")]
    pub(super) token: String,
}
