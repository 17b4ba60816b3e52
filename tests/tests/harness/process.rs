//! The real binaries, as processes.

use std::ffi::OsStr;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Resource, Rlimit};
use serde_json::Value;
use tempfile::TempDir;
use waypost_client::Client;

use super::workspace;

/// Far more than a start or a stop takes.
const PATIENCE: Duration = Duration::from_secs(60);
const POLL: Duration = Duration::from_millis(5);

/// The binaries of this very source, built with the profile that the tests were built with.
pub(crate) struct Built {
    directory: PathBuf,
}

static BUILT: LazyLock<Built> = LazyLock::new(|| {
    let test = std::env::current_exe().unwrap();
    // target/PROFILE/deps/TEST
    let directory = test.ancestors().nth(2).unwrap().to_owned();
    let profile = match directory.file_name().and_then(OsStr::to_str) {
        Some("debug") | None => "dev",
        Some(other) => other,
    };
    let built = Command::new(env!("CARGO"))
        .current_dir(workspace())
        .args([
            "build",
            "--quiet",
            "--profile",
            profile,
            "-p",
            "waypost-server",
            "-p",
            "waypost-client",
            "--bins",
            "--features",
            "waypost-client/words,waypost-client/demo",
        ])
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
        let mut command = Command::new(BUILT.directory.join(binary));
        for (name, _) in
            std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("WAYPOST_"))
        {
            command.env_remove(name);
        }
        command.stdin(Stdio::null());
        command
    }
}

/// `waypost-server` in a process of its own. Killed when dropped.
pub(crate) struct ServerProcess {
    child: Child,
    grpc: SocketAddr,
    http: SocketAddr,
    /// Ready file and log.
    files: TempDir,
}

impl ServerProcess {
    /// Starts on free ports and waits until it serves.
    pub(crate) fn start(data_dir: &Path) -> Self {
        Self::start_with(data_dir, &[])
    }

    /// Starts with further options.
    pub(crate) fn start_with(data_dir: &Path, options: &[&str]) -> Self {
        let files = tempfile::tempdir().unwrap();
        let ready = files.path().join("ready.json");
        let log = std::fs::File::create(files.path().join("log")).unwrap();
        let mut child = Built::command("waypost-server")
            .args(["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0"])
            .args(options)
            .arg("--data-dir")
            .arg(data_dir)
            .arg("--ready-file")
            .arg(&ready)
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .unwrap();
        let deadline = Instant::now() + PATIENCE;
        while !ready.exists() {
            let ended = child.try_wait().unwrap();
            if ended.is_some() || Instant::now() > deadline {
                let log = std::fs::read_to_string(files.path().join("log")).unwrap();
                let _ = child.kill();
                let _ = child.wait();
                panic!("the server did not start ({ended:?}):\n{log}");
            }
            std::thread::sleep(POLL);
        }
        let addresses: Value = serde_json::from_slice(&std::fs::read(&ready).unwrap()).unwrap();
        let address = |of: &str| addresses[of].as_str().unwrap().parse().unwrap();
        Self { grpc: address("grpc"), http: address("http"), child, files }
    }

    pub(crate) fn grpc(&self) -> SocketAddr {
        self.grpc
    }

    pub(crate) fn http(&self) -> SocketAddr {
        self.http
    }

    pub(crate) fn endpoint(&self) -> String {
        format!("http://{}", self.grpc)
    }

    pub(crate) async fn client(&self) -> Client {
        Client::connect(&self.endpoint()).await.unwrap()
    }

    /// Memory that it has in RAM.
    pub(crate) fn rss_bytes(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let kib = status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.trim().strip_suffix(" kB"));
        1024 * kib.expect("the system tells").parse::<u64>().unwrap()
    }

    /// From now on it can open so many files beyond those that it has open.
    pub(crate) fn limit_further_files(&self, further: u64) {
        let open = std::fs::read_dir(format!("/proc/{}/fd", self.child.id())).unwrap().count() as u64;
        let limit = Rlimit { current: Some(open + further), maximum: Some(open + further) };
        let process = Pid::from_child(&self.child);
        let kept = rustix::process::prlimit(Some(process), Resource::Nofile, limit);
        assert!(kept.is_ok(), "{kept:?}");
    }

    /// What it logged so far.
    pub(crate) fn log(&self) -> String {
        std::fs::read_to_string(self.files.path().join("log")).unwrap()
    }

    pub(crate) fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// `kill -9`.
    pub(crate) fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Asks it to stop in good order (SIGTERM); `None` if it does not within `patience`.
    pub(crate) fn terminate(&mut self, patience: Duration) -> Option<ExitStatus> {
        self.ask_to_stop();
        wait(&mut self.child, patience)
    }

    /// Sends SIGTERM and waits for nothing.
    pub(crate) fn ask_to_stop(&self) {
        // The shell's own `kill`: a machine need not have the program.
        let sent =
            Command::new("sh").arg("-c").arg(format!("kill -TERM {}", self.child.id())).status().unwrap();
        assert!(sent.success(), "SIGTERM was not sent");
    }

    /// Stops it in good order, as an operator would.
    pub(crate) fn stop(mut self) {
        let status = self.terminate(PATIENCE);
        assert!(status.is_some_and(|status| status.success()), "stopped with {status:?}:\n{}", self.log());
    }
}

impl Drop for ServerProcess {
    fn drop(&mut self) {
        // An error means that it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
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
    let ended = wait(&mut child, PATIENCE);
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

fn wait(child: &mut Child, patience: Duration) -> Option<ExitStatus> {
    let deadline = Instant::now() + patience;
    loop {
        match child.try_wait().unwrap() {
            Some(status) => return Some(status),
            None if Instant::now() > deadline => return None,
            None => std::thread::sleep(POLL),
        }
    }
}
