//! The wire contract: messages and services of `waypost.v1`, generated from the `.proto` files
//! beside this crate. No conversions: those live with the adapters that need them.
#![allow(missing_docs, unreachable_pub, clippy::all, clippy::pedantic, clippy::restriction)]

pub use json::status_code_name;
pub use waypost::v1;

#[cfg(feature = "clap")]
pub mod flags;
mod json;
#[cfg(feature = "openapi")]
mod openapi;

/// The package `waypost`.
pub mod waypost {
    /// Messages, clients and servers of version 1.
    pub mod v1 {
        tonic::include_proto!("waypost.v1");
    }
}

/// The package `google`.
pub mod google {
    /// A status as a message.
    pub mod rpc {
        tonic::include_proto!("google.rpc");
    }
}

/// All file descriptors, for gRPC reflection.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
