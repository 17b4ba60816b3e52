//! The server under load: started for one measurement, watched from outside, and stopped.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use clap::Args;
use tempfile::TempDir;
use waypost_client::launch::{self, ServerProcess};
use waypost_client::{Client, v1};

use crate::files;

/// The map that all robots stream into, unless there are several.
pub(super) const MAP: &str = "load";

/// The name of one of several maps; of the first, [`MAP`].
pub(super) fn map_name(number: u32) -> String {
    if number == 0 { MAP.to_owned() } else { format!("{MAP}-{number}") }
}

/// The kernel counts processor time in hundredths of a second on every platform that Rust runs on.
const TICKS_PER_SECOND: f64 = 100.0;

/// The server that is put under load.
#[derive(Clone, Debug, Args)]
pub(in crate::commands) struct ServerOptions {
    /// The model that the server's map is made with.
    #[arg(long, global = true, value_name = "FILE", default_value = "demo/model.waypost")]
    pub(in crate::commands) model: PathBuf,
    /// The server [default: waypost-server beside this program].
    #[arg(long, global = true, value_name = "FILE")]
    pub(super) server_binary: Option<PathBuf>,
    /// Where it keeps maps, as postgres://USER@HOST/DATABASE: an empty database [default: a file of SQLite].
    #[arg(long, global = true, value_name = "URL")]
    pub(in crate::commands) storage: Option<String>,
    /// Where the server's data are kept; a temporary directory if `None`.
    #[arg(skip)]
    pub(super) kept: Option<PathBuf>,
}

/// What a server leaves behind.
enum Directory {
    Temporary(TempDir),
    Kept(PathBuf),
}

impl Directory {
    fn of(options: &ServerOptions) -> Result<Self> {
        match &options.kept {
            Some(kept) => {
                std::fs::create_dir_all(kept).map_err(files::not_written(kept))?;
                Ok(Self::Kept(kept.clone()))
            }
            None => {
                let made = tempfile::tempdir().map_err(files::not_written(&std::env::temp_dir()))?;
                Ok(Self::Temporary(made))
            }
        }
    }

    fn path(&self) -> &Path {
        match self {
            Self::Temporary(made) => made.path(),
            Self::Kept(kept) => kept,
        }
    }
}

/// A server on a temporary directory, with a map. Killed when dropped; [`stop`](Self::stop) lets it finish.
pub(super) struct ServerUnderLoad {
    server: ServerProcess,
    directory: Directory,
}

impl ServerOptions {
    /// A command of the server's program, which logs what `log` says.
    pub(in crate::commands) fn command(&self, log: &str) -> Result<Command> {
        let program = self.server_binary.clone().map_or_else(beside_this_program, Ok)?;
        let mut command = launch::command(program);
        command.env("WAYPOST_LOG", log);
        if let Some(storage) = &self.storage {
            command.args(["--storage", storage]);
        }
        Ok(command)
    }

    fn start_on(&self, directory: &Path) -> Result<ServerProcess> {
        // What is counted by `frames_per_commit`.
        let command = self.command("warn,waypost_server::open_map=debug")?;
        Ok(ServerProcess::start(command, &directory.join("data"), directory)?)
    }
}

impl ServerUnderLoad {
    /// Starts a server on free ports of the loopback interface and makes a map in it.
    pub(super) async fn start(options: &ServerOptions) -> Result<Self> {
        let directory = Directory::of(options)?;
        let server = options.start_on(directory.path())?;
        let client = answering(&server).await?;
        let file = tokio::fs::File::open(&options.model).await.map_err(files::not_read(&options.model))?;
        let model = client.import_model(MAP, file).await?;
        let request = v1::CreateMapRequest { map_id: MAP.to_owned(), model: model.name, settings: None };
        client.create_map(request).await?;
        Ok(Self { server, directory })
    }

    /// Makes maps beside the first, so that there are so many.
    pub(super) async fn make_maps(&self, maps: u32) -> Result<()> {
        let client = answering(&self.server).await?;
        let first = client.map(MAP, v1::MapView::Basic).await?;
        for number in 1..maps {
            let request = v1::CreateMapRequest {
                map_id: map_name(number),
                model: first.model.clone(),
                settings: first.settings,
            };
            client.create_map(request).await?;
        }
        Ok(())
    }

    /// Starts another one on the same storage, on a directory of its own.
    pub(super) async fn another(&self, options: &ServerOptions, number: u32) -> Result<Self> {
        let directory = Directory::Kept(self.directory.path().join(format!("server-{number}")));
        std::fs::create_dir_all(directory.path()).map_err(files::not_written(directory.path()))?;
        let server = options.start_on(directory.path())?;
        answering(&server).await?;
        Ok(Self { server, directory })
    }

    /// Lets it finish, and starts another on its directory.
    pub(super) fn restart(self, options: &ServerOptions) -> Result<Self> {
        self.server.stop()?;
        Ok(Self { server: options.start_on(self.directory.path())?, directory: self.directory })
    }

    /// Kills it, and starts another on its directory.
    pub(super) fn kill_and_restart(self, options: &ServerOptions) -> Result<Self> {
        self.server.kill();
        Ok(Self { server: options.start_on(self.directory.path())?, directory: self.directory })
    }

    /// Asks it to end, and waits until it has.
    pub(super) fn stop(self) -> Result<()> {
        Ok(self.server.stop()?)
    }

    pub(super) fn endpoint(&self) -> String {
        self.server.endpoint()
    }

    /// Where robots connect, as HOST:PORT.
    pub(super) fn address(&self) -> String {
        self.server.grpc().to_string()
    }

    /// Memory that it has in RAM, in MiB.
    pub(super) fn rss_mib(&self) -> Result<f64> {
        let bytes = self.server.rss_bytes().context("the system does not tell the server's memory")?;
        Ok(bytes as f64 / f64::from(1 << 20))
    }

    /// Processor time that it has used so far, in seconds.
    pub(super) fn cpu_s(&self) -> Result<f64> {
        cpu_s_of(&self.server.child().id().to_string())
    }

    /// Commits so far, and the frames in them, by its log.
    pub(super) fn commits(&self) -> Commits {
        Commits::of(&self.server.log())
    }
}

/// How long a server may take until it owns its database, and how often it is asked.
const OWNING: Duration = Duration::from_secs(20);
const ASKED_EVERY: Duration = Duration::from_millis(100);

/// A client of a server that answers: one over a database that others may own listens before it owns it, and cuts connections
/// when it does.
async fn answering(server: &ServerProcess) -> Result<Client> {
    let since = Instant::now();
    loop {
        let asked = async {
            let client = Client::connect(&server.endpoint()).await?;
            client.models().await?;
            Ok::<_, waypost_client::Error>(client)
        };
        match asked.await {
            Ok(client) => return Ok(client),
            Err(error) if since.elapsed() > OWNING => return Err(error.into()),
            Err(_not_yet) => tokio::time::sleep(ASKED_EVERY).await,
        }
    }
}

/// Processor time that a process, by its number or `self`, has used so far, in seconds.
pub(super) fn cpu_s_of(process: &str) -> Result<f64> {
    let stat = files::read(Path::new(&format!("/proc/{process}/stat")))?;
    cpu_s(&String::from_utf8_lossy(&stat)).context("the system does not tell processor time")
}

/// User and system time of a process, by its `stat` file.
fn cpu_s(stat: &str) -> Option<f64> {
    // The second field, its name, may hold spaces; the times are fields 14 and 15.
    let (_, after_name) = stat.rsplit_once(')')?;
    let ticks = after_name.split_whitespace().skip(11).take(2).map(|ticks| ticks.parse::<f64>().ok());
    Some(ticks.sum::<Option<f64>>()? / TICKS_PER_SECOND)
}

/// The server did not keep to the contract.
pub(super) fn breach(what: &str) -> anyhow::Error {
    anyhow!("the contract was broken: {what}; use a server of the same version")
}

fn beside_this_program() -> Result<PathBuf> {
    let this = std::env::current_exe();
    let this = this.context("this program does not know where it is; give --server-binary")?;
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
