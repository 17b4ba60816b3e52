//! Errors of the service as gRPC statuses.

use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use crate::error::ServiceError;

impl From<ServiceError> for Status {
    fn from(error: ServiceError) -> Self {
        let code = code(&error);
        let message = fitting(error.to_string());
        match error.retry_after() {
            Some(retry_after) => {
                Status::with_error_details(code, message, ErrorDetails::with_retry_info(Some(retry_after)))
            }
            None => Status::new(code, message),
        }
    }
}

/// A message that may quote what was sent, made to fit into a header: one that is endless would break the
/// connection. Its end, which says how to mend it, stays.
fn fitting(message: String) -> String {
    const HEAD_CHARS: usize = 200;
    const TAIL_CHARS: usize = 600;
    let chars = message.chars().count();
    if chars <= HEAD_CHARS + TAIL_CHARS {
        return message;
    }
    let head: String = message.chars().take(HEAD_CHARS).collect();
    let tail: String = message.chars().skip(chars - TAIL_CHARS).collect();
    format!("{head} […] {tail}")
}

fn code(error: &ServiceError) -> Code {
    match error {
        ServiceError::InvalidArgument { .. } => Code::InvalidArgument,
        ServiceError::NotFound { .. } => Code::NotFound,
        ServiceError::AlreadyExists { .. } => Code::AlreadyExists,
        ServiceError::FailedPrecondition { .. } => Code::FailedPrecondition,
        ServiceError::Aborted { .. } => Code::Aborted,
        ServiceError::ResourceExhausted { .. } | ServiceError::QuotaUsedUp { .. } => Code::ResourceExhausted,
        ServiceError::Unavailable { .. } => Code::Unavailable,
        ServiceError::Unauthenticated { .. } => Code::Unauthenticated,
        ServiceError::PermissionDenied { .. } => Code::PermissionDenied,
        ServiceError::DeadlineExceeded { .. } => Code::DeadlineExceeded,
        ServiceError::DataLoss { .. } => Code::DataLoss,
        ServiceError::Internal => Code::Internal,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endless_message_keeps_its_beginning_and_its_end() {
        let usual = "there is no map drive; list the maps".to_owned();
        assert_eq!(fitting(usual.clone()), usual);
        let endless = format!("{:?} is no map name; use 1 to 63 of a-z", "ä".repeat(100_000));
        let fitted = fitting(endless);
        assert!(fitted.starts_with("\"ää") && fitted.ends_with("ä\" is no map name; use 1 to 63 of a-z"));
        assert!(fitted.chars().count() < 1000);
    }
}
