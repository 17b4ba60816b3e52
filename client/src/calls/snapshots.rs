//! Maps as files: snapshots, and poses as text.

use futures::{StreamExt, TryStreamExt};
use tokio::io::{AsyncRead, AsyncWrite};
use waypost_proto::v1;

use super::transfer::{chunks, download, upload};
use crate::client::{Client, MAX_REQUEST_BYTES, map_name};
use crate::error::Error;

impl Client {
    /// Writes a snapshot of a map with its model; returns its length in bytes. Robots may stream
    /// into the map meanwhile.
    ///
    /// # Errors
    /// [`Error::Write`] if it cannot be written; [`Error::Status`] with NOT_FOUND, with
    /// RESOURCE_EXHAUSTED during too many other exports, with ABORTED if nothing was received for
    /// two minutes.
    pub async fn export_map(&self, name: &str, file: &mut (impl AsyncWrite + Unpin)) -> Result<u64, Error> {
        let request = v1::ExportMapRequest { name: map_name(name) };
        let response = self.maps_client().export_map(request).await;
        download(self, response, |v1::ExportMapResponse { chunk }| chunk, file).await
    }

    /// Writes poses as text: a session's trajectory (TUM, KITTI) or a map's pose graph (g2o).
    /// Returns the length in bytes.
    ///
    /// # Errors
    /// [`Error::Write`] if it cannot be written; [`Error::Status`] with NOT_FOUND, with
    /// FAILED_PRECONDITION if there are no such poses.
    pub async fn export_poses(
        &self,
        request: v1::ExportPosesRequest,
        file: &mut (impl AsyncWrite + Unpin),
    ) -> Result<u64, Error> {
        let response = self.maps_client().export_poses(request).await;
        download(self, response, |v1::ExportPosesResponse { chunk }| chunk, file).await
    }

    /// Uploads a snapshot as a new map; with an empty name, under the name in the file. Returns the
    /// job that checks and stores it; see [`watch_job`](Self::watch_job).
    ///
    /// # Errors
    /// [`Error::Read`] if the file cannot be read; [`Error::Status`] with ALREADY_EXISTS if a map
    /// has that name, with INVALID_ARGUMENT if the file is no snapshot.
    pub async fn import_map(
        &self,
        map_id: &str,
        file: impl AsyncRead + Send + Unpin + 'static,
    ) -> Result<v1::Job, Error> {
        let map_id = map_id.strip_prefix("maps/").unwrap_or(map_id);
        let map_id = (!map_id.is_empty()).then(|| map_id.to_owned());
        // This message is sent even for an empty file, which the server then refuses.
        let named = futures::stream::once(async { Ok(v1::ImportMapRequest { map_id, chunk: Vec::new() }) });
        let requests = named.chain(chunks(file).map_ok(|chunk| v1::ImportMapRequest { map_id: None, chunk }));
        let mut maps = self.maps_client();
        let unsendable = || v1::ImportMapRequest { map_id: None, chunk: vec![0; MAX_REQUEST_BYTES] };
        let call = |requests| async move { maps.import_map(requests).await };
        upload(requests, unsendable, self.endpoint(), call).await
    }
}
