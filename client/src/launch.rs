//! A server of one's own, as a child process: for demonstrations, measurements and tests.

use std::ffi::OsStr;
use std::fs::File;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use serde::Deserialize;

/// Far more than a start or a stop takes.
const PATIENCE: Duration = Duration::from_secs(60);
const POLL: Duration = Duration::from_millis(5);

/// Lines of the log that are shown when the server failed.
const LOG_LINES: usize = 20;

const READY_FILE: &str = "ready.json";
const LOG_FILE: &str = "server.log";

/// A running server. Dropping it kills it; [`stop`](Self::stop) lets it finish.
///
/// Starting and stopping block the calling thread.
#[derive(Debug)]
pub struct ServerProcess {
    child: Child,
    log: PathBuf,
    ready: Ready,
}

/// What the server writes once it listens.
#[derive(Debug, Deserialize)]
struct Ready {
    grpc: SocketAddr,
    http: SocketAddr,
}

/// A server did not start or did not stop in good order.
#[derive(Debug, thiserror::Error)]
#[error("the server {problem}; what it logged last:\n{log}")]
pub struct LaunchError {
    /// What happened, to follow "the server".
    pub problem: String,
    /// Its last lines.
    pub log: String,
}

/// A command that runs a program of Waypost's without the `WAYPOST_` settings of the environment, which are meant for
/// another server, and without input.
#[must_use]
pub fn command(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("WAYPOST_")) {
        command.env_remove(name);
    }
    command.stdin(Stdio::null());
    command
}

impl ServerProcess {
    /// Starts a server on `data_dir` and on free ports of the loopback interface, and waits until it listens. The
    /// `command` is [`command`] of the program, with further options and settings if wanted; its ready file and its log
    /// go to the folder `files`.
    ///
    /// # Errors
    /// [`LaunchError`] if it cannot be started, ends, or does not listen within a minute.
    pub fn start(mut command: Command, data_dir: &Path, files: &Path) -> Result<Self, LaunchError> {
        let log = files.join(LOG_FILE);
        let ready_file = files.join(READY_FILE);
        // The file of an earlier start would name other ports.
        let _ = std::fs::remove_file(&ready_file);
        command
            .args(["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0"])
            .arg("--data-dir")
            .arg(data_dir)
            .arg("--ready-file")
            .arg(&ready_file);
        let mut child = spawn(&mut command, &log).map_err(|error| {
            let problem = format!("{} cannot be started: {error}", command.get_program().display());
            LaunchError { problem, log: String::new() }
        })?;
        match wait_until_ready(&mut child, &ready_file) {
            Ok(ready) => Ok(Self { child, log, ready }),
            Err(problem) => {
                // An error means that it has ended already.
                let _ = child.kill();
                let _ = child.wait();
                Err(LaunchError { problem, log: last_lines(&log) })
            }
        }
    }

    /// Where its gRPC port listens.
    #[must_use]
    pub fn grpc(&self) -> SocketAddr {
        self.ready.grpc
    }

    /// Where its HTTP port listens.
    #[must_use]
    pub fn http(&self) -> SocketAddr {
        self.ready.http
    }

    /// The address that clients connect to.
    #[must_use]
    pub fn endpoint(&self) -> String {
        format!("http://{}", self.grpc())
    }

    /// The process.
    #[must_use]
    pub fn child(&self) -> &Child {
        &self.child
    }

    /// What it has logged so far.
    #[must_use]
    pub fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Its memory in RAM, in bytes, where the system says.
    #[must_use]
    pub fn rss_bytes(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let kib = status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.trim().strip_suffix("kB"))?;
        Some(1024 * kib.trim().parse::<u64>().ok()?)
    }

    /// Whether it has not ended yet.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Ends it at once, as `kill -9` does.
    pub fn kill(self) {
        drop(self);
    }

    /// Sends SIGTERM and waits for nothing; gives whether it was sent.
    #[must_use]
    pub fn ask_to_stop(&self) -> bool {
        // The standard library can only kill, and a machine need not have the program `kill`: the shell has its own.
        let process = self.child.id().to_string();
        let sent = Command::new("sh").args(["-c", "kill -TERM \"$1\"", "sh", &process]).status();
        sent.is_ok_and(|status| status.success())
    }

    /// Asks it to stop in good order; `None` if it does not within `patience`.
    pub fn terminate(&mut self, patience: Duration) -> Option<ExitStatus> {
        self.ask_to_stop().then(|| wait(&mut self.child, patience)).flatten()
    }

    /// Waits until it ends by itself; `None` if it does not within `patience`.
    pub fn wait(&mut self, patience: Duration) -> Option<ExitStatus> {
        wait(&mut self.child, patience)
    }

    /// Asks it to stop, and waits until it has.
    ///
    /// # Errors
    /// [`LaunchError`] if it does not stop within a minute, or ends with a failure; it is killed then.
    pub fn stop(mut self) -> Result<(), LaunchError> {
        let problem = match self.terminate(PATIENCE) {
            Some(status) if status.success() => return Ok(()),
            Some(status) => format!("ended badly ({status})"),
            None => format!("did not end within {} s", PATIENCE.as_secs()),
        };
        Err(LaunchError { problem, log: last_lines(&self.log) })
    }
}

impl Drop for ServerProcess {
    fn drop(&mut self) {
        // An error means that it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Waits until a process has ended; `None` if it does not within `patience`.
pub fn wait(child: &mut Child, patience: Duration) -> Option<ExitStatus> {
    let deadline = Instant::now() + patience;
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return Some(status),
            Ok(None) if Instant::now() <= deadline => std::thread::sleep(POLL),
            Ok(None) | Err(_) => return None,
        }
    }
}

fn spawn(command: &mut Command, log: &Path) -> io::Result<Child> {
    let log = File::create(log)?;
    command.stdout(log.try_clone()?).stderr(log).spawn()
}

fn wait_until_ready(child: &mut Child, ready_file: &Path) -> Result<Ready, String> {
    let deadline = Instant::now() + PATIENCE;
    loop {
        // A file that is half written does not parse yet.
        let written = std::fs::read(ready_file).ok();
        if let Some(ready) = written.and_then(|text| serde_json::from_slice(&text).ok()) {
            return Ok(ready);
        }
        match child.try_wait() {
            Ok(None) if Instant::now() <= deadline => std::thread::sleep(POLL),
            Ok(None) => return Err(format!("does not listen after {} s", PATIENCE.as_secs())),
            Ok(Some(status)) => return Err(format!("ended before it listened ({status})")),
            Err(error) => return Err(format!("cannot be watched: {error}")),
        }
    }
}

fn last_lines(log: &Path) -> String {
    let log = std::fs::read_to_string(log).unwrap_or_default();
    let lines: Vec<&str> = log.lines().collect();
    lines[lines.len().saturating_sub(LOG_LINES)..].join("\n")
}
