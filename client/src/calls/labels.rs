//! Labels: what people call places.

use waypost_proto::v1;

use crate::client::{Call, Client, map_name};
#[cfg(doc)]
use crate::error::Error;

impl Client {
    /// All places of a map that have a label, by number.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn labels<'a>(&'a self, map: &'a str) -> Call<'a, Vec<v1::PlaceLabel>> {
        Box::pin(async move {
            self.all_pages(|page_token| {
                let mut service = self.labels_client();
                let request = v1::ListLabelsRequest { map: map_name(map), page_size: 0, page_token };
                async move {
                    let page = service.list_labels(request).await?.into_inner();
                    Ok((page.labels, page.next_page_token))
                }
            })
            .await
        })
    }

    /// Labels a place (`maps/{map}/places/{number}`) or all places of its room. Returns all labels
    /// that it set.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, INVALID_ARGUMENT for an invalid label, FAILED_PRECONDITION for
    /// a space of a map that is not navigated by appearance.
    pub fn set_label<'a>(
        &'a self,
        place: &'a str,
        label: &'a str,
        scope: v1::LabelScope,
    ) -> Call<'a, Vec<v1::PlaceLabel>> {
        Box::pin(async move {
            let place = place.to_owned();
            let label = label.to_owned();
            let request = v1::SetLabelRequest { place, label, scope: scope.into() };
            Ok(self.taken(self.labels_client().set_label(request).await)?.labels)
        })
    }

    /// Deletes the label of a place (`maps/{map}/places/{number}`).
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND if it has none.
    pub fn delete_label<'a>(&'a self, place: &'a str) -> Call<'a, ()> {
        Box::pin(async move {
            let request = v1::DeleteLabelRequest { place: place.to_owned() };
            self.taken(self.labels_client().delete_label(request).await).map(drop)
        })
    }
}
