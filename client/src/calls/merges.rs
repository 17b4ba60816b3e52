//! Merges of maps.

use waypost_proto::v1;

use crate::client::{Call, Client, PAGE_SIZE};
#[cfg(doc)]
use crate::error::Error;

impl Client {
    /// Starts to look for overlaps between maps. The answer names the job that does so; see
    /// [`watch_job`](Self::watch_job).
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND or INVALID_ARGUMENT (the maps), FAILED_PRECONDITION (models
    /// of different words).
    pub fn merge_maps(&self, request: v1::MergeMapsRequest) -> Call<'_, v1::Merge> {
        Box::pin(async move { self.taken(self.merges_client().merge_maps(request).await) })
    }

    /// A merge (`merges/{number}`) as it is now.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn merge<'a>(&'a self, name: &'a str) -> Call<'a, v1::Merge> {
        Box::pin(async move {
            self.taken(self.merges_client().get_merge(v1::GetMergeRequest { name: name.to_owned() }).await)
        })
    }

    /// All merges, newest first.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub fn merges(&self) -> Call<'_, Vec<v1::Merge>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let request = v1::ListMergesRequest { page_size: PAGE_SIZE, page_token };
                let page = self.merges_client().list_merges(request).await?.into_inner();
                Ok((page.merges, page.next_page_token))
            })
            .await
        })
    }

    /// The maps of a merge before and after, as SVG.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION if the search did not finish.
    pub fn merge_picture<'a>(&'a self, name: &'a str) -> Call<'a, Vec<u8>> {
        Box::pin(async move {
            let request = v1::GetMergePictureRequest { name: name.to_owned() };
            Ok(self.taken(self.merges_client().get_merge_picture(request).await)?.picture)
        })
    }

    /// Merges the maps as proposed. The answer names the job that does so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION if it is no proposal.
    pub fn commit_merge<'a>(&'a self, name: &'a str) -> Call<'a, v1::Merge> {
        Box::pin(async move {
            let request = v1::CommitMergeRequest { name: name.to_owned() };
            self.taken(self.merges_client().commit_merge(request).await)
        })
    }

    /// Drops a proposal; the maps stay as they are.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION if it is no proposal.
    pub fn discard_merge<'a>(&'a self, name: &'a str) -> Call<'a, v1::Merge> {
        Box::pin(async move {
            let request = v1::DiscardMergeRequest { name: name.to_owned() };
            self.taken(self.merges_client().discard_merge(request).await)
        })
    }

    /// Removes from its target what a merge has added. The answer names the job that does so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION if it was not committed or a robot
    /// navigates in the map.
    pub fn undo_merge<'a>(&'a self, name: &'a str) -> Call<'a, v1::Merge> {
        Box::pin(async move {
            let request = v1::UndoMergeRequest { name: name.to_owned() };
            self.taken(self.merges_client().undo_merge(request).await)
        })
    }
}
