//! Connections, and what is known of them before anything is asked.

pub(crate) mod calls;
mod complaint;
pub(crate) mod connections;
pub(crate) mod messages;
pub(crate) mod neighbours;
pub(crate) mod origin;
pub(crate) mod peer;
pub(crate) mod request_id;
pub(crate) mod standing;
pub(crate) mod tls;
