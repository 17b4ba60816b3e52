//! Messages as JSON, the same for REST and the command line.

use serde::de::Error;
use serde::ser::{Serialize, SerializeStruct, Serializer};

include!(concat!(env!("OUT_DIR"), "/json.rs"));

/// The name of an enum's value; `None` if it was left open or is of a later contract.
fn shown<E: TryFrom<i32>>(value: i32, name: fn(E) -> &'static str) -> Option<&'static str> {
    if value == 0 { None } else { E::try_from(value).ok().map(name) }
}

/// The names of an enum's values, without those of a later contract.
fn shown_each<E: TryFrom<i32>>(values: &[i32], name: fn(E) -> &'static str) -> Vec<&'static str> {
    values.iter().filter_map(|value| shown(*value, name)).collect()
}

/// The number of the enum's value that has this name; 0 if none is given.
fn named<V: Into<i32>, E: Error>(
    name: Option<String>,
    value: fn(&str) -> Option<V>,
    names: &'static [&'static str],
) -> Result<i32, E> {
    let Some(name) = name else { return Ok(0) };
    value(&name).map(Into::into).ok_or_else(|| E::unknown_variant(&name, names))
}

impl Serialize for crate::google::rpc::Status {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut object = serializer.serialize_struct("Status", 2)?;
        object.serialize_field("code", status_code_name(self.code))?;
        object.serialize_field("message", &self.message)?;
        object.end()
    }
}

/// The name of a gRPC status code, as in `not_found`.
pub fn status_code_name(code: i32) -> &'static str {
    match code {
        0 => "ok",
        1 => "cancelled",
        3 => "invalid_argument",
        4 => "deadline_exceeded",
        5 => "not_found",
        6 => "already_exists",
        7 => "permission_denied",
        8 => "resource_exhausted",
        9 => "failed_precondition",
        10 => "aborted",
        11 => "out_of_range",
        12 => "unimplemented",
        13 => "internal",
        14 => "unavailable",
        15 => "data_loss",
        16 => "unauthenticated",
        _ => "unknown",
    }
}
