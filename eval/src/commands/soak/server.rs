//! The server: killed, stopped and started again behind one address, and looked at from outside.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use tempfile::TempDir;
use tokio::io::copy_bidirectional;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::broadcast;
use tokio::task::{JoinHandle, spawn_blocking};
use waypost_client::launch::ServerProcess;

use super::levels::Levels;
use super::stage::Stage;
use crate::commands::load::server::ServerOptions;
use crate::files;

/// A server that is asked to stop has stopped by then.
const PATIENCE: Duration = Duration::from_secs(60);

/// How the life of a server ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    Kill,
    Stop,
}

/// What is done while no server runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Between {
    Nothing,
    /// All of the database is read.
    DeepCheck,
}

/// The server of a soak, with the directory of its data.
pub(super) struct Server {
    options: ServerOptions,
    directory: TempDir,
    /// `None` while it is started again.
    process: Option<ServerProcess>,
    front: Front,
}

impl Server {
    pub(super) async fn start(options: &ServerOptions) -> Result<Self> {
        let directory = tempfile::tempdir().map_err(files::not_written(&std::env::temp_dir()))?;
        let front = Front::open().await?;
        let mut server = Self { options: options.clone(), directory, process: None, front };
        server.begin().await?;
        Ok(server)
    }

    /// The address that stays.
    pub(super) fn endpoint(&self) -> String {
        format!("http://{}", self.front.address)
    }

    /// Breaks all connections.
    pub(super) fn cut(&self) {
        // An error means that there are none.
        let _ = self.front.connections.send(());
    }

    async fn begin(&mut self) -> Result<()> {
        let command = self.options.command("warn")?;
        let (data, files) = (self.data(), self.directory.path().to_owned());
        let process = spawn_blocking(move || ServerProcess::start(command, &data, &files)).await??;
        *self.front.behind.lock().unwrap_or_else(PoisonError::into_inner) = Some(process.grpc());
        self.process = Some(process);
        Ok(())
    }

    /// Ends the server, looks at what it logged, and starts another one after a while.
    pub(super) async fn restart(
        &mut self,
        end: End,
        between: Between,
        pause: Duration,
        stage: &Stage,
    ) -> Result<()> {
        self.end(end, stage).await?;
        if between == Between::DeepCheck {
            self.deep_check().await?;
        }
        tokio::time::sleep(pause).await;
        self.begin().await?;
        stage.came_up();
        Ok(())
    }

    /// Ends it for good, or for a while.
    pub(super) async fn end(&mut self, end: End, stage: &Stage) -> Result<()> {
        let process = self.process.take().context("no server runs")?;
        let log = spawn_blocking(move || {
            let mut process = process;
            if end == End::Stop {
                let status = process.terminate(PATIENCE);
                ensure!(
                    status.is_some_and(|status| status.success()),
                    "SIGTERM: {status:?}\n{}",
                    process.log()
                );
            }
            let said = complaints(&process.log());
            process.kill();
            Ok(said)
        });
        let said = log.await??;
        stage.went_down();
        *self.front.behind.lock().unwrap_or_else(PoisonError::into_inner) = None;
        ensure!(said.is_empty(), "the server's log has {}", said.join("\n"));
        Ok(())
    }

    pub(super) async fn deep_check(&self) -> Result<()> {
        run(&self.options, &self.data(), &["check", "--deep"]).await
    }

    /// What backs it up, while it runs or not.
    pub(super) fn backup(&self) -> Backup {
        Backup { options: self.options.clone(), data: self.data() }
    }

    fn data(&self) -> PathBuf {
        self.directory.path().join("data")
    }

    /// What it takes now.
    pub(super) fn levels(&self) -> Result<Levels> {
        let process = self.process.as_ref().context("no server runs")?;
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        let number = process.child().id();
        let descriptors = PathBuf::from(format!("/proc/{number}/fd"));
        let threads = PathBuf::from(format!("/proc/{number}/task"));
        let entries = |folder: &Path| {
            let entries = std::fs::read_dir(folder).map_err(files::not_read(folder))?;
            Ok::<_, anyhow::Error>(entries.count() as f64)
        };
        let size = |name| std::fs::metadata(self.data().join(name)).map_or(0, |found| found.len());
        Ok(Levels {
            rss_mib: mib(process.rss_bytes().context("the system does not tell the server's memory")?),
            descriptors: entries(&descriptors)?,
            threads: entries(&threads)?,
            database_mib: mib(size("waypost.sqlite")),
            wal_mib: mib(size("waypost.sqlite-wal")),
        })
    }
}

/// Backups of a server's data.
#[derive(Clone, Debug)]
pub(super) struct Backup {
    options: ServerOptions,
    data: PathBuf,
}

impl Backup {
    /// Makes one, restores it elsewhere, and reads that through.
    pub(super) async fn made_and_restored(&self) -> Result<()> {
        let elsewhere = tempfile::tempdir().map_err(files::not_written(&std::env::temp_dir()))?;
        let [copy, restored] = ["copy", "restored"].map(|name| elsewhere.path().join(name));
        let copy = copy.display().to_string();
        run(&self.options, &self.data, &["backup", &copy]).await?;
        run(&self.options, &restored, &["restore", &copy]).await?;
        run(&self.options, &restored, &["check", "--deep"]).await
    }
}

/// Runs a command of the server's program on a directory; it is to succeed.
async fn run(options: &ServerOptions, data: &Path, arguments: &[&str]) -> Result<()> {
    let mut command = options.command("warn")?;
    command.args(["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0"]);
    command.arg("--data-dir").arg(data).args(arguments);
    let ended = spawn_blocking(move || command.output()).await??;
    if !ended.status.success() {
        let [said, why] = [&ended.stdout, &ended.stderr].map(|text| String::from_utf8_lossy(text));
        bail!("waypost-server {}: {}\n{said}{why}", arguments.join(" "), ended.status);
    }
    Ok(())
}

/// Lines of a log that no server should have.
fn complaints(log: &str) -> Vec<String> {
    let wrong = |line: &&str| line.contains("panicked") || line.contains("ERROR");
    log.lines().filter(wrong).take(5).map(str::to_owned).collect()
}

/// An address that stays while servers come and go behind it.
struct Front {
    address: SocketAddr,
    behind: Arc<Mutex<Option<SocketAddr>>>,
    /// Cut when it is told so.
    connections: broadcast::Sender<()>,
    forwarding: JoinHandle<()>,
}

impl Front {
    async fn open() -> Result<Self> {
        let listener =
            TcpListener::bind("127.0.0.1:0").await.context("no connection on the loopback interface")?;
        let address = listener.local_addr().context("no connection on the loopback interface")?;
        let behind = Arc::new(Mutex::new(None));
        let (connections, _) = broadcast::channel(1);
        let forwarding = tokio::spawn(forward(listener, behind.clone(), connections.clone()));
        Ok(Self { address, behind, connections, forwarding })
    }
}

impl Drop for Front {
    fn drop(&mut self) {
        self.forwarding.abort();
    }
}

async fn forward(
    listener: TcpListener,
    behind: Arc<Mutex<Option<SocketAddr>>>,
    connections: broadcast::Sender<()>,
) {
    while let Ok((mut near, _)) = listener.accept().await {
        let server = *behind.lock().unwrap_or_else(PoisonError::into_inner);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_and_errors_are_seen_in_a_log() {
        let log = "2026-01-01T00:00:00Z  WARN waypost_server: a robot is slow\n\
                   thread 'map' panicked at server/src/open_map.rs:1:1:\n\
                   2026-01-01T00:00:01Z ERROR waypost_server: the disk is gone\n";
        assert_eq!(complaints(log).len(), 2);
        assert!(complaints("2026-01-01T00:00:00Z  WARN waypost_server: a robot is slow\n").is_empty());
    }
}
