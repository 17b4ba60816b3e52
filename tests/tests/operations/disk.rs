//! What the disk may do to a server: power that goes away at any moment, calls that fail, a process that is killed at any
//! call. Nothing that was acknowledged is lost by it, and nothing is there twice or otherwise.
//!
//! `watched` runs the real server over a library that records its calls (`shim.c`), `record` reads what it recorded, and
//! `simulated` makes of that what a disk may hold after its power went. `history` knows what the database held commit by commit.

mod contents;
mod history;
mod io_errors;
mod kills;
mod power_cuts;
mod record;
mod script;
mod simulated;
pub(super) mod watched;

/// A folder for many files that nobody keeps: in memory, where there is room for them.
pub(super) fn scratch() -> tempfile::TempDir {
    const ROOM_BYTES: u64 = 2 << 30;
    let memory = std::path::Path::new("/dev/shm");
    let room = rustix::fs::statvfs(memory).is_ok_and(|disk| disk.f_bavail * disk.f_frsize > ROOM_BYTES);
    if room { tempfile::tempdir_in(memory) } else { tempfile::tempdir() }.unwrap()
}

/// Does what also blocks on a thread of its own.
pub(super) fn on_a_thread<T: Send + 'static, W: Future<Output = T>>(
    work: impl FnOnce() -> W + Send + 'static,
) -> tokio::task::JoinHandle<T> {
    let runtime = tokio::runtime::Handle::current();
    tokio::task::spawn_blocking(move || runtime.block_on(work()))
}
