//! The real binaries, as processes.

use std::ffi::OsStr;
use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::LazyLock;
use std::time::Duration;

use rustix::process::{Pid, Resource, Rlimit};
use tempfile::TempDir;
use waypost_client::{Client, launch};

use super::workspace;

/// Far more than a command takes that is to end: some stream whole drives, on machines that do much else.
const PATIENCE: Duration = Duration::from_secs(300);

/// The binaries of this very source, built with the profile that the tests were built with; those of the folder that
/// `WAYPOST_BINARIES` names, if it is set.
pub(crate) struct Built {
    directory: PathBuf,
}

static BUILT: LazyLock<Built> = LazyLock::new(|| {
    // Whoever has built them says where they are.
    if let Some(directory) = std::env::var_os("WAYPOST_BINARIES") {
        return Built { directory: directory.into() };
    }
    let test = std::env::current_exe().unwrap();
    // target/PROFILE/deps/TEST
    let directory = test.ancestors().nth(2).unwrap().to_owned();
    let profile = match directory.file_name().and_then(OsStr::to_str) {
        Some("debug") | None => "dev",
        Some(other) => other,
    };
    let mut cargo = Command::new(env!("CARGO"));
    // As `cargo build --workspace` outside of a test: what build scripts see of this test would have them run anew.
    for (name, _) in std::env::vars_os() {
        if name
            .to_str()
            .is_some_and(|name| name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_MANIFEST_"))
        {
            cargo.env_remove(name);
        }
    }
    let built = cargo
        .current_dir(workspace())
        .args(["build", "--quiet", "--profile", profile, "--workspace", "--bins"])
        .arg("--target-dir")
        .arg(directory.parent().unwrap())
        .status()
        .expect("cargo runs");
    assert!(built.success(), "the binaries do not build");
    Built { directory }
});

impl Built {
    /// A command that runs `waypost-server` or `waypost`, with no setting of the environment.
    pub(crate) fn command(binary: &str) -> Command {
        launch::command(BUILT.directory.join(binary))
    }
}

/// `waypost-server` in a process of its own. Killed when dropped.
pub(crate) struct ServerProcess {
    server: launch::ServerProcess,
    /// Ready file and log.
    _files: TempDir,
}

impl ServerProcess {
    /// Starts on free ports and waits until it serves.
    pub(crate) fn start(data_dir: &Path) -> Self {
        Self::start_with(data_dir, &[])
    }

    /// Starts with further options.
    pub(crate) fn start_with(data_dir: &Path, options: &[&str]) -> Self {
        let mut command = Built::command("waypost-server");
        command.args(options);
        Self::start_command(command, data_dir).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Starts a command that is [`Built`]; what it says if it does not serve.
    pub(crate) fn start_command(command: Command, data_dir: &Path) -> Result<Self, String> {
        let files = tempfile::tempdir().unwrap();
        let server = launch::ServerProcess::start(command, data_dir, files.path());
        Ok(Self { server: server.map_err(|error| error.to_string())?, _files: files })
    }

    pub(crate) async fn client(&self) -> Client {
        Client::connect(&self.endpoint()).await.unwrap()
    }

    /// From now on it can open so many files beyond those that it has open.
    pub(crate) fn limit_further_files(&self, further: u64) {
        let open = std::fs::read_dir(format!("/proc/{}/fd", self.child().id())).unwrap().count() as u64;
        let limit = Rlimit { current: Some(open + further), maximum: Some(open + further) };
        let process = Pid::from_child(self.child());
        let kept = rustix::process::prlimit(Some(process), Resource::Nofile, limit);
        assert!(kept.is_ok(), "{kept:?}");
    }

    /// Memory that it has in RAM.
    pub(crate) fn rss_bytes(&self) -> u64 {
        self.server.rss_bytes().expect("the system tells")
    }

    /// Sends SIGTERM and waits for nothing.
    pub(crate) fn ask_to_stop(&self) {
        assert!(self.server.ask_to_stop(), "SIGTERM was not sent");
    }

    /// `kill -9`.
    pub(crate) fn kill(self) {
        self.server.kill();
    }

    /// Stops it in good order, as an operator would.
    pub(crate) fn stop(self) {
        self.server.stop().unwrap_or_else(|error| panic!("{error}"));
    }
}

impl Deref for ServerProcess {
    type Target = launch::ServerProcess;

    fn deref(&self) -> &launch::ServerProcess {
        &self.server
    }
}

impl DerefMut for ServerProcess {
    fn deref_mut(&mut self) -> &mut launch::ServerProcess {
        &mut self.server
    }
}

/// Runs a command that is to end by itself.
pub(crate) fn run_to_its_end(mut command: Command) -> Output {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let reader = |mut pipe: Box<dyn std::io::Read + Send>| {
        std::thread::spawn(move || {
            let mut bytes = Vec::new();
            pipe.read_to_end(&mut bytes).unwrap();
            bytes
        })
    };
    let stdout = reader(Box::new(child.stdout.take().unwrap()));
    let stderr = reader(Box::new(child.stderr.take().unwrap()));
    let ended = launch::wait(&mut child, PATIENCE);
    if ended.is_none() {
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let (stdout, stderr) = (stdout.join().unwrap(), stderr.join().unwrap());
    let Some(status) = ended else {
        panic!("{command:?} did not end:\n{}", String::from_utf8_lossy(&stderr));
    };
    Output { status, stdout, stderr }
}
