//! The servers of a database.

use waypost_proto::v1;

use crate::client::{Call, Client};
#[cfg(doc)]
use crate::error::Error;

impl Client {
    /// The servers of the database, and how they and it do. For administrators of the whole server.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub fn cluster(&self) -> Call<'_, v1::Cluster> {
        Box::pin(async move { self.taken(self.cluster_client().get_cluster(v1::GetClusterRequest {}).await) })
    }
}
