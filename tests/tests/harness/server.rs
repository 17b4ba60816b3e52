//! A server within this process.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::runtime::Handle;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tonic::transport::{Channel, Endpoint};
use waypost_client::{Client, v1};
use waypost_server::config::{Config, DataLocation};
use waypost_server::{Opening, Ports, open_beside_others};

use super::{by_words_request, location, map_request, model_file};

/// Set where all is to be asked of a server that does not own the database, on PostgreSQL.
const ASKED_IN_RESERVE: &str = "WAYPOST_TEST_ASKED_IN_RESERVE";

/// A server on ports and, unless told otherwise, on a directory of its own. Stops when dropped.
pub(crate) struct Server {
    directory: PathBuf,
    /// Removed with the server, if it was made for it.
    _own_directory: Option<TempDir>,
    grpc: SocketAddr,
    http: SocketAddr,
    reserve: Option<Reserve>,
    stop: oneshot::Sender<()>,
    served: JoinHandle<()>,
}

/// A server in reserve, which is asked in place of the owner.
struct Reserve {
    stop: oneshot::Sender<()>,
    waiting: JoinHandle<()>,
}

impl Reserve {
    fn waiting(location: DataLocation, ports: Ports) -> Self {
        let (stop, stopped) = oneshot::channel::<()>();
        let waiting = tokio::task::spawn_blocking(move || {
            let stopped = async {
                let _ = stopped.await;
            };
            let opened =
                Handle::current().block_on(open_beside_others(&location, &ports, Opening::First, stopped));
            assert!(opened.expect("it serves").is_none(), "it is never its turn");
        });
        Self { stop, waiting }
    }

    async fn stop(self) {
        let _ = self.stop.send(());
        super::in_time(self.waiting).await.unwrap();
    }
}

async fn ports() -> Ports {
    let listener = async || TcpListener::bind("127.0.0.1:0").await.unwrap();
    Ports {
        grpc: listener().await,
        http: listener().await,
        tls: None,
        strangers: Config::default().strangers(),
        advertised_host: None,
        allow_anonymous: false,
    }
}

fn addresses(ports: &Ports) -> [SocketAddr; 2] {
    [&ports.grpc, &ports.http].map(|listener| listener.local_addr().unwrap())
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
        Self::try_start_as(directory, |server| server).await
    }

    /// A server on a directory, with what `configure` adds to it.
    pub(crate) async fn start_as(
        directory: &Path,
        configure: impl FnOnce(waypost_server::Server) -> waypost_server::Server,
    ) -> Self {
        Self::try_start_as(directory, configure).await.expect("the directory opens")
    }

    async fn try_start_as(
        directory: &Path,
        configure: impl FnOnce(waypost_server::Server) -> waypost_server::Server,
    ) -> Result<Self, String> {
        let location = location(directory).await;
        let ports = ports().await;
        let opened = open_beside_others(&location, &ports, Opening::First, std::future::pending()).await;
        let server = configure(opened.map_err(|error| error.to_string())?.expect("nobody stops it"));
        let mut addresses = addresses(&ports);
        let (stop, stopped) = oneshot::channel();
        let serving = server.serve(ports.grpc, ports.http, async move {
            // Also when the sender is dropped.
            let _ = stopped.await;
        });
        let served = tokio::spawn(async move {
            serving.await.expect("the server ends well");
        });
        let mut reserve = None;
        if std::env::var_os(ASKED_IN_RESERVE).is_some() {
            let ports = self::ports().await;
            addresses = self::addresses(&ports);
            reserve = Some(Reserve::waiting(location, ports));
        }
        let [grpc, http] = addresses;
        Ok(Self { directory: directory.to_owned(), _own_directory: None, grpc, http, reserve, stop, served })
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
        if let Some(reserve) = self.reserve {
            reserve.stop().await;
        }
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
