//! How the places of a map are connected by appearance.

use waypost_proto::v1;

use crate::client::{Call, Client, map_name};
#[cfg(doc)]
use crate::error::Error;

impl Client {
    /// The appearance graph of a map: which places match each other, and the spaces that they form.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if the map is not navigated by appearance.
    pub fn appearance_graph<'a>(&'a self, map: &'a str) -> Call<'a, v1::AppearanceGraph> {
        Box::pin(async move {
            let request = v1::GetAppearanceGraphRequest { map: map_name(map) };
            self.taken(self.appearance_client().get_appearance_graph(request).await)
        })
    }
}
