//! What places are called, and how they hang together by appearance.

use waypost_proto::v1;

use crate::client::{Client, map_name};
use crate::error::Error;

impl Client {
    /// All places of a map that have a label, by number.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn labels(&self, map: &str) -> Result<Vec<v1::PlaceLabel>, Error> {
        self.all_pages(|page_token| {
            let mut service = self.appearance_client();
            let request = v1::ListLabelsRequest { map: map_name(map), page_size: 0, page_token };
            async move {
                let page = service.list_labels(request).await?.into_inner();
                Ok((page.labels, page.next_page_token))
            }
        })
        .await
    }

    /// Puts a label on a place, `maps/{map}/places/{number}`, or on all places of its space; which ones.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, INVALID_ARGUMENT for what is no label, FAILED_PRECONDITION for a space of a map that
    /// is not navigated by appearance.
    pub async fn set_label(
        &self,
        place: &str,
        label: &str,
        reach: v1::LabelReach,
    ) -> Result<Vec<v1::PlaceLabel>, Error> {
        let (place, label) = (place.to_owned(), label.to_owned());
        let request = v1::SetLabelRequest { place, label, reach: reach.into() };
        Ok(self.taken(self.appearance_client().set_label(request).await)?.labels)
    }

    /// Takes the label of a place, `maps/{map}/places/{number}`, away.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND if it has none.
    pub async fn delete_label(&self, place: &str) -> Result<(), Error> {
        let request = v1::DeleteLabelRequest { place: place.to_owned() };
        self.taken(self.appearance_client().delete_label(request).await).map(drop)
    }

    /// Which places of a map can be matched from which, and the spaces that they form.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if the map is not navigated by appearance.
    pub async fn appearance_graph(&self, map: &str) -> Result<v1::AppearanceGraph, Error> {
        let request = v1::GetAppearanceGraphRequest { map: map_name(map) };
        self.taken(self.appearance_client().get_appearance_graph(request).await)
    }
}
