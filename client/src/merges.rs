//! Calls that make maps of maps.

use waypost_proto::v1;
use waypost_proto::v1::merge_service_client::MergeServiceClient;

use crate::client::{Client, MAX_ANSWER_BYTES, PAGE_SIZE, Transport, map_name};
use crate::error::Error;

impl Client {
    /// Begins to look for maps on each other; the job that does so is named in the answer, see
    /// [`watch_job`](Self::watch_job).
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND or INVALID_ARGUMENT (the maps), FAILED_PRECONDITION (models of different words).
    pub async fn merge_maps(&self, request: v1::MergeMapsRequest) -> Result<v1::Merge, Error> {
        self.taken(self.merges_client().merge_maps(request).await)
    }

    /// A merge (`merges/{number}`) as it is now.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn merge(&self, name: &str) -> Result<v1::Merge, Error> {
        self.taken(self.merges_client().get_merge(v1::GetMergeRequest { name: name.to_owned() }).await)
    }

    /// All merges, newest first.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub async fn merges(&self) -> Result<Vec<v1::Merge>, Error> {
        self.all_pages(|page_token| async move {
            let request = v1::ListMergesRequest { page_size: PAGE_SIZE, page_token };
            let page = self.merges_client().list_merges(request).await?.into_inner();
            Ok((page.merges, page.next_page_token))
        })
        .await
    }

    /// The maps of a merge before and after, as SVG.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION if the maps were not looked at to the end.
    pub async fn merge_picture(&self, name: &str) -> Result<Vec<u8>, Error> {
        let request = v1::GetMergePictureRequest { name: name.to_owned() };
        Ok(self.taken(self.merges_client().get_merge_picture(request).await)?.svg)
    }

    /// Makes maps one as was proposed; the job that does so is named in the answer.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION if it is no proposal.
    pub async fn commit_merge(&self, name: &str) -> Result<v1::Merge, Error> {
        let request = v1::CommitMergeRequest { name: name.to_owned() };
        self.taken(self.merges_client().commit_merge(request).await)
    }

    /// Leaves maps as they are.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION if it is no proposal.
    pub async fn discard_merge(&self, name: &str) -> Result<v1::Merge, Error> {
        let request = v1::DiscardMergeRequest { name: name.to_owned() };
        self.taken(self.merges_client().discard_merge(request).await)
    }

    /// Takes what a merge has brought out of its target again; the job that does so is named in the answer.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION if it was not committed, or a robot is led through the
    /// map.
    pub async fn undo_merge(&self, name: &str) -> Result<v1::Merge, Error> {
        let request = v1::UndoMergeRequest { name: name.to_owned() };
        self.taken(self.merges_client().undo_merge(request).await)
    }

    /// Takes a session (`maps/{map}/sessions/{session}`) out of its map; the job that comes back does so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION if a robot is led through the map.
    pub async fn remove_session(&self, name: &str) -> Result<v1::Job, Error> {
        let request = v1::RemoveSessionRequest { name: name.to_owned() };
        self.taken(self.maps_client().remove_session(request).await)
    }

    /// Makes what a map holds now its new beginning, and wipes from the disk what was removed; the job that comes back does
    /// so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn compact_map(&self, map: &str) -> Result<v1::Job, Error> {
        self.taken(self.maps_client().compact_map(v1::CompactMapRequest { name: map_name(map) }).await)
    }

    /// Says which places a map can do without to have no more than `max_places`, and drops them if asked to.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or FAILED_PRECONDITION if a robot is led through the map.
    pub async fn trim_map(&self, request: v1::TrimMapRequest) -> Result<v1::TrimMapResponse, Error> {
        self.taken(self.maps_client().trim_map(request).await)
    }

    /// Makes a new map of what a map keeps of its frames, with a model of other words; the job that comes back does so.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, ALREADY_EXISTS, or FAILED_PRECONDITION if the map does not keep what it takes.
    pub async fn rebuild_map(&self, map: &str, model: &str, into: &str) -> Result<v1::Job, Error> {
        let (name, map_id) = (map_name(map), into.strip_prefix("maps/").unwrap_or(into).to_owned());
        let request = v1::RebuildMapRequest { name, model: model.to_owned(), map_id };
        self.taken(self.maps_client().rebuild_map(request).await)
    }

    fn merges_client(&self) -> MergeServiceClient<Transport> {
        MergeServiceClient::new(self.transport()).max_decoding_message_size(MAX_ANSWER_BYTES)
    }
}
