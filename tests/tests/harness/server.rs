//! A server within this process.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tonic::transport::{Channel, Endpoint};
use waypost_client::{Client, v1};

use super::{by_words_request, location, map_request, model_file};

/// A server on ports and, unless told otherwise, on a directory of its own. Stops when dropped.
pub(crate) struct Server {
    directory: PathBuf,
    /// Removed with the server, if it was made for it.
    _own_directory: Option<TempDir>,
    grpc: SocketAddr,
    http: SocketAddr,
    stop: oneshot::Sender<()>,
    served: JoinHandle<()>,
}

impl Server {
    /// An empty server.
    pub(crate) async fn start() -> Self {
        let own = tempfile::tempdir().unwrap();
        let mut server = Self::start_on(own.path()).await;
        server._own_directory = Some(own);
        server
    }

    /// A server on a directory that may hold maps already.
    pub(crate) async fn start_on(directory: &Path) -> Self {
        Self::start_as(directory, |server| server).await
    }

    /// A server on a directory that may be damaged: what it says if it does not start.
    pub(crate) async fn try_start_on(directory: &Path) -> Result<Self, String> {
        let server = waypost_server::Server::open(location(directory).await).await;
        Ok(Self::serving(directory, server.map_err(|error| error.to_string())?).await)
    }

    /// A server on a directory, with what `configure` adds to it.
    pub(crate) async fn start_as(
        directory: &Path,
        configure: impl FnOnce(waypost_server::Server) -> waypost_server::Server,
    ) -> Self {
        let server =
            waypost_server::Server::open(location(directory).await).await.expect("the directory opens");
        Self::serving(directory, configure(server)).await
    }

    async fn serving(directory: &Path, server: waypost_server::Server) -> Self {
        let listener = async || TcpListener::bind("127.0.0.1:0").await.unwrap();
        let (grpc, http) = (listener().await, listener().await);
        let (grpc_at, http_at) = (grpc.local_addr().unwrap(), http.local_addr().unwrap());
        let (stop, stopped) = oneshot::channel();
        let serving = server.serve(grpc, http, async move {
            // Also when the sender is dropped.
            let _ = stopped.await;
        });
        let served = tokio::spawn(async move { serving.await.expect("the server ends well") });
        Self {
            directory: directory.to_owned(),
            _own_directory: None,
            grpc: grpc_at,
            http: http_at,
            stop,
            served,
        }
    }

    /// A server with the shipped model, and a map `drive` made from it.
    pub(crate) async fn with_map() -> (Self, Client) {
        let server = Self::start().await;
        let client = server.client().await;
        let model = import_model(&client).await;
        client.create_map(map_request("drive", &model.name)).await.unwrap();
        (server, client)
    }

    /// The same with a map that goes by words alone.
    pub(crate) async fn with_map_of_words() -> (Self, Client) {
        let server = Self::start().await;
        let client = server.client().await;
        let model = import_model(&client).await;
        client.create_map(by_words_request("drive", &model.name)).await.unwrap();
        (server, client)
    }

    pub(crate) fn directory(&self) -> &Path {
        &self.directory
    }

    /// Where gRPC is served.
    pub(crate) fn endpoint(&self) -> String {
        format!("http://{}", self.grpc)
    }

    /// Where gRPC is served, as an address.
    pub(crate) fn grpc(&self) -> SocketAddr {
        self.grpc
    }

    /// Where REST is served.
    pub(crate) fn http(&self) -> SocketAddr {
        self.http
    }

    /// A path of the REST API.
    pub(crate) fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.http)
    }

    pub(crate) async fn client(&self) -> Client {
        Client::connect(&self.endpoint()).await.unwrap()
    }

    /// Stops in good order, and waits for it.
    pub(crate) async fn stop(self) {
        let _ = self.stop.send(());
        super::in_time(self.served).await.unwrap();
    }
}

/// Takes the shipped model to a server.
pub(crate) async fn import_model(client: &Client) -> v1::Model {
    let file = tokio::fs::File::open(model_file()).await.expect("the shipped model");
    client.import_model("shipped", file).await.unwrap()
}

/// The state hash of a map.
pub(crate) async fn state_hash(client: &Client, map: &str) -> String {
    let hash = client.map(map, v1::MapView::Full).await.unwrap().state_hash.unwrap();
    assert_eq!(hash.len(), 64, "{hash:?} is no SHA-256");
    hash
}

/// Why a job or a merge failed; empty if it did not.
pub(crate) fn said(error: &Option<waypost_proto::google::rpc::Status>) -> &str {
    error.as_ref().map_or("", |status| status.message.as_str())
}

/// A bare gRPC connection that takes so many bytes of each call before somebody reads them.
pub(crate) async fn channel_with_window(endpoint: &str, window_bytes: u32) -> Channel {
    let endpoint = Endpoint::from_shared(endpoint.to_owned()).unwrap();
    endpoint.initial_stream_window_size(window_bytes).connect().await.unwrap()
}

/// A bare gRPC connection.
pub(crate) async fn channel(endpoint: &str) -> Channel {
    Endpoint::from_shared(endpoint.to_owned()).unwrap().connect().await.unwrap()
}
