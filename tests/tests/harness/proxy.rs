//! An address that stays while servers come and go behind it.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};

use tokio::io::copy_bidirectional;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::broadcast;
use tokio::task::JoinHandle;

/// Forwards connections to the server that is behind it now.
pub(crate) struct Proxy {
    address: SocketAddr,
    behind: Arc<Mutex<Option<SocketAddr>>>,
    /// Cut when it is told so.
    connections: broadcast::Sender<()>,
    forwarding: JoinHandle<()>,
}

impl Proxy {
    pub(crate) async fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let behind = Arc::new(Mutex::new(None));
        let (connections, _) = broadcast::channel(1);
        let forwarding = tokio::spawn(forward(listener, behind.clone(), connections.clone()));
        Self { address, behind, connections, forwarding }
    }

    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }

    pub(crate) fn endpoint(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Breaks the connections that there are.
    pub(crate) fn cut(&self) {
        // An error means that there are none.
        let _ = self.connections.send(());
    }

    /// New connections go to this server from now on; to none, and they are closed at once.
    pub(crate) fn forward_to(&self, server: Option<SocketAddr>) {
        *self.behind.lock().unwrap() = server;
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.forwarding.abort();
    }
}

async fn forward(
    listener: TcpListener,
    behind: Arc<Mutex<Option<SocketAddr>>>,
    connections: broadcast::Sender<()>,
) {
    loop {
        let (mut near, _) = listener.accept().await.unwrap();
        let server = *behind.lock().unwrap();
        let mut cut = connections.subscribe();
        tokio::spawn(async move {
            if let Some(server) = server
                && let Ok(mut far) = TcpStream::connect(server).await
            {
                // Ends when either side does; a server that was killed resets the connection.
                tokio::select! {
                    _ = copy_bidirectional(&mut near, &mut far) => {}
                    _ = cut.recv() => {}
                }
            }
        });
    }
}
