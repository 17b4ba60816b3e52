//! What a request brings in its body. Whatever does not fit is refused in our form of an error.

use axum::Json;
use axum::body::Bytes;
use axum::extract::{FromRequest, Request};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::de::DeserializeOwned;

use super::{HttpError, MAX_BODY_BYTES, error_response};
use crate::error::ServiceError;

/// What a route takes as JSON.
pub(super) trait JsonBody: DeserializeOwned {
    /// What to send, for those who sent something else.
    const TAKES: &str;
}

/// A body of JSON.
#[derive(Debug)]
pub(super) struct InBody<T>(pub(super) T);

impl<S: Send + Sync, T: JsonBody> FromRequest<S> for InBody<T> {
    type Rejection = Unfit;

    async fn from_request(request: Request, state: &S) -> Result<Self, Self::Rejection> {
        let Json(body) = Json::from_request(request, state).await.map_err(|rejection| {
            let takes = format_args!("send {} as application/json", T::TAKES);
            Unfit::of(rejection.status(), &rejection.body_text(), takes)
        })?;
        Ok(Self(body))
    }
}

/// A body of any kind.
#[derive(Debug)]
pub(super) struct WholeBody(pub(super) Bytes);

impl<S: Send + Sync> FromRequest<S> for WholeBody {
    type Rejection = Unfit;

    async fn from_request(request: Request, state: &S) -> Result<Self, Self::Rejection> {
        let body = Bytes::from_request(request, state).await.map_err(|rejection| {
            Unfit::of(rejection.status(), &rejection.body_text(), format_args!("send the whole body"))
        })?;
        Ok(Self(body))
    }
}

/// Why a body was not taken.
#[derive(Debug)]
pub(super) enum Unfit {
    TooLarge,
    Wrong(ServiceError),
}

impl Unfit {
    fn of(status: StatusCode, why: &str, takes: std::fmt::Arguments<'_>) -> Self {
        match status {
            StatusCode::PAYLOAD_TOO_LARGE => Self::TooLarge,
            _ => Self::Wrong(ServiceError::invalid(format_args!("{why}; {takes}"))),
        }
    }
}

impl IntoResponse for Unfit {
    fn into_response(self) -> Response {
        match self {
            Self::TooLarge => {
                let message = format!("a body has at most {MAX_BODY_BYTES} bytes here; send less");
                error_response(StatusCode::PAYLOAD_TOO_LARGE, "payload_too_large", message)
            }
            Self::Wrong(error) => HttpError(error).into_response(),
        }
    }
}
