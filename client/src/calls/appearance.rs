//! How the places of a map are connected by appearance.

use waypost_proto::v1;

use crate::client::{Client, map_name};
use crate::error::Error;

impl Client {
    /// The appearance graph of a map: which places match each other, and the spaces that they form.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if the map is not navigated by appearance.
    pub async fn appearance_graph(&self, map: &str) -> Result<v1::AppearanceGraph, Error> {
        let request = v1::GetAppearanceGraphRequest { map: map_name(map) };
        self.taken(self.appearance_client().get_appearance_graph(request).await)
    }
}
