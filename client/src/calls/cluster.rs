//! The servers of a database.

use waypost_proto::v1;

use crate::client::Client;
use crate::error::Error;

impl Client {
    /// The servers of the database, and how they and it do. For administrators of the whole server.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub async fn cluster(&self) -> Result<v1::Cluster, Error> {
        self.taken(self.cluster_client().get_cluster(v1::GetClusterRequest {}).await)
    }
}
