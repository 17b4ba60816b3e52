//! Errors of the service as gRPC statuses.

use tonic::{Code, Status};
use waypost_proto::google::rpc;

use crate::error::ServiceError;

impl From<ServiceError> for Status {
    fn from(error: ServiceError) -> Self {
        Status::new(code(&error), error.to_string())
    }
}

/// A status as a message, for errors about one frame.
pub(super) fn as_message(error: &ServiceError) -> rpc::Status {
    rpc::Status { code: code(error) as i32, message: error.to_string(), details: Vec::new() }
}

fn code(error: &ServiceError) -> Code {
    match error {
        ServiceError::InvalidArgument { .. } => Code::InvalidArgument,
        ServiceError::NotFound { .. } => Code::NotFound,
        ServiceError::AlreadyExists { .. } => Code::AlreadyExists,
        ServiceError::FailedPrecondition { .. } => Code::FailedPrecondition,
        ServiceError::Aborted { .. } => Code::Aborted,
        ServiceError::ResourceExhausted { .. } => Code::ResourceExhausted,
        ServiceError::Unavailable { .. } => Code::Unavailable,
        ServiceError::Internal => Code::Internal,
    }
}
