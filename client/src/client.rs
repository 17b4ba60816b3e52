//! Calls about models, jobs and maps, and the connection they share with sessions.

use std::io;
use std::time::Duration;

use futures::{Stream, StreamExt, TryStreamExt};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tonic::transport::{Channel, Endpoint};
use tonic::{Response, Status, Streaming};
use waypost_proto::v1;
use waypost_proto::v1::job_service_client::JobServiceClient;
use waypost_proto::v1::map_service_client::MapServiceClient;
use waypost_proto::v1::model_service_client::ModelServiceClient;
use waypost_proto::v1::session_service_client::SessionServiceClient;
use waypost_proto::v1::train_model_request::Content;

use crate::MAX_IMAGE_BYTES;
use crate::error::{Error, innermost};
use crate::session::{Session, SessionOptions};
use crate::upload::upload;

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// A peer that vanished without a word is noticed after the interval and the timeout.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(10);
const KEEP_ALIVE_TIMEOUT: Duration = Duration::from_secs(10);
/// An image, and 64 KiB for all else.
const MAX_REQUEST_BYTES: usize = MAX_IMAGE_BYTES + (64 << 10);
/// A page of places is the longest answer: 100 places with 100 frames each, about 2 MiB.
const MAX_ANSWER_BYTES: usize = 16 << 20;
const PAGE_SIZE: u32 = 100;
const CHUNK_BYTES: usize = 1 << 20;

/// A connection to a server. Cheap to clone; clones share the connection, which is made again by
/// itself for the next call when it broke.
#[derive(Clone, Debug)]
pub struct Client {
    channel: Channel,
    endpoint: String,
}

impl Client {
    /// Connects to a server at `http://HOST:PORT`.
    ///
    /// # Errors
    /// [`Error::Endpoint`] if that is no address, [`Error::Connection`] if nobody answers there.
    pub async fn connect(endpoint: &str) -> Result<Self, Error> {
        let channel = configured(endpoint)?.connect().await.map_err(|error| Error::Connection {
            endpoint: endpoint.to_owned(),
            reason: innermost(&error),
        })?;
        Ok(Self { channel, endpoint: endpoint.to_owned() })
    }

    /// A client that connects with its first call: for robots that may boot before the server does.
    /// Call from within a Tokio runtime.
    ///
    /// # Errors
    /// [`Error::Endpoint`] if that is no address.
    pub fn lazy(endpoint: &str) -> Result<Self, Error> {
        Ok(Self { channel: configured(endpoint)?.connect_lazy(), endpoint: endpoint.to_owned() })
    }

    /// Opens a session, or resumes the one of that name. Waits for an unreachable server as long as
    /// the session would later on.
    ///
    /// # Errors
    /// [`Error::Status`] if the server refuses, [`Error::SessionLost`] if it could not be reached.
    pub async fn open_session(&self, options: SessionOptions) -> Result<Session, Error> {
        Session::open(self.sessions(), options).await
    }

    /// Trains a model from JPEG or PNG images. The job that comes back goes on at the server; see
    /// [`watch_job`](Self::watch_job). To stop the upload, let `images` yield an error; a call that is
    /// just dropped may look complete to the server.
    ///
    /// # Errors
    /// [`Error::Read`] if an image cannot be read: then nothing is trained. [`Error::Status`] if the
    /// server refuses the settings or an image.
    pub async fn train_model(
        &self,
        settings: v1::TrainModelSettings,
        images: impl Stream<Item = io::Result<Vec<u8>>> + Send + 'static,
    ) -> Result<v1::Job, Error> {
        let settings = futures::stream::once(async { Ok(Content::Settings(settings)) });
        let requests = settings
            .chain(images.map_ok(Content::Image))
            .map_ok(|content| v1::TrainModelRequest { content: Some(content) });
        let mut models = self.models_client();
        let unsendable =
            || v1::TrainModelRequest { content: Some(Content::Image(vec![0; MAX_REQUEST_BYTES])) };
        let call = |requests| async move { models.train_model(requests).await };
        upload(requests, unsendable, &self.endpoint, call).await
    }

    /// All models, newest first.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub async fn models(&self) -> Result<Vec<v1::Model>, Error> {
        self.all_pages(async |page_token| {
            let request = v1::ListModelsRequest { page_size: PAGE_SIZE, page_token };
            let page = self.models_client().list_models(request).await?.into_inner();
            Ok((page.models, page.next_page_token))
        })
        .await
    }

    /// The model of a hash, of its beginning, or of a display name that only one model has.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn model(&self, name: &str) -> Result<v1::Model, Error> {
        self.taken(self.models_client().get_model(v1::GetModelRequest { name: name.to_owned() }).await)
    }

    /// Writes a model file; gives its length in bytes.
    ///
    /// # Errors
    /// [`Error::Write`] if it cannot be written, [`Error::Status`] with NOT_FOUND.
    pub async fn export_model(&self, name: &str, file: &mut (impl AsyncWrite + Unpin)) -> Result<u64, Error> {
        let request = v1::ExportModelRequest { name: name.to_owned() };
        let mut chunks = self.taken(self.models_client().export_model(request).await)?;
        let mut length_bytes = 0;
        while let Some(v1::ExportModelResponse { chunk }) = self.met(chunks.message().await)? {
            file.write_all(&chunk).await.map_err(Error::Write)?;
            length_bytes += chunk.len() as u64;
        }
        file.flush().await.map_err(Error::Write)?;
        Ok(length_bytes)
    }

    /// Takes a model file to the server. An empty display name leaves the choice to the server.
    ///
    /// # Errors
    /// [`Error::Read`] if it cannot be read, [`Error::Status`] if it is no model file.
    pub async fn import_model(
        &self,
        display_name: &str,
        file: impl AsyncRead + Send + Unpin + 'static,
    ) -> Result<v1::Model, Error> {
        let display_name = display_name.to_owned();
        let requests = chunks(file)
            .map_ok(move |chunk| v1::ImportModelRequest { display_name: display_name.clone(), chunk });
        let mut models = self.models_client();
        let unsendable =
            || v1::ImportModelRequest { display_name: String::new(), chunk: vec![0; MAX_REQUEST_BYTES] };
        let call = |requests| async move { models.import_model(requests).await };
        upload(requests, unsendable, &self.endpoint, call).await
    }

    /// Deletes a model that no map uses.
    ///
    /// # Errors
    /// [`Error::Status`] with FAILED_PRECONDITION while a map uses it.
    pub async fn delete_model(&self, name: &str) -> Result<(), Error> {
        let request = v1::DeleteModelRequest { name: name.to_owned() };
        let v1::DeleteModelResponse {} = self.taken(self.models_client().delete_model(request).await)?;
        Ok(())
    }

    /// How far a job (`jobs/{number}`) is.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, also after a restart of the server.
    pub async fn job(&self, name: &str) -> Result<v1::Job, Error> {
        self.taken(self.jobs_client().get_job(v1::GetJobRequest { name: name.to_owned() }).await)
    }

    /// Follows a job until it is done.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, also after a restart of the server.
    pub async fn watch_job(&self, name: &str) -> Result<JobProgress, Error> {
        let request = v1::WatchJobRequest { name: name.to_owned() };
        let jobs = self.taken(self.jobs_client().watch_job(request).await)?;
        Ok(JobProgress { jobs, endpoint: self.endpoint.clone() })
    }

    /// Asks a job to stop; it does so at its next step.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn cancel_job(&self, name: &str) -> Result<v1::Job, Error> {
        self.taken(self.jobs_client().cancel_job(v1::CancelJobRequest { name: name.to_owned() }).await)
    }

    /// Creates a map.
    ///
    /// # Errors
    /// [`Error::Status`] with ALREADY_EXISTS, NOT_FOUND (the model) or INVALID_ARGUMENT.
    pub async fn create_map(&self, request: v1::CreateMapRequest) -> Result<v1::Map, Error> {
        self.taken(self.maps_client().create_map(request).await)
    }

    /// All maps, by name.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub async fn maps(&self) -> Result<Vec<v1::Map>, Error> {
        self.all_pages(async |page_token| {
            let request = v1::ListMapsRequest { page_size: PAGE_SIZE, page_token };
            let page = self.maps_client().list_maps(request).await?.into_inner();
            Ok((page.maps, page.next_page_token))
        })
        .await
    }

    /// A map, by `name` or `maps/name`.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn map(&self, name: &str, view: v1::MapView) -> Result<v1::Map, Error> {
        let request = v1::GetMapRequest { name: map_name(name), view: view.into() };
        self.taken(self.maps_client().get_map(request).await)
    }

    /// Deletes a map with all its sessions.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn delete_map(&self, name: &str) -> Result<(), Error> {
        let request = v1::DeleteMapRequest { name: map_name(name) };
        let v1::DeleteMapResponse {} = self.taken(self.maps_client().delete_map(request).await)?;
        Ok(())
    }

    /// All places of a map, oldest first.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn places(&self, map: &str) -> Result<Vec<v1::Place>, Error> {
        self.all_pages(async |page_token| {
            let request = v1::ListPlacesRequest { map: map_name(map), page_size: PAGE_SIZE, page_token };
            let page = self.maps_client().list_places(request).await?.into_inner();
            Ok((page.places, page.next_page_token))
        })
        .await
    }

    /// All loop closures of a map, oldest first.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn matches(&self, map: &str) -> Result<Vec<v1::LoopClosure>, Error> {
        self.all_pages(async |page_token| {
            let request = v1::ListMatchesRequest { map: map_name(map), page_size: PAGE_SIZE, page_token };
            let page = self.maps_client().list_matches(request).await?.into_inner();
            Ok((page.matches, page.next_page_token))
        })
        .await
    }

    async fn all_pages<T>(
        &self,
        page: impl AsyncFn(String) -> Result<(Vec<T>, String), Status>,
    ) -> Result<Vec<T>, Error> {
        let mut all = Vec::new();
        let mut page_token = String::new();
        loop {
            let (mut items, next) = self.met(page(page_token).await)?;
            all.append(&mut items);
            if next.is_empty() {
                return Ok(all);
            }
            page_token = next;
        }
    }

    fn taken<T>(&self, response: Result<Response<T>, Status>) -> Result<T, Error> {
        self.met(response.map(Response::into_inner))
    }

    fn met<T>(&self, result: Result<T, Status>) -> Result<T, Error> {
        result.map_err(|status| Error::from_status(&status, &self.endpoint))
    }

    fn models_client(&self) -> ModelServiceClient<Channel> {
        ModelServiceClient::new(self.channel.clone())
            .max_encoding_message_size(MAX_REQUEST_BYTES)
            .max_decoding_message_size(MAX_ANSWER_BYTES)
    }

    fn jobs_client(&self) -> JobServiceClient<Channel> {
        JobServiceClient::new(self.channel.clone())
    }

    fn maps_client(&self) -> MapServiceClient<Channel> {
        MapServiceClient::new(self.channel.clone()).max_decoding_message_size(MAX_ANSWER_BYTES)
    }

    fn sessions(&self) -> SessionServiceClient<Channel> {
        SessionServiceClient::new(self.channel.clone()).max_encoding_message_size(MAX_REQUEST_BYTES)
    }
}

/// The steps of a job, until it is done.
#[derive(Debug)]
pub struct JobProgress {
    jobs: Streaming<v1::Job>,
    endpoint: String,
}

impl JobProgress {
    /// The job whenever it has moved on; none after its last state.
    ///
    /// # Errors
    /// [`Error::Connection`] if the connection broke: the job may still go on.
    pub async fn next(&mut self) -> Result<Option<v1::Job>, Error> {
        self.jobs.message().await.map_err(|status| Error::from_status(&status, &self.endpoint))
    }
}

/// `maps/{map}` of a map given with or without its collection.
pub(crate) fn map_name(map: &str) -> String {
    if map.starts_with("maps/") { map.to_owned() } else { format!("maps/{map}") }
}

fn configured(endpoint: &str) -> Result<Endpoint, Error> {
    let refused = |reason: String| Error::Endpoint { endpoint: endpoint.to_owned(), reason };
    let configured =
        Endpoint::from_shared(endpoint.to_owned()).map_err(|error| refused(innermost(&error)))?;
    match configured.uri().scheme_str() {
        Some("http") => {}
        Some(other) => return Err(refused(format!("the scheme `{other}` is not served"))),
        None => return Err(refused("it lacks http://".to_owned())),
    }
    configured
        .connect_timeout(CONNECT_TIMEOUT)
        .tcp_nodelay(true)
        .http2_keep_alive_interval(KEEP_ALIVE_INTERVAL)
        .keep_alive_timeout(KEEP_ALIVE_TIMEOUT)
        .user_agent(concat!("waypost-client/", env!("CARGO_PKG_VERSION")))
        .map_err(|error| refused(innermost(&error)))
}

/// A file in chunks of 1 MiB, the last one shorter.
fn chunks(file: impl AsyncRead + Send + Unpin + 'static) -> impl Stream<Item = io::Result<Vec<u8>>> + Send {
    futures::stream::try_unfold(file, |mut file| async move {
        let mut chunk = Vec::new();
        (&mut file).take(CHUNK_BYTES as u64).read_to_end(&mut chunk).await?;
        Ok((!chunk.is_empty()).then_some((chunk, file)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_file_is_cut_into_chunks_that_join_to_itself() {
        let file: Vec<u8> = (0..CHUNK_BYTES * 2 + 5).map(|byte| (byte % 251) as u8).collect();
        let cut: Vec<Vec<u8>> = chunks(std::io::Cursor::new(file.clone())).try_collect().await.unwrap();
        assert_eq!(cut.iter().map(Vec::len).collect::<Vec<_>>(), [CHUNK_BYTES, CHUNK_BYTES, 5]);
        assert_eq!(cut.concat(), file);
    }

    #[test]
    fn a_map_is_named_with_or_without_its_collection() {
        assert_eq!(map_name("office"), "maps/office");
        assert_eq!(map_name("maps/office"), "maps/office");
    }

    #[test]
    fn addresses_that_no_client_can_use_are_refused() {
        for endpoint in ["", "127.0.0.1:7600", "https://127.0.0.1:7600", "http://", "http://a b"] {
            let refused = configured(endpoint);
            assert!(matches!(refused, Err(Error::Endpoint { .. })), "{endpoint:?}: {refused:?}");
        }
        assert!(configured("http://127.0.0.1:7600").is_ok());
    }
}
