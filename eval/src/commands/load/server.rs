//! The server under load: started for one measurement, watched from outside, and stopped.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use serde::Deserialize;
use tempfile::TempDir;
use tokio::process::{Child, Command};
use tokio::time::{Instant, sleep, timeout};
use waypost_client::{Client, v1};

use super::ServerOptions;
use crate::error::EvalError;

const PATIENCE: Duration = Duration::from_secs(60);
const POLL: Duration = Duration::from_millis(20);

/// Lines of its log that are shown when it failed.
const LOG_LINES: usize = 20;

/// The map that all robots stream into.
pub(super) const MAP: &str = "load";

/// The kernel counts processor time in hundredths of a second on every platform that Rust runs on.
const TICKS_PER_SECOND: f64 = 100.0;

/// A server on a temporary directory, with a map. Killed when dropped; [`stop`](Self::stop) lets it finish.
pub(super) struct ServerUnderLoad {
    child: Child,
    directory: TempDir,
    /// Where robots connect, as HOST:PORT.
    pub(super) address: String,
}

/// What the server writes once it listens.
#[derive(Deserialize)]
struct Ready {
    grpc: String,
}

impl ServerUnderLoad {
    /// Starts a server on free ports of the loopback interface and makes a map in it.
    pub(super) async fn start(options: &ServerOptions) -> Result<Self, EvalError> {
        let program = program(options)?;
        let temporary = |reason| EvalError::Write { path: std::env::temp_dir(), reason };
        let directory = tempfile::tempdir().map_err(temporary)?;
        let server = Self::start_on(program, directory).await?;
        server.create_map(&options.model).await?;
        Ok(server)
    }

    /// Lets it finish, and starts it anew on its directory.
    pub(super) async fn restart(mut self, options: &ServerOptions) -> Result<Self, EvalError> {
        self.end().await?;
        let directory = self.directory;
        Self::start_on(program(options)?, directory).await
    }

    /// Kills it, and starts it anew on its directory.
    pub(super) async fn kill_and_restart(mut self, options: &ServerOptions) -> Result<Self, EvalError> {
        self.child.kill().await.map_err(|error| self.failed(error))?;
        let directory = self.directory;
        Self::start_on(program(options)?, directory).await
    }

    async fn start_on(program: PathBuf, directory: TempDir) -> Result<Self, EvalError> {
        let log = directory.path().join("log");
        let log = File::create(&log).map_err(|reason| EvalError::Write { path: log, reason })?;
        let ready_file = directory.path().join("ready.json");
        // One of an earlier start would tell wrong ports.
        let _ = std::fs::remove_file(&ready_file);
        let child = Command::new(&program)
            .arg("--data-dir")
            .arg(directory.path().join("data"))
            .args(["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0", "--ready-file"])
            .arg(&ready_file)
            // What is counted by `frames_per_commit`.
            .env("WAYPOST_LOG", "warn,waypost_server::service::map_writer=debug")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .kill_on_drop(true)
            .spawn()
            .map_err(|reason| EvalError::Read { path: program, reason })?;
        let mut server = Self { child, directory, address: String::new() };
        server.address = server.wait_until_ready(&ready_file).await?.grpc;
        Ok(server)
    }

    pub(super) fn endpoint(&self) -> String {
        format!("http://{}", self.address)
    }

    async fn create_map(&self, model_file: &Path) -> Result<(), EvalError> {
        let client = Client::connect(&self.endpoint()).await?;
        let file = tokio::fs::File::open(model_file).await;
        let file = file.map_err(|reason| EvalError::Read { path: model_file.to_owned(), reason })?;
        let model = client.import_model(MAP, file).await?;
        let request = v1::CreateMapRequest { map_id: MAP.to_owned(), model: model.name, settings: None };
        client.create_map(request).await?;
        Ok(())
    }

    async fn wait_until_ready(&mut self, ready_file: &Path) -> Result<Ready, EvalError> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let written = std::fs::read(ready_file).ok();
            if let Some(ready) = written.and_then(|text| serde_json::from_slice(&text).ok()) {
                return Ok(ready);
            }
            let ended = self.child.try_wait().map_err(|error| self.failed(error))?;
            if let Some(status) = ended {
                return Err(self.failed(format_args!("it ended before it listened ({status})")));
            }
            if Instant::now() > deadline {
                return Err(self.failed(format_args!("it does not listen after {} s", PATIENCE.as_secs())));
            }
            sleep(POLL).await;
        }
    }

    /// Memory that it has in RAM, in MiB.
    pub(super) fn rss_mib(&self) -> Result<f64, EvalError> {
        let status = self.proc_file("status")?;
        let kib = status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.trim().strip_suffix(" kB"));
        let kib: Option<f64> = kib.and_then(|kib| kib.trim().parse().ok());
        Ok(kib.ok_or_else(|| self.failed("its status does not tell its memory"))? / 1024.0)
    }

    /// Processor time that it has used so far, in seconds.
    pub(super) fn cpu_s(&self) -> Result<f64, EvalError> {
        cpu_s(&self.proc_file("stat")?).ok_or_else(|| self.failed("its statistics do not tell its time"))
    }

    /// Commits so far, and the frames in them, by its log.
    pub(super) fn commits(&self) -> Result<Commits, EvalError> {
        let path = self.log();
        let log = std::fs::read_to_string(&path).map_err(|reason| EvalError::Read { path, reason })?;
        Ok(Commits::of(&log))
    }

    /// Asks it to end, and waits until it has.
    pub(super) async fn stop(mut self) -> Result<(), EvalError> {
        self.end().await
    }

    async fn end(&mut self) -> Result<(), EvalError> {
        let status = match timeout(PATIENCE, self.terminate()).await {
            Ok(ended) => ended.map_err(|error| self.failed(error))?,
            Err(_elapsed) => {
                return Err(self.failed(format_args!("it did not end within {} s", PATIENCE.as_secs())));
            }
        };
        if status.success() { Ok(()) } else { Err(self.failed(format_args!("it ended badly ({status})"))) }
    }

    async fn terminate(&mut self) -> io::Result<std::process::ExitStatus> {
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

    fn proc_file(&self, name: &str) -> Result<String, EvalError> {
        let process = self.child.id().ok_or_else(|| self.failed("it has ended"))?;
        let path = PathBuf::from(format!("/proc/{process}/{name}"));
        std::fs::read_to_string(&path).map_err(|reason| EvalError::Read { path, reason })
    }

    fn log(&self) -> PathBuf {
        self.directory.path().join("log")
    }

    fn failed(&self, problem: impl std::fmt::Display) -> EvalError {
        let log = std::fs::read_to_string(self.log()).unwrap_or_default();
        let lines: Vec<&str> = log.lines().collect();
        let last = lines.get(lines.len().saturating_sub(LOG_LINES)..).unwrap_or_default();
        EvalError::Server { problem: problem.to_string(), log: last.join("\n") }
    }
}

/// Processor time that this program has used so far, in seconds.
pub(super) fn own_cpu_s() -> Result<f64, EvalError> {
    let path = PathBuf::from("/proc/self/stat");
    let unreadable = |reason| EvalError::Read { path: path.clone(), reason };
    let stat = std::fs::read_to_string(&path).map_err(unreadable)?;
    cpu_s(&stat).ok_or_else(|| unreadable(io::ErrorKind::InvalidData.into()))
}

/// User and system time of a process, by its `stat` file.
fn cpu_s(stat: &str) -> Option<f64> {
    // The second field, its name, may hold spaces; the times are fields 14 and 15.
    let (_, after_name) = stat.rsplit_once(')')?;
    let ticks = after_name.split_whitespace().skip(11).take(2).map(|ticks| ticks.parse::<f64>().ok());
    Some(ticks.sum::<Option<f64>>()? / TICKS_PER_SECOND)
}

fn program(options: &ServerOptions) -> Result<PathBuf, EvalError> {
    options.binary.clone().map_or_else(beside_this_program, Ok)
}

fn beside_this_program() -> Result<PathBuf, EvalError> {
    let this = std::env::current_exe();
    let this = this.map_err(|reason| EvalError::Read { path: PathBuf::from("waypost-eval"), reason })?;
    Ok(this.with_file_name("waypost-server"))
}

/// How frames were grouped on their way to the disk.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Commits {
    commits: u64,
    frames: u64,
}

impl Commits {
    /// By the server's log, of any format: each commit says `frames_committed` and their number.
    fn of(log: &str) -> Self {
        let numbers = log.lines().filter_map(|line| {
            let (_, after) = line.split_once("frames_committed")?;
            let digits = after.trim_start_matches(|character: char| !character.is_ascii_digit());
            digits.split(|character: char| !character.is_ascii_digit()).next()?.parse::<u64>().ok()
        });
        numbers.fold(Self::default(), |sum, frames| Self {
            commits: sum.commits + 1,
            frames: sum.frames + frames,
        })
    }

    /// `None` if there was no commit.
    pub(super) fn frames_per_commit(self) -> Option<f64> {
        (self.commits > 0).then(|| self.frames as f64 / self.commits as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_time_is_read_whatever_the_name() {
        let stat = "17 (a ) b) S 1 17 17 0 -1 4194560 90 0 0 0 250 50 0 0 20 0 4 0 100 1 2";
        assert_eq!(cpu_s(stat), Some(3.0));
        assert_eq!(cpu_s("17 (x) S"), Some(0.0));
        assert_eq!(cpu_s("no such thing"), None);
    }

    #[test]
    fn commits_are_counted_in_logs_of_either_format() {
        let log = "2026-01-01T00:00:00Z DEBUG waypost_server: frames_committed=3 map=\"load\"\n\
                   2026-01-01T00:00:01Z WARN waypost_server: something else 17\n\
                   {\"level\":\"DEBUG\",\"fields\":{\"frames_committed\":2,\"map\":\"load\"}}\n";
        assert_eq!(Commits::of(log), Commits { commits: 2, frames: 5 });
        assert_eq!(Commits::of(log).frames_per_commit(), Some(2.5));
        assert_eq!(Commits::of("").frames_per_commit(), None);
    }
}
