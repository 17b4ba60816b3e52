//! A server of one's own, as a child process.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use serde::Deserialize;
use tokio::process::{Child, Command};
use tokio::time::{Instant, sleep, timeout};

use crate::failure::Failure;

const START_TIMEOUT: Duration = Duration::from_secs(60);
const STOP_TIMEOUT: Duration = Duration::from_secs(60);
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Lines of its log that are shown when it failed.
const LOG_LINES: usize = 20;

/// A running server. Dropping it kills it; [`stop`](Self::stop) lets it finish.
pub(crate) struct ServerProcess {
    child: Child,
    log: PathBuf,
    /// Where its gRPC port listens, as HOST:PORT.
    pub(crate) grpc_address: String,
}

/// What the server writes once it listens.
#[derive(Deserialize)]
struct Ready {
    grpc: String,
}

impl ServerProcess {
    /// Starts a server on free ports and waits until it listens.
    pub(crate) async fn start(program: &Path, data_dir: &Path) -> Result<Self, Failure> {
        let ready_file = data_dir.join("ready.json");
        let log = data_dir.join("server.log");
        let log_file = File::create(&log).map_err(Failure::file("write", &log))?;
        let log_again = log_file.try_clone().map_err(Failure::file("write", &log))?;
        let mut command = Command::new(program);
        // What the environment says is meant for another server.
        for (name, _) in
            std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("WAYPOST_"))
        {
            command.env_remove(name);
        }
        let child = command
            .arg("--data-dir")
            .arg(data_dir)
            .args(["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0", "--ready-file"])
            .arg(&ready_file)
            .stdin(Stdio::null())
            .stdout(log_file)
            .stderr(log_again)
            .kill_on_drop(true)
            .spawn()
            .map_err(Failure::file("start", program))?;
        let mut server = Self { child, log, grpc_address: String::new() };
        server.grpc_address = server.wait_until_ready(&ready_file).await?.grpc;
        Ok(server)
    }

    async fn wait_until_ready(&mut self, ready_file: &Path) -> Result<Ready, Failure> {
        let deadline = Instant::now() + START_TIMEOUT;
        loop {
            // A file that is half written does not parse yet.
            if let Some(ready) =
                std::fs::read(ready_file).ok().and_then(|text| serde_json::from_slice(&text).ok())
            {
                return Ok(ready);
            }
            if let Some(status) = self.child.try_wait().map_err(Failure::file("watch", &self.log))? {
                return Err(self.failed(format!("ended before it listened ({status})")));
            }
            if Instant::now() > deadline {
                return Err(self.failed(format!("does not listen after {} s", START_TIMEOUT.as_secs())));
            }
            sleep(POLL_INTERVAL).await;
        }
    }

    /// Asks the server to end, and waits until it has.
    pub(crate) async fn stop(mut self) -> Result<(), Failure> {
        let status = match timeout(STOP_TIMEOUT, self.terminate()).await {
            Ok(ended) => ended.map_err(Failure::file("stop the server that logs to", &self.log))?,
            Err(_elapsed) => {
                return Err(self.failed(format!("did not end within {} s", STOP_TIMEOUT.as_secs())));
            }
        };
        if status.success() { Ok(()) } else { Err(self.failed(format!("ended badly ({status})"))) }
    }

    async fn terminate(&mut self) -> io::Result<ExitStatus> {
        if let Some(process) = self.child.id() {
            // The standard library can only kill; SIGTERM is for the shell to send.
            Command::new("sh")
                .args(["-c", "kill -TERM \"$1\"", "sh"])
                .arg(process.to_string())
                .status()
                .await?;
        }
        self.child.wait().await
    }

    fn failed(&self, problem: String) -> Failure {
        let log = std::fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<&str> = log.lines().collect();
        let last = lines.get(lines.len().saturating_sub(LOG_LINES)..).unwrap_or_default();
        Failure::DemoServer { problem, log: last.join("\n") }
    }
}
