//! A map out: read within one view of the database, while robots go on.

use std::time::Duration;

use fabmap::PlaceId;
use futures::stream::{self, BoxStream, StreamExt};
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::Snapshots;
use super::format::{MapRecord, Record, SnapshotWriter};
use crate::error::ServiceError;
use crate::names::map_in;
use crate::open_map::no_such_map;
use crate::storage::{EXPORTERS, MapView};

/// Largest piece that a snapshot is handed out in.
const CHUNK_BYTES: usize = 1 << 20;

/// Pieces that wait for the one who asked.
const QUEUE: usize = 2;

/// A view of the database that is held keeps the write-ahead log from being folded into the file, so
/// one who takes nothing for so long is given up.
const PATIENCE: Duration = Duration::from_secs(120);

impl Snapshots {
    /// A snapshot of a map as it is now, in pieces.
    pub(crate) async fn export(
        &self,
        name: &str,
    ) -> Result<BoxStream<'static, Result<Vec<u8>, ServiceError>>, ServiceError> {
        let map = map_in(name)?;
        let room = self.exports.clone().try_acquire_owned();
        let room = room.map_err(|_| ServiceError::ResourceExhausted {
            message: format!("{EXPORTERS} exports are under way already; try again when one has ended"),
        })?;
        let view = self.storage.view_map(map).await?.ok_or_else(|| no_such_map(map))?;
        let (chunks, taken) = mpsc::channel(QUEUE);
        let runtime = Handle::current();
        let stopping = self.stopping.clone();
        let outlet = Outlet { runtime, chunks, stopping, patience: PATIENCE };
        let writing = tokio::task::spawn_blocking(move || {
            let written = write(view, &outlet);
            drop(room);
            written
        });
        Ok(pieces(taken, writing))
    }
}

/// The pieces as they come; then the error, if the writing ended with one.
fn pieces(
    taken: mpsc::Receiver<Vec<u8>>,
    writing: JoinHandle<Result<(), ServiceError>>,
) -> BoxStream<'static, Result<Vec<u8>, ServiceError>> {
    let next = |under_way: Option<(mpsc::Receiver<Vec<u8>>, JoinHandle<_>)>| async move {
        let (mut taken, writing) = under_way?;
        if let Some(chunk) = taken.recv().await {
            return Some((Ok(chunk), Some((taken, writing))));
        }
        let ended = writing.await.map_err(ServiceError::internal).flatten();
        ended.err().map(|error| (Err(error), None))
    };
    stream::unfold(Some((taken, writing)), next).boxed()
}

/// Writes a snapshot of what the view shows. Blocks.
fn write(mut view: MapView, outlet: &Outlet) -> Result<(), ServiceError> {
    let runtime = &outlet.runtime;
    let mut writer = SnapshotWriter::new();
    let map = view.map().clone();
    outlet.put(
        &mut writer,
        &Record::Map(MapRecord {
            name: map.name,
            model: map.model,
            settings: map.settings,
            created_ns: map.created_ns,
        }),
    )?;
    let (display_name, file) = runtime.block_on(view.model())?;
    outlet.put(&mut writer, &Record::Model { display_name, file })?;
    for former_model in runtime.block_on(view.former_models())? {
        outlet.put(&mut writer, &Record::FormerModel(former_model))?;
    }
    for session in runtime.block_on(view.sessions())? {
        outlet.put(&mut writer, &Record::Session(session))?;
    }
    loop {
        let events = runtime.block_on(view.events())?;
        if events.is_empty() {
            break;
        }
        for (position, event) in events {
            outlet.put(&mut writer, &Record::Event { position, event })?;
        }
    }
    let mut after = None;
    loop {
        let media = runtime.block_on(view.media(after))?;
        let Some(last) = media.last() else { break };
        after = Some((last.position, last.kind));
        for medium in media {
            outlet.put(&mut writer, &Record::Medium(medium))?;
        }
    }
    let mut next = Some(PlaceId::new(0));
    while let Some(from) = next {
        let labels = runtime.block_on(view.labels(from))?;
        next = labels.last().and_then(|last| last.place.number().checked_add(1)).map(PlaceId::new);
        for label in labels {
            outlet.put(&mut writer, &Record::Label(label))?;
        }
    }
    let mut next = 0;
    loop {
        let notes = runtime.block_on(view.notes(next))?;
        let Some(last) = notes.last() else { break };
        next = last.position + 1;
        for note in notes {
            outlet.put(&mut writer, &Record::Note(note))?;
        }
    }
    outlet.hand_out(&writer.finish())
}

/// The way to the one who asked.
struct Outlet {
    runtime: Handle,
    chunks: mpsc::Sender<Vec<u8>>,
    stopping: CancellationToken,
    /// How long a piece may wait to be taken.
    patience: Duration,
}

impl Outlet {
    fn put(&self, writer: &mut SnapshotWriter, record: &Record) -> Result<(), ServiceError> {
        writer.record(record).map_err(ServiceError::internal)?;
        if writer.len() < CHUNK_BYTES { Ok(()) } else { self.hand_out(&writer.take()) }
    }

    fn hand_out(&self, bytes: &[u8]) -> Result<(), ServiceError> {
        bytes.chunks(CHUNK_BYTES).try_for_each(|chunk| self.runtime.block_on(self.send(chunk.to_vec())))
    }

    async fn send(&self, chunk: Vec<u8>) -> Result<(), ServiceError> {
        let sent = tokio::select! {
            sent = tokio::time::timeout(self.patience, self.chunks.send(chunk)) => sent,
            () = self.stopping.cancelled() => return Err(ServiceError::stopping()),
        };
        match sent {
            Ok(Ok(())) => Ok(()),
            // There is nobody to hear it.
            Ok(Err(_)) => {
                Err(ServiceError::unavailable("the export was given up by the one who asked for it"))
            }
            Err(_) => Err(ServiceError::Aborted {
                message: format!(
                    "nothing of the export was taken for {} s, so it was ended; export again, and read faster",
                    self.patience.as_secs()
                ),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An outlet that is written to on a thread that may block, as an export does.
    fn export(
        patience: Duration,
        stopping: &CancellationToken,
    ) -> BoxStream<'static, Result<Vec<u8>, ServiceError>> {
        let (chunks, taken) = mpsc::channel(QUEUE);
        let outlet = Outlet { runtime: Handle::current(), chunks, stopping: stopping.clone(), patience };
        let writing = tokio::task::spawn_blocking(move || outlet.hand_out(&vec![7; CHUNK_BYTES * 10 + 3]));
        pieces(taken, writing)
    }

    #[tokio::test]
    async fn all_of_it_is_handed_out_in_pieces() {
        let chunks: Vec<_> = export(PATIENCE, &CancellationToken::new()).collect().await;
        let lengths: Vec<usize> = chunks.into_iter().map(|chunk| chunk.unwrap().len()).collect();
        assert_eq!(lengths, [vec![CHUNK_BYTES; 10], vec![3]].concat());
    }

    #[tokio::test]
    async fn one_who_takes_nothing_is_given_up_and_told() {
        let stalled = export(Duration::from_millis(30), &CancellationToken::new());
        tokio::time::sleep(Duration::from_millis(300)).await;
        let mut chunks: Vec<_> = stalled.collect().await;
        let last = chunks.pop().unwrap();
        assert!(
            matches!(&last, Err(ServiceError::Aborted { message }) if message.contains("export again")),
            "{last:?}"
        );
        assert_eq!(chunks.len(), QUEUE);
    }

    #[tokio::test]
    async fn a_stop_ends_it() {
        let stopping = CancellationToken::new();
        let stopped = export(PATIENCE, &stopping);
        stopping.cancel();
        let chunks: Vec<_> = stopped.collect().await;
        assert_eq!(chunks.last(), Some(&Err(ServiceError::stopping())));
    }
}
