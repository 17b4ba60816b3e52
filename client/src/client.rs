//! Calls about models, jobs and maps, and the connection they share with sessions.

use std::io;
use std::time::Duration;

use futures::{Stream, StreamExt, TryStreamExt};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint};
use tonic::{Response, Status, Streaming};
use waypost_proto::v1;
use waypost_proto::v1::appearance_service_client::AppearanceServiceClient;
use waypost_proto::v1::job_service_client::JobServiceClient;
use waypost_proto::v1::map_service_client::MapServiceClient;
use waypost_proto::v1::model_service_client::ModelServiceClient;
use waypost_proto::v1::navigation_service_client::NavigationServiceClient;
use waypost_proto::v1::session_service_client::SessionServiceClient;
use waypost_proto::v1::token_service_client::TokenServiceClient;
use waypost_proto::v1::train_model_request::Content;

use crate::MAX_IMAGE_BYTES;
use crate::error::{Error, innermost};
use crate::options::{Bearer, ClientOptions};
use crate::session::{Session, SessionOptions};
use crate::upload::upload;

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// A peer that vanished without a word is noticed after the interval and the timeout.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(10);
const KEEP_ALIVE_TIMEOUT: Duration = Duration::from_secs(10);
/// An image, and 64 KiB for all else.
const MAX_REQUEST_BYTES: usize = MAX_IMAGE_BYTES + (64 << 10);
/// A page of places is the longest answer: 100 places with 100 frames each, about 2 MiB.
pub(crate) const MAX_ANSWER_BYTES: usize = 16 << 20;
pub(crate) const PAGE_SIZE: u32 = 100;
const CHUNK_BYTES: usize = 1 << 20;

/// A connection with the token that goes with every call.
pub(crate) type Transport = InterceptedService<Channel, Bearer>;

/// A connection to a server. Cheap to clone; clones share the connection, which is made again by
/// itself for the next call when it broke.
#[derive(Clone, Debug)]
pub struct Client {
    transport: Transport,
    endpoint: String,
}

impl Client {
    /// Connects to a server: at an address, or as [`ClientOptions`] say.
    ///
    /// # Errors
    /// [`Error::Endpoint`] if that is no address, [`Error::Options`] if token or certificates are of no
    /// use, [`Error::Connection`] if nobody answers there.
    pub async fn connect(options: impl Into<ClientOptions>) -> Result<Self, Error> {
        let options = options.into();
        let endpoint = configured(&options)?;
        let channel = endpoint.connect().await.map_err(|error| Error::Connection {
            endpoint: options.endpoint.clone(),
            reason: innermost(&error),
        })?;
        Self::over(channel, options)
    }

    /// A client that connects with its first call: for robots that may boot before the server does.
    /// Call from within a Tokio runtime.
    ///
    /// # Errors
    /// [`Error::Endpoint`] if that is no address, [`Error::Options`] if token or certificates are of no
    /// use.
    pub fn lazy(options: impl Into<ClientOptions>) -> Result<Self, Error> {
        let options = options.into();
        let channel = configured(&options)?.connect_lazy();
        Self::over(channel, options)
    }

    fn over(channel: Channel, options: ClientOptions) -> Result<Self, Error> {
        let transport = InterceptedService::new(channel, options.bearer()?);
        Ok(Self { transport, endpoint: options.endpoint })
    }

    /// Opens a session, or resumes the one of that name. Waits for an unreachable server as long as
    /// the session would later on.
    ///
    /// # Errors
    /// [`Error::Status`] if the server refuses, [`Error::SessionLost`] if it could not be reached.
    pub async fn open_session(&self, options: SessionOptions) -> Result<Session, Error> {
        Session::open(self.sessions_client(), options).await
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
        self.all_pages(|page_token| {
            let mut service = self.models_client();
            let request = v1::ListModelsRequest { page_size: PAGE_SIZE, page_token };
            async move {
                let page = service.list_models(request).await?.into_inner();
                Ok((page.models, page.next_page_token))
            }
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

    /// All jobs, newest first. Those that ended more than 30 days ago are forgotten.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub async fn jobs(&self) -> Result<Vec<v1::Job>, Error> {
        self.all_pages(|page_token| async move {
            let request = v1::ListJobsRequest { page_size: PAGE_SIZE, page_token };
            let page = self.jobs_client().list_jobs(request).await?.into_inner();
            Ok((page.jobs, page.next_page_token))
        })
        .await
    }

    /// How far a job (`jobs/{number}`) is.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn job(&self, name: &str) -> Result<v1::Job, Error> {
        self.taken(self.jobs_client().get_job(v1::GetJobRequest { name: name.to_owned() }).await)
    }

    /// Follows a job until it is done. One that a restart of the server cut off has failed.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
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
        self.all_pages(|page_token| {
            let mut service = self.maps_client();
            let request = v1::ListMapsRequest { page_size: PAGE_SIZE, page_token };
            async move {
                let page = service.list_maps(request).await?.into_inner();
                Ok((page.maps, page.next_page_token))
            }
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
        self.all_pages(|page_token| {
            let mut service = self.maps_client();
            let request = v1::ListPlacesRequest { map: map_name(map), page_size: PAGE_SIZE, page_token };
            async move {
                let page = service.list_places(request).await?.into_inner();
                Ok((page.places, page.next_page_token))
            }
        })
        .await
    }

    /// All loop closures of a map, oldest first.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn matches(&self, map: &str) -> Result<Vec<v1::LoopClosure>, Error> {
        self.all_pages(|page_token| {
            let mut service = self.maps_client();
            let request = v1::ListMatchesRequest { map: map_name(map), page_size: PAGE_SIZE, page_token };
            async move {
                let page = service.list_matches(request).await?.into_inner();
                Ok((page.matches, page.next_page_token))
            }
        })
        .await
    }

    /// Writes a snapshot of a map with its model, as it is now; gives its length in bytes. Robots may
    /// stream into the map meanwhile.
    ///
    /// # Errors
    /// [`Error::Write`] if it cannot be written; [`Error::Status`] with NOT_FOUND, with RESOURCE_EXHAUSTED
    /// if too many exports are under way, with ABORTED if nothing was taken for two minutes.
    pub async fn export_map(&self, name: &str, file: &mut (impl AsyncWrite + Unpin)) -> Result<u64, Error> {
        let request = v1::ExportMapRequest { name: map_name(name) };
        let mut chunks = self.taken(self.maps_client().export_map(request).await)?;
        let mut length_bytes = 0;
        while let Some(v1::ExportMapResponse { chunk }) = self.met(chunks.message().await)? {
            file.write_all(&chunk).await.map_err(Error::Write)?;
            length_bytes += chunk.len() as u64;
        }
        file.flush().await.map_err(Error::Write)?;
        Ok(length_bytes)
    }

    /// Writes poses as text: a session's drive (TUM, KITTI) or a map's pose graph (g2o); gives the length in bytes.
    ///
    /// # Errors
    /// [`Error::Write`] if it cannot be written; [`Error::Status`] with NOT_FOUND, with FAILED_PRECONDITION if nothing
    /// has such poses.
    pub async fn export_poses(
        &self,
        request: v1::ExportPosesRequest,
        file: &mut (impl AsyncWrite + Unpin),
    ) -> Result<u64, Error> {
        let mut chunks = self.taken(self.maps_client().export_poses(request).await)?;
        let mut length_bytes = 0;
        while let Some(v1::ExportPosesResponse { chunk }) = self.met(chunks.message().await)? {
            file.write_all(&chunk).await.map_err(Error::Write)?;
            length_bytes += chunk.len() as u64;
        }
        file.flush().await.map_err(Error::Write)?;
        Ok(length_bytes)
    }

    /// Takes a snapshot to the server, as a new map; an empty name leaves the one in the file. The job
    /// that comes back checks and stores it; see [`watch_job`](Self::watch_job).
    ///
    /// # Errors
    /// [`Error::Read`] if it cannot be read; [`Error::Status`] with ALREADY_EXISTS if there is a map of that
    /// name, with INVALID_ARGUMENT if it is no snapshot.
    pub async fn import_map(
        &self,
        map_id: &str,
        file: impl AsyncRead + Send + Unpin + 'static,
    ) -> Result<v1::Job, Error> {
        let map_id = map_id.strip_prefix("maps/").unwrap_or(map_id).to_owned();
        // An empty file is for the server to refuse, and needs a message.
        let named = futures::stream::once(async { Ok(v1::ImportMapRequest { map_id, chunk: Vec::new() }) });
        let requests =
            named.chain(chunks(file).map_ok(|chunk| v1::ImportMapRequest { map_id: String::new(), chunk }));
        let mut maps = self.maps_client().max_encoding_message_size(MAX_REQUEST_BYTES);
        let unsendable = || v1::ImportMapRequest { map_id: String::new(), chunk: vec![0; MAX_REQUEST_BYTES] };
        let call = |requests| async move { maps.import_map(requests).await };
        upload(requests, unsendable, &self.endpoint, call).await
    }

    /// Makes a token; gives its secret too, which the server does not keep.
    ///
    /// # Errors
    /// [`Error::Status`] with ALREADY_EXISTS or INVALID_ARGUMENT; with FAILED_PRECONDITION if the first
    /// token is not an admin's.
    pub async fn create_token(
        &self,
        token_id: &str,
        role: v1::token::Role,
    ) -> Result<(v1::Token, String), Error> {
        let request = v1::CreateTokenRequest { token_id: token_id.to_owned(), role: role.into() };
        let v1::CreateTokenResponse { token, secret } =
            self.taken(self.tokens_client().create_token(request).await)?;
        Ok((token.ok_or(Error::Protocol("a new token came without its name"))?, secret))
    }

    /// All tokens, by name.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub async fn tokens(&self) -> Result<Vec<v1::Token>, Error> {
        self.all_pages(|page_token| async move {
            let request = v1::ListTokensRequest { page_size: PAGE_SIZE, page_token };
            let page = self.tokens_client().list_tokens(request).await?.into_inner();
            Ok((page.tokens, page.next_page_token))
        })
        .await
    }

    /// Deletes a token, by `name` or `tokens/name`.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND; with FAILED_PRECONDITION if nobody could administer the server
    /// without it.
    pub async fn delete_token(&self, name: &str) -> Result<(), Error> {
        let name = if name.starts_with("tokens/") { name.to_owned() } else { format!("tokens/{name}") };
        let request = v1::DeleteTokenRequest { name };
        let v1::DeleteTokenResponse {} = self.taken(self.tokens_client().delete_token(request).await)?;
        Ok(())
    }

    /// Not an `AsyncFn`: calls must be such as can be spawned.
    pub(crate) async fn all_pages<T, P>(&self, page: impl Fn(String) -> P) -> Result<Vec<T>, Error>
    where
        P: Future<Output = Result<(Vec<T>, String), Status>>,
    {
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

    pub(crate) fn taken<T>(&self, response: Result<Response<T>, Status>) -> Result<T, Error> {
        self.met(response.map(Response::into_inner))
    }

    fn met<T>(&self, result: Result<T, Status>) -> Result<T, Error> {
        result.map_err(|status| Error::from_status(&status, &self.endpoint))
    }

    fn models_client(&self) -> ModelServiceClient<Transport> {
        ModelServiceClient::new(self.transport.clone())
            .max_encoding_message_size(MAX_REQUEST_BYTES)
            .max_decoding_message_size(MAX_ANSWER_BYTES)
    }

    fn jobs_client(&self) -> JobServiceClient<Transport> {
        JobServiceClient::new(self.transport.clone())
    }

    pub(crate) fn transport(&self) -> Transport {
        self.transport.clone()
    }

    pub(crate) fn maps_client(&self) -> MapServiceClient<Transport> {
        MapServiceClient::new(self.transport.clone()).max_decoding_message_size(MAX_ANSWER_BYTES)
    }

    pub(crate) fn appearance_client(&self) -> AppearanceServiceClient<Transport> {
        AppearanceServiceClient::new(self.transport.clone()).max_decoding_message_size(MAX_ANSWER_BYTES)
    }

    fn tokens_client(&self) -> TokenServiceClient<Transport> {
        TokenServiceClient::new(self.transport.clone()).max_decoding_message_size(MAX_ANSWER_BYTES)
    }

    pub(crate) fn navigations_client(&self) -> NavigationServiceClient<Transport> {
        NavigationServiceClient::new(self.transport.clone())
            .max_encoding_message_size(MAX_REQUEST_BYTES)
            .max_decoding_message_size(MAX_ANSWER_BYTES)
    }

    pub(crate) fn sessions_client(&self) -> SessionServiceClient<Transport> {
        SessionServiceClient::new(self.transport.clone())
            .max_encoding_message_size(MAX_REQUEST_BYTES)
            .max_decoding_message_size(MAX_ANSWER_BYTES)
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

fn configured(options: &ClientOptions) -> Result<Endpoint, Error> {
    let endpoint = options.endpoint.as_str();
    let refused = |reason: String| Error::Endpoint { endpoint: endpoint.to_owned(), reason };
    let mut configured =
        Endpoint::from_shared(endpoint.to_owned()).map_err(|error| refused(innermost(&error)))?;
    match configured.uri().scheme_str() {
        Some("http") => options.check_plain()?,
        Some("https") => {
            let unusable =
                |error| Error::Options(format!("the certificates cannot be used: {}", innermost(&error)));
            configured = configured.tls_config(options.tls()?).map_err(unusable)?;
        }
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

    #[tokio::test]
    async fn calls_can_be_spawned() {
        let spawnable = |_: &(dyn Future<Output = Result<(), Error>> + Send)| {};
        let client = Client::lazy("http://127.0.0.1:1").unwrap();
        spawnable(&async { client.models().await.map(drop) });
        spawnable(&async { client.maps().await.map(drop) });
        spawnable(&async { client.places("drive").await.map(drop) });
        spawnable(&async { client.matches("drive").await.map(drop) });
        spawnable(&async { client.word_places("drive", 7).await.map(drop) });
        spawnable(&async { client.sessions("drive").await.map(drop) });
        spawnable(&async { client.frames("maps/drive/sessions/robot").await.map(drop) });
    }

    #[test]
    fn a_map_is_named_with_or_without_its_collection() {
        assert_eq!(map_name("office"), "maps/office");
        assert_eq!(map_name("maps/office"), "maps/office");
    }

    #[test]
    fn addresses_that_no_client_can_use_are_refused() {
        for endpoint in ["", "127.0.0.1:7600", "ftp://127.0.0.1:7600", "http://", "http://a b"] {
            let refused = configured(&endpoint.into());
            assert!(matches!(refused, Err(Error::Endpoint { .. })), "{endpoint:?}: {refused:?}");
        }
        assert!(configured(&"http://127.0.0.1:7600".into()).is_ok());
    }
}
