//! Events of several maps that are ready at once go to the disk in one transaction.
//!
//! A disk syncs so many times a second, and a database has one connection that writes: a transaction for each map would
//! have maps wait for one another. So whoever gets the connection takes along what all others have ready by then.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sqlx::pool::PoolConnection;
use sqlx::{Any, Connection, Transaction};
use tokio::sync::oneshot;

use super::damage::Where;
use super::kept::{KeptByOwner, KeptBySession, add_kept};
use super::log::LogEntry;
use super::media::{Medium, Whose, insert_medium, kept_bytes};
use super::new_events::{NewEvent, insert_events};
use super::notes::insert_note;
use super::objects::ObjectRef;
use super::values::to_sql;
use super::{MapId, Storage, StorageError};
use crate::quotas::Used;

/// Events that share a transaction, unless one map has more of them by itself. What the first is told waits for the last.
const MOST_EVENTS: usize = 256;

/// What waits for the connection that writes, in the order in which it came.
#[derive(Debug, Default)]
pub(super) struct Waiting(Mutex<Queue>);

#[derive(Debug, Default)]
struct Queue {
    appends: Vec<Append>,
    next_number: u64,
}

/// Events of one map.
#[derive(Debug)]
struct Append {
    number: u64,
    map: MapId,
    entries: Arc<[LogEntry]>,
    objects: Arc<Outside>,
    done: oneshot::Sender<Shared>,
}

/// For each event, and each of its media, the object that it was put to, if it is not in the database.
type Outside = Vec<Vec<Option<ObjectRef>>>;

/// What a transaction that others had a part in came to, for one of them.
#[derive(Debug)]
enum Shared {
    Stored,
    Failed(StorageError),
    /// Nothing of it is stored, and it need not be the fault of this one.
    TryAlone,
}

/// Where a transaction failed.
enum Failure {
    /// Before its end: nothing of it is stored.
    Before(StorageError),
    /// At its end: nobody knows.
    AtTheEnd(StorageError),
}

impl Storage {
    /// Appends events to a map's log, all or none, and returns when they are on the disk.
    pub(crate) async fn append(&self, map: MapId, entries: Arc<[LogEntry]>) -> Result<(), StorageError> {
        self.check_sound(map)?;
        let objects = Arc::new(self.put_media(map, &entries).await?);
        let appended = match self.append_together(map, &entries, &objects).await {
            Shared::Stored => Ok(()),
            Shared::Failed(error) => Err(error),
            Shared::TryAlone => self.append_alone(map, &entries, &objects).await,
        };
        self.noting_rot(map, Where::Somewhere, appended).await?;
        self.commits.tell(map);
        Ok(())
    }

    /// Before any row names them.
    async fn put_media(&self, map: MapId, entries: &[LogEntry]) -> Result<Outside, StorageError> {
        let media = entries.iter().flat_map(|entry| &entry.media);
        let contents: Vec<&[u8]> = media.map(|medium| medium.content.as_slice()).collect();
        let mut objects = self.put_outside(map, &contents).await?.into_iter();
        Ok(entries.iter().map(|entry| objects.by_ref().take(entry.media.len()).collect()).collect())
    }

    async fn append_together(&self, map: MapId, entries: &Arc<[LogEntry]>, objects: &Arc<Outside>) -> Shared {
        let (done, mut told) = oneshot::channel();
        let number = self.waiting.push(map, entries.clone(), objects.clone(), done);
        loop {
            let connection = tokio::select! {
                biased;
                // Who had it in hand never goes without a word, unless it panics.
                told = &mut told => return told.unwrap_or(Shared::Failed(StorageError::Abandoned)),
                connection = self.writing_connection() => connection,
            };
            match connection {
                // In a task of its own: others depend on it, should this one be given up.
                Ok(connection) => drop(tokio::spawn(self.clone().append_waiting(connection)).await),
                // If somebody else has it in hand, they tell what becomes of it.
                Err(error) if self.waiting.take_back(number) => return Shared::Failed(error),
                Err(_) => {}
            }
        }
    }

    /// Appends what waits, and tells everybody what became of it.
    async fn append_waiting(self, mut connection: PoolConnection<Any>) {
        let appends = self.waiting.take();
        let Err(failure) = self.append_all(&mut connection, &appends).await else {
            appends.into_iter().for_each(|append| append.tell(Shared::Stored));
            return;
        };
        connection.close_on_drop();
        drop(connection);
        for append in appends {
            append.tell(match &failure {
                Failure::Before(error) => error.befalls_all().map_or(Shared::TryAlone, Shared::Failed),
                Failure::AtTheEnd(error) => {
                    Shared::Failed(error.befalls_all().unwrap_or_else(|| StorageError::held_up(error)))
                }
            });
        }
    }

    async fn append_all(
        &self,
        connection: &mut PoolConnection<Any>,
        appends: &[Append],
    ) -> Result<(), Failure> {
        let before = |error: sqlx::Error| Failure::Before(error.into());
        let mut transaction = connection.begin().await.map_err(before)?;
        let entries: Vec<New<'_>> = appends
            .iter()
            .flat_map(|append| new_entries(append.map, &append.entries, &append.objects))
            .collect();
        let inserted = async {
            self.engine.fence(&mut transaction).await?;
            insert(&mut transaction, &entries).await
        };
        let kept = inserted.await.map_err(Failure::Before)?;
        transaction.commit().await.map_err(|error| Failure::AtTheEnd(error.into()))?;
        self.count(&kept);
        Ok(())
    }

    async fn append_alone(
        &self,
        map: MapId,
        entries: &[LogEntry],
        objects: &Outside,
    ) -> Result<(), StorageError> {
        let entries: Vec<New<'_>> = new_entries(map, entries, objects).collect();
        let insert = async |transaction: &mut Transaction<'_, Any>| insert(transaction, &entries).await;
        self.write_and(insert, async |_, kept| self.count(kept)).await.map(drop)
    }

    fn count(&self, kept: &KeptByOwner) {
        for (owner, kept_bytes) in kept {
            self.quotas.add(owner.as_deref(), Used { kept_bytes: *kept_bytes, ..Used::default() });
        }
    }
}

impl Waiting {
    /// The number by which it can be taken back.
    fn push(
        &self,
        map: MapId,
        entries: Arc<[LogEntry]>,
        objects: Arc<Outside>,
        done: oneshot::Sender<Shared>,
    ) -> u64 {
        let mut queue = self.queue();
        let number = queue.next_number;
        queue.next_number += 1;
        queue.appends.push(Append { number, map, entries, objects, done });
        number
    }

    /// Those that came first.
    fn take(&self) -> Vec<Append> {
        let mut queue = self.queue();
        let mut events = 0;
        let fit = queue.appends.iter().take_while(|append| {
            let is_first = events == 0;
            events += append.entries.len();
            is_first || events <= MOST_EVENTS
        });
        let fit = fit.count();
        queue.appends.drain(..fit).collect()
    }

    /// Whether it was still there.
    fn take_back(&self, number: u64) -> bool {
        let mut queue = self.queue();
        let before = queue.appends.len();
        queue.appends.retain(|append| append.number != number);
        queue.appends.len() < before
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Append {
    fn tell(self, shared: Shared) {
        // Who does not wait any more need not know.
        let _ = self.done.send(shared);
    }
}

/// An event that is to be stored.
struct New<'a> {
    map: MapId,
    entry: &'a LogEntry,
    /// Of its media, in their order.
    objects: &'a [Option<ObjectRef>],
}

fn new_entries<'a>(
    map: MapId,
    entries: &'a [LogEntry],
    objects: &'a Outside,
) -> impl Iterator<Item = New<'a>> {
    entries.iter().zip(objects).map(move |(entry, objects)| New { map, entry, objects })
}

/// Stores events with what is kept beside them; what each owner of sessions keeps more by it.
async fn insert(
    transaction: &mut Transaction<'_, Any>,
    entries: &[New<'_>],
) -> Result<KeptByOwner, StorageError> {
    let events: Vec<NewEvent<'_>> = entries
        .iter()
        .map(|New { map, entry, .. }| NewEvent { map: *map, position: entry.position, event: &entry.event })
        .collect();
    let lengths = insert_events(transaction, &events).await?;
    let mut kept = KeptBySession::new();
    for (New { map, entry, objects }, bytes) in entries.iter().zip(lengths) {
        let LogEntry { position, event, media, note } = entry;
        for (Medium { kind, content }, object) in media.iter().zip(*objects) {
            let whose = Whose { map: *map, frame: *position, kind: *kind };
            insert_medium(transaction, whose, content, object.as_ref()).await?;
        }
        insert_note(transaction, *map, to_sql(*position), note).await?;
        *kept.entry((*map, event.session())).or_default() += bytes + kept_bytes(media);
    }
    add_kept(transaction, &kept).await
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use sqlx::AssertSqlSafe;
    use topomap::log::MapEvent;

    use super::*;

    fn opened(position: u64) -> Arc<[LogEntry]> {
        let event = MapEvent::SessionOpened { session: 0 };
        Arc::from([LogEntry { position, event, media: Vec::new(), note: String::new() }])
    }

    /// Storage with that many maps, numbered from 1 on, each with a session.
    async fn with_maps(directory: &std::path::Path, maps: i64) -> Storage {
        let storage = Storage::open(directory).await.unwrap();
        let model = "INSERT INTO models (hash, display_name, extractor, words, samples, words_hash, size_bytes, created_ns, file) \
             VALUES ('m', '', '', 1, 0, 'w', 1, 1, x'00')";
        sqlx::query(model).execute(&storage.writer).await.unwrap();
        for map in 1..=maps {
            for statement in [
                format!(
                    "INSERT INTO maps (id, name, model, settings, created_ns) VALUES ({map}, 'm{map}', 'm', '{{}}', 1)"
                ),
                format!(
                    "INSERT INTO sessions (map_id, number, name, opened_ns) VALUES ({map}, 0, 'first', 1)"
                ),
            ] {
                sqlx::query(AssertSqlSafe(statement)).execute(&storage.writer).await.unwrap();
            }
        }
        storage
    }

    async fn events(storage: &Storage, map: MapId) -> i64 {
        let count = sqlx::query_scalar("SELECT count(*) FROM log WHERE map_id = $1").bind(map);
        count.fetch_one(&storage.readers).await.unwrap()
    }

    /// While somebody writes, all others come to wait for one transaction. One that cannot be stored is told so, and the
    /// others are stored.
    #[tokio::test]
    async fn what_waits_is_stored_together_and_fails_alone() {
        const MAPS: i64 = 12;
        let directory = tempfile::tempdir().unwrap();
        let storage = with_maps(directory.path(), MAPS).await;
        storage.append(3, opened(0)).await.unwrap();
        for (position, bad) in [(0, Some(3)), (1, None)] {
            let writing = storage.writer.acquire().await.unwrap();
            let appends: Vec<_> = (1..=MAPS)
                .map(|map| {
                    let storage = storage.clone();
                    tokio::spawn(async move { storage.append(map, opened(position)).await })
                })
                .collect();
            while storage.waiting.queue().appends.len() < MAPS as usize {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
            drop(writing);
            for (map, append) in (1..).zip(appends) {
                match append.await.unwrap() {
                    Ok(()) => assert_ne!(Some(map), bad),
                    Err(error) => {
                        assert!(matches!(error, StorageError::Exists) && Some(map) == bad, "{map}: {error}");
                    }
                }
                assert_eq!(events(&storage, map).await, position as i64 + 1, "{map}");
            }
        }
        assert!(storage.waiting.queue().appends.is_empty());
        storage.close().await;
    }

    /// Each log's chain goes on over statements of all sizes, which maps share.
    #[tokio::test]
    async fn logs_are_whole_however_many_events_share_a_statement() {
        const MAPS: i64 = 3;
        let directory = tempfile::tempdir().unwrap();
        let storage = with_maps(directory.path(), MAPS).await;
        let mut next = 0;
        for events in [1, 7, 64, 9, 75] {
            let writing = storage.writer.acquire().await.unwrap();
            let entries: Arc<[LogEntry]> =
                (next..next + events).map(|position| opened(position)[0].clone()).collect();
            let appends: Vec<_> = (1..=MAPS)
                .map(|map| {
                    let (storage, entries) = (storage.clone(), entries.clone());
                    tokio::spawn(async move { storage.append(map, entries).await })
                })
                .collect();
            while storage.waiting.queue().appends.len() < MAPS as usize {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
            drop(writing);
            for append in appends {
                append.await.unwrap().unwrap();
            }
            next += events;
        }
        for map in 1..=MAPS {
            let mut replayed = 0;
            let mut count = |position, _| {
                assert_eq!(position, replayed);
                replayed += 1;
                Ok(())
            };
            storage.replay(map, 0..next, 1, &mut count).await.unwrap();
            assert_eq!(replayed, next);
        }
        let wrong = "SELECT count(*) FROM sessions WHERE kept_bytes != \
             (SELECT sum(length(event)) FROM log WHERE log.map_id = sessions.map_id)";
        let wrong: i64 = sqlx::query_scalar(wrong).fetch_one(&storage.readers).await.unwrap();
        assert_eq!(wrong, 0);
        storage.close().await;
    }

    #[test]
    fn the_first_are_taken_as_far_as_they_fit() {
        let waiting = Waiting::default();
        let entry = opened(0)[0].clone();
        let mut pushed = [MOST_EVENTS + 1, 1, MOST_EVENTS - 1, 1, 1].map(|events| {
            let (done, told) = oneshot::channel();
            (waiting.push(1, vec![entry.clone(); events].into(), Arc::default(), done), told)
        });
        let taken = || waiting.take().iter().map(|append| append.number).collect::<Vec<_>>();
        assert_eq!(taken(), [0]);
        assert_eq!(taken(), [1, 2]);
        assert!(waiting.take_back(3) && !waiting.take_back(3) && !waiting.take_back(0));
        assert_eq!(taken(), [4]);
        assert!(taken().is_empty());
        assert!(pushed[4].1.try_recv().is_err());
    }
}
