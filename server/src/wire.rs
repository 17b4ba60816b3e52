//! The service's values as messages of the contract, and back. gRPC sends the messages, REST their
//! JSON. Every field is named, so that none is forgotten.

pub(crate) mod cluster;
pub(crate) mod corrections;
pub(crate) mod events;
pub(crate) mod geometry;
pub(crate) mod jobs;
pub(crate) mod maps;
pub(crate) mod match_matrix;
pub(crate) mod merges;
pub(crate) mod models;
pub(crate) mod navigations;
pub(crate) mod places;
pub(crate) mod recognition;
pub(crate) mod references;
pub(crate) mod sessions;
pub(crate) mod settings;
pub(crate) mod status;
pub(crate) mod tokens;

use crate::error::ServiceError;

/// An enum's value, unless it is one that this server does not know.
pub(crate) fn known<E: TryFrom<i32>>(field: &str, value: i32) -> Result<E, ServiceError> {
    E::try_from(value).map_err(|_| {
        ServiceError::invalid(format_args!("{field} has the value {value}, which this server does not know"))
    })
}
