//! Errors of the service as `google.rpc.Status`.

use bytes::Bytes;
use prost::Message;
use tonic::Status;
use waypost_proto::google::rpc;

use crate::error::ServiceError;

/// A status as a message, for errors about one frame.
pub(crate) fn as_message(error: &ServiceError) -> rpc::Status {
    let status = Status::from(error.clone());
    // The details of a status are such a message, encoded.
    match rpc::Status::decode(Bytes::copy_from_slice(status.details())) {
        Ok(detailed) if detailed.code != 0 => detailed,
        Ok(_) | Err(_) => rpc::Status {
            code: status.code() as i32,
            message: status.message().to_owned(),
            details: Vec::new(),
        },
    }
}
