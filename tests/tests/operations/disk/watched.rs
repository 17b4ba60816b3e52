//! The real server over a disk that records its calls and fails when it is told to.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tempfile::TempDir;

use super::record::Record;
use crate::harness::{Built, ServerProcess, workspace};

/// The library that is loaded before the server: the C compiler is there, for SQLite is built with it.
static SHIM: LazyLock<(TempDir, PathBuf)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let library = folder.path().join("shim.so");
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let built = Command::new(&compiler)
        .args(["-shared", "-fPIC", "-O2", "-Wall", "-Wextra", "-Werror", "-o"])
        .arg(&library)
        .arg(workspace().join("tests/tests/operations/disk/shim.c"))
        .args(["-ldl", "-lpthread"])
        .output()
        .unwrap_or_else(|error| panic!("{compiler}: {error}"));
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    (folder, library)
});

/// Kinds of calls, by the letters that the library has for them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::operations) struct Calls(pub(super) &'static str);

impl Calls {
    /// Those that change something.
    pub(in crate::operations) const CHANGES: Self = Self("wstnud");
    pub(super) const ALL: Self = Self("wstnudor");
}

/// What becomes of a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::operations) enum How {
    /// It fails, and the next ones do not.
    Once,
    /// It fails, and so do all later ones.
    FromThenOn,
    /// Half of a write is done, and what follows to the same file fails.
    Short,
    /// The server is killed before it.
    Kill,
    /// The server is killed when half of a write is done.
    KillHalfway,
}

/// The n-th call from now on goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::operations) struct Fault {
    pub(in crate::operations) nth: u32,
    pub(in crate::operations) calls: Calls,
    pub(in crate::operations) how: How,
    /// Of a call that fails.
    pub(in crate::operations) error: i32,
}

/// The control file: what the library reads, and behind it what it tells.
const CONTROL_BYTES: usize = 48;
const TOLD_AT: u64 = 32;

pub(in crate::operations) struct WatchedDisk {
    folder: TempDir,
    control: File,
    generation: AtomicU64,
}

impl WatchedDisk {
    pub(in crate::operations) fn new() -> Self {
        let folder = super::scratch();
        std::fs::create_dir(folder.path().join("disk")).unwrap();
        let control = folder.path().join("control");
        std::fs::write(&control, [0; CONTROL_BYTES]).unwrap();
        let control = File::options().read(true).write(true).open(control).unwrap();
        Self { folder, control, generation: AtomicU64::new(0) }
    }

    /// What is watched, which is durable itself.
    pub(super) fn root(&self) -> PathBuf {
        self.folder.path().join("disk")
    }

    /// The server's data directory.
    pub(in crate::operations) fn data(&self) -> PathBuf {
        self.root().join("data")
    }

    fn record_file(&self) -> PathBuf {
        self.folder.path().join("record")
    }

    /// The server's program over this disk.
    pub(in crate::operations) fn command(&self) -> Command {
        let mut command = Built::command("waypost-server");
        command
            .env("LD_PRELOAD", &SHIM.1)
            .env("DISK_ROOT", self.root())
            .env("DISK_RECORD", self.record_file())
            .env("DISK_CONTROL", self.folder.path().join("control"));
        command
    }

    pub(in crate::operations) fn start(&self) -> ServerProcess {
        self.try_start().unwrap_or_else(|error| panic!("{error}"))
    }

    pub(in crate::operations) fn try_start(&self) -> Result<ServerProcess, String> {
        ServerProcess::start_command(self.command(), &self.data())
    }

    /// Bytes of the record so far: what has happened by now lies before them.
    pub(super) fn recorded(&self) -> u64 {
        std::fs::metadata(self.record_file()).map_or(0, |file| file.len())
    }

    /// The same, once the server is at rest: no call is on its way, and none comes.
    pub(super) async fn at_rest(&self) -> u64 {
        const REST: Duration = Duration::from_millis(4);
        loop {
            let before = self.recorded();
            tokio::time::sleep(REST).await;
            if self.recorded() == before && Record::read(&self.record_file()).has_no_sync_under_way() {
                return before;
            }
        }
    }

    pub(super) fn record(&self) -> Record {
        Record::read(&self.record_file())
    }

    pub(in crate::operations) fn arm(&self, Fault { nth, calls, how, error }: Fault) {
        let mask = calls.0.bytes().map(|letter| 1_u32 << (letter - b'a')).sum();
        let how = match how {
            How::Once => 1,
            How::FromThenOn => 2,
            How::Short => 3,
            How::Kill => 4,
            How::KillHalfway => 5,
        };
        self.control([nth, mask, error.cast_unsigned(), how]);
    }

    /// From now on nothing goes wrong.
    pub(in crate::operations) fn mend(&self) {
        self.control([0; 4]);
    }

    fn control(&self, words: [u32; 4]) {
        let generation = self.generation.fetch_add(1, Ordering::Relaxed) + 1;
        let mut bytes = [0; CONTROL_BYTES];
        bytes[..8].copy_from_slice(&generation.to_ne_bytes());
        for (word, to) in words.iter().zip(bytes[8..24].as_chunks_mut().0) {
            *to = word.to_ne_bytes();
        }
        self.control.write_all_at(&bytes, 0).unwrap();
    }

    /// Calls of the kinds that were told last, since then, and how many of them went wrong.
    pub(in crate::operations) fn counted(&self) -> (u64, u64) {
        let mut told = [0; 16];
        self.control.read_exact_at(&mut told, TOLD_AT).unwrap();
        let number = |bytes: &[u8]| u64::from_ne_bytes(bytes.try_into().unwrap());
        (number(&told[..8]), number(&told[8..]))
    }
}

/// The files below a folder, by their paths in it; none that SQLite makes anew.
pub(super) fn files_below(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        if entry.file_type().unwrap().is_dir() {
            let below = files_below(&entry.path()).into_iter();
            files.extend(below.map(|(path, bytes)| (format!("{name}/{path}"), bytes)));
        } else if !name.ends_with("-shm") {
            files.push((name, std::fs::read(entry.path()).unwrap()));
        }
    }
    files.sort();
    files
}

/// Copies the files below a folder into another, which is made.
pub(super) fn copy_below(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for (path, bytes) in files_below(from) {
        std::fs::write(to.join(path), bytes).unwrap();
    }
}
