//! Who is let in to look on: so many at once, and the next are told so.
//!
//! Foxglove's library lets in everybody, and keeps messages for each. It listens on this machine
//! alone, and the gate passes on those who come.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};
use tokio::io::{AsyncReadExt, AsyncWriteExt, copy_bidirectional};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};

/// To say what it wants; whoever says nothing takes up no place.
const PATIENCE: Duration = Duration::from_secs(5);
/// What a request has at most: those of browsers have a tenth.
const MOST_REQUEST_BYTES: usize = 16 << 10;
/// Whoever is not heard of for so long, and then does not answer, has gone without a word.
const SILENCE: Duration = Duration::from_secs(30);
/// After the system would not let anybody in, as where it has no files left.
const PAUSE: Duration = Duration::from_millis(200);

/// A door that is open until this is dropped. Those who are in may stay.
pub(crate) struct Gate {
    address: SocketAddr,
    letting_in: JoinHandle<()>,
}

impl Gate {
    /// Lets in as many at once as there are `places`, to what listens `behind`.
    ///
    /// # Errors
    /// Where the address cannot be had.
    pub(crate) async fn open(address: SocketAddr, places: usize, behind: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address).await?;
        let address = listener.local_addr()?;
        Ok(Self { address, letting_in: tokio::spawn(let_in(listener, places, behind)) })
    }

    /// Where it is.
    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Gate {
    fn drop(&mut self) {
        self.letting_in.abort();
    }
}

async fn let_in(listener: TcpListener, places: usize, behind: SocketAddr) {
    let free = Arc::new(Semaphore::new(places));
    // Whoever is refused is listened to first, which takes a moment: more at once are cut off.
    let refusals = Arc::new(Semaphore::new(places));
    loop {
        let (viewer, from) = match listener.accept().await {
            Ok(come) => come,
            Err(error) => {
                tracing::warn!("nobody can be let in to look on for now: {error}");
                sleep(PAUSE).await;
                continue;
            }
        };
        if let Ok(place) = free.clone().try_acquire_owned() {
            tokio::spawn(async move {
                if let Err(error) = pass(viewer, behind).await {
                    tracing::debug!("{from} looks on no more: {error}");
                }
                drop(place);
            });
        } else if let Ok(turn) = refusals.clone().try_acquire_owned() {
            tracing::warn!("{from} is not let in to look on: {places} do already");
            tokio::spawn(async move {
                // Whoever does not listen is gone.
                let _ = timeout(PATIENCE, refuse(viewer, places)).await;
                drop(turn);
            });
        }
    }
}

/// Passes on what both say, from the first whole request to the end.
async fn pass(mut viewer: TcpStream, behind: SocketAddr) -> io::Result<()> {
    let asked = timeout(PATIENCE, request(&mut viewer)).await??;
    let lives = TcpKeepalive::new().with_time(SILENCE).with_interval(PATIENCE).with_retries(3);
    SockRef::from(&viewer).set_tcp_keepalive(&lives)?;
    let mut server = TcpStream::connect(behind).await?;
    viewer.set_nodelay(true)?;
    server.set_nodelay(true)?;
    server.write_all(&asked).await?;
    copy_bidirectional(&mut viewer, &mut server).await?;
    Ok(())
}

async fn refuse(mut viewer: TcpStream, places: usize) -> io::Result<()> {
    // What is not read would break the connection off before the answer is there.
    request(&mut viewer).await?;
    let told = format!(
        "{places} viewers look on already, which is as many as the bridge lets in: close one of them, and connect again.\n"
    );
    let head = "HTTP/1.1 503 Service Unavailable\r\nContent-Type: text/plain; charset=utf-8\r\nConnection: close\r\n";
    let answer = format!("{head}Content-Length: {}\r\n\r\n{told}", told.len());
    viewer.write_all(answer.as_bytes()).await?;
    viewer.shutdown().await
}

/// What a viewer says first, up to the empty line that ends a request of HTTP.
async fn request(viewer: &mut TcpStream) -> io::Result<Vec<u8>> {
    let mut asked = Vec::new();
    while !asked.windows(4).any(|end| end == b"\r\n\r\n") {
        if asked.len() >= MOST_REQUEST_BYTES {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "its request has no end"));
        }
        if viewer.read_buf(&mut asked).await? == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
    }
    Ok(asked)
}
