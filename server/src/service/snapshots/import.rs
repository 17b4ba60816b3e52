//! A map in: spooled to the disk, checked as a whole, then stored piece by piece.

use std::fs::File;
use std::io::{self, BufReader, Write};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use tokio::runtime::Handle;
use tokio::sync::OwnedSemaphorePermit;
use topomap::log::MapEvent;

use super::Snapshots;
use super::check::{NotTaken, check, map_of, reader};
use super::format::{Record, SnapshotReader};
use crate::error::ServiceError;
use crate::names::{check_id, map_name};
use crate::role::Reach;
use crate::service::jobs::{JobOutcome, JobReporter, JobRequest, JobStatus};
use crate::service::map_names::{Reservation, map_exists};
use crate::service::tokens::Caller;
use crate::storage::{ImportedMap, JobKind, LabelRow, MapId, MediaRow, NoteRow, Storage, StorageError};

/// Largest snapshot that is taken in.
const MAX_SNAPSHOT_BYTES: u64 = 16 << 30;

/// Largest piece that one is taken in by.
const MAX_CHUNK_BYTES: usize = 1 << 20;

/// Imports that may upload, wait or run at the same time.
pub(super) const MAX_IMPORTS: usize = 3;

/// An import leaves so much of the disk to the robots.
const RESERVED_BYTES: u64 = 64 << 20;

/// An import commits as soon as it has so much, so that other maps' commits get their turn.
const PIECE_BYTES: usize = 2 << 20;
const PIECE_ROWS: usize = 500;

/// A snapshot as it comes in.
#[derive(Debug)]
pub(crate) struct MapUpload {
    /// The name asked for, if any.
    reservation: Option<Reservation>,
    /// The token that the map is to count for.
    owner: Option<String>,
    /// It has no name in the file system, so it goes with its holder, however that ends.
    spool: Arc<File>,
    bytes: u64,
    room: OwnedSemaphorePermit,
}

/// What the job of an import works on.
struct Import {
    reservation: Reservation,
    spool: Arc<File>,
    bytes: u64,
    _room: OwnedSemaphorePermit,
}

impl Snapshots {
    /// Begins to take in a snapshot: then its bytes, then [`Snapshots::start_import`]. An empty name
    /// leaves the one in the file.
    pub(crate) async fn begin_import(&self, caller: &Caller, map: &str) -> Result<MapUpload, ServiceError> {
        let reservation = match map {
            "" if caller.reach != Reach::Everywhere => {
                return Err(ServiceError::invalid(format_args!(
                    "your token is for {} alone, and the name in the file may be another: name the map that it is to be",
                    caller.reach
                )));
            }
            "" => None,
            map => {
                caller.check_map(check_id("map name", map)?)?;
                Some(self.names.reserve(map, caller.token.as_deref()).await?)
            }
        };
        let room = self.uploads.clone().try_acquire_owned();
        let room = room.map_err(|_| ServiceError::ResourceExhausted {
            message: format!("{MAX_IMPORTS} imports are under way already; try again when one has ended"),
        })?;
        let directory = self.storage.directory().to_owned();
        let spool = tokio::task::spawn_blocking(move || {
            check_room(&directory, 0)?;
            tempfile::tempfile_in(directory).map_err(disk_error)
        });
        let spool = Arc::new(spool.await.map_err(ServiceError::internal)??);
        Ok(MapUpload { reservation, owner: caller.token.clone(), spool, bytes: 0, room })
    }

    /// Takes the next bytes of a snapshot.
    pub(crate) async fn add_bytes(&self, upload: &mut MapUpload, chunk: Vec<u8>) -> Result<(), ServiceError> {
        if chunk.len() > MAX_CHUNK_BYTES {
            return Err(ServiceError::invalid(format_args!(
                "a chunk has at most {MAX_CHUNK_BYTES} bytes, not {}; send the file in smaller ones",
                chunk.len()
            )));
        }
        upload.bytes += chunk.len() as u64;
        if upload.bytes > MAX_SNAPSHOT_BYTES {
            return Err(ServiceError::ResourceExhausted {
                message: format!("a snapshot has at most {MAX_SNAPSHOT_BYTES} bytes; export a smaller map"),
            });
        }
        let spool = upload.spool.clone();
        let directory = self.storage.directory().to_owned();
        let write = move || {
            check_room(&directory, chunk.len() as u64)?;
            (&*spool).write_all(&chunk).map_err(disk_error)
        };
        tokio::task::spawn_blocking(write).await.map_err(ServiceError::internal)?
    }

    /// Checks a snapshot that has come in, and stores it, as a job.
    pub(crate) async fn start_import(&self, upload: MapUpload) -> Result<JobStatus, ServiceError> {
        let MapUpload { reservation, owner, spool, bytes, room } = upload;
        // What is no snapshot at all is refused at once.
        let peeked = spool.clone();
        let map =
            tokio::task::spawn_blocking(move || map_of(&peeked)).await.map_err(ServiceError::internal)?;
        let map = map.map_err(|not_taken| match not_taken {
            NotTaken::Refused(error) => error,
            NotTaken::Cancelled => ServiceError::Internal,
        })?;
        let reservation = match reservation {
            Some(reservation) => reservation,
            None => self.names.reserve(check_id("map name", &map.name)?, owner.as_deref()).await?,
        };
        let name = reservation.name().to_owned();
        let import = Import { reservation, spool, bytes, _room: room };
        let snapshots = self.clone();
        let work = move |reporter: JobReporter| async move { snapshots.import(import, &reporter).await };
        self.jobs.start(JobRequest::of_this_server(JobKind::ImportMap, &[&name]), work).await
    }

    async fn import(&self, import: Import, reporter: &JobReporter) -> JobOutcome {
        let Some(_turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
        let checked = match self.check_snapshot(&import, reporter).await {
            Ok(checked) => checked,
            Err(NotTaken::Cancelled) => return JobOutcome::Cancelled,
            Err(NotTaken::Refused(error)) => return JobOutcome::Failed(error),
        };
        let owner = import.reservation.owner();
        let map = match self.storage.begin_import(&checked, owner, reporter.number()).await {
            Ok(map) => map,
            Err(StorageError::Exists) => return JobOutcome::Failed(map_exists(&checked.name)),
            Err(error) => return JobOutcome::Failed(error.into()),
        };
        let ended = match self.store_log(map, &import, checked.model.words as usize, reporter).await {
            Ok(()) => {
                let end = reporter.succeeded(map_name(&checked.name));
                match self.storage.finish_import(map, &end).await {
                    Ok(()) => return JobOutcome::Stored(end),
                    Err(error) => JobOutcome::Failed(error.into()),
                }
            }
            Err(NotTaken::Cancelled) => JobOutcome::Cancelled,
            Err(NotTaken::Refused(error)) => JobOutcome::Failed(error),
        };
        self.deleted_maps.give_up_import(map).await;
        ended
    }

    async fn check_snapshot(&self, import: &Import, reporter: &JobReporter) -> Result<ImportedMap, NotTaken> {
        let spool = import.spool.clone();
        let bytes = import.bytes;
        let reporter = reporter.clone();
        let name = import.reservation.name().to_owned();
        let directory = self.storage.directory().to_owned();
        let work = move || {
            // It is read twice.
            let mut passed = 0;
            let mut last = 0;
            let mut progress = |read: u64| {
                if read < last {
                    passed = bytes;
                }
                last = read;
                reporter.progress("checking the snapshot", (passed + read) as f64 / (2 * bytes) as f64)
            };
            let checked = check(&spool, &name, &mut progress)?;
            // Its rows take about as much room as the file.
            check_room(&directory, bytes)?;
            Ok(checked)
        };
        tokio::task::spawn_blocking(work).await.map_err(ServiceError::internal)?
    }

    /// Stores log, media, labels and notes, piece by piece.
    async fn store_log(
        &self,
        map: MapId,
        import: &Import,
        words: usize,
        reporter: &JobReporter,
    ) -> Result<(), NotTaken> {
        let spool = import.spool.clone();
        let bytes = import.bytes;
        let reporter = reporter.clone();
        let storage = self.storage.clone();
        let runtime = Handle::current();
        let work = move || {
            let mut snapshot = reader(&spool)?;
            while let Some(piece) = next_piece(&mut snapshot, words)? {
                let fraction = snapshot.bytes() as f64 / bytes as f64;
                if reporter.progress("storing the map", fraction) == ControlFlow::Break(()) {
                    return Err(NotTaken::Cancelled);
                }
                runtime.block_on(store_piece(&storage, map, &piece))?;
            }
            // The last moment to stop.
            match reporter.progress("storing the map", 1.0) {
                ControlFlow::Continue(()) => Ok(()),
                ControlFlow::Break(()) => Err(NotTaken::Cancelled),
            }
        };
        tokio::task::spawn_blocking(work).await.map_err(ServiceError::internal)?
    }
}

async fn store_piece(storage: &Storage, map: MapId, piece: &Piece) -> Result<(), ServiceError> {
    Ok(storage.import_piece(map, &piece.events, &piece.media, &piece.labels, &piece.notes).await?)
}

/// What is stored in one transaction.
#[derive(Default)]
struct Piece {
    /// By position.
    events: Vec<(u64, MapEvent)>,
    media: Vec<MediaRow>,
    labels: Vec<LabelRow>,
    notes: Vec<NoteRow>,
}

impl Piece {
    fn rows(&self) -> usize {
        let Self { events, media, labels, notes } = self;
        events.len() + media.len() + labels.len() + notes.len()
    }
}

/// The next events, media, labels and notes; none at the end.
fn next_piece(
    snapshot: &mut SnapshotReader<BufReader<&File>>,
    words: usize,
) -> Result<Option<Piece>, NotTaken> {
    let mut piece = Piece::default();
    let begin = snapshot.bytes();
    let is_full = |piece: &Piece, read: u64| piece.rows() >= PIECE_ROWS || read - begin >= PIECE_BYTES as u64;
    while let Some(record) = snapshot.next()? {
        match record {
            Record::Map(_) | Record::Model { .. } | Record::FormerModel(_) | Record::Session(_) => continue,
            Record::Event { position, event } => {
                // Decoded once already.
                let event = MapEvent::from_bytes(&event, words).map_err(ServiceError::internal)?;
                piece.events.push((position, event));
            }
            Record::Medium(medium) => piece.media.push(medium),
            Record::Label(label) => piece.labels.push(label),
            Record::Note(note) => piece.notes.push(note),
        }
        if is_full(&piece, snapshot.bytes()) {
            break;
        }
    }
    Ok((piece.rows() > 0).then_some(piece))
}

/// Refuses what would leave too little of the disk.
fn check_room(directory: &Path, bytes: u64) -> Result<(), ServiceError> {
    let disk = rustix::fs::statvfs(directory).map_err(ServiceError::internal)?;
    let free = disk.f_bavail.saturating_mul(disk.f_frsize);
    if free < bytes.saturating_add(RESERVED_BYTES) {
        return Err(ServiceError::disk_full(format_args!(
            "{free} bytes are free, an import needs {bytes} more"
        )));
    }
    Ok(())
}

fn disk_error(error: io::Error) -> ServiceError {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => ServiceError::disk_full(error),
        _ => ServiceError::internal(error),
    }
}
