//! Reading all that a data directory holds, to see whether it is as it was written.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use fabmap::model::Model;
use sqlx::{AnyConnection, Connection};
use topomap::ids::SessionId;
use topomap::log::MapEvent;

use super::lock::DirectoryLock;
use super::opening::{FileKind, file_kind};
use super::{FILE_NAME, connect_to_read, or_no_database, page_sums};
use crate::storage::columns::EventColumns;
use crate::storage::kept::wrongly_noted;
use crate::storage::row_sums::{CHAIN_START, StoredEvent};
use crate::storage::values::MaybeWhole;
use crate::storage::{MapId, MediumKind, StorageError};

/// What was read, and what is wrong with it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct DeepInspection {
    pub(crate) models: u64,
    pub(crate) maps: u64,
    pub(crate) events: u64,
    /// What robots call frames.
    pub(crate) notes: u64,
    /// Images and features.
    pub(crate) media: u64,
    /// One sentence each; no more of one kind than tell what it is.
    pub(crate) problems: Vec<String>,
}

/// Problems of one kind that are told in full.
const MOST_TOLD: usize = 20;

/// A map as it is inspected.
#[derive(sqlx::FromRow)]
struct InspectedMap {
    id: MapId,
    name: String,
    words: Option<i64>,
}

/// What people call a session.
#[derive(sqlx::FromRow)]
struct SessionName {
    #[sqlx(try_from = "i64")]
    number: SessionId,
    name: String,
}

/// What is kept of a frame, beside what the log says of the frame.
#[derive(sqlx::FromRow)]
struct KeptNote {
    position: i64,
    note: String,
    #[sqlx(try_from = "MaybeWhole")]
    session: Option<SessionId>,
    sequence: Option<i64>,
}

/// The same, of an image or of features.
#[derive(sqlx::FromRow)]
struct KeptMedium {
    position: i64,
    kind: MediumKind,
    #[sqlx(try_from = "MaybeWhole")]
    session: Option<SessionId>,
    sequence: Option<i64>,
}

/// An event with all that the log tells of it.
#[derive(sqlx::FromRow)]
struct WholeEvent {
    #[sqlx(flatten)]
    stored: StoredEvent,
    #[sqlx(flatten)]
    columns: EventColumns,
}

/// Reads all of the database of `directory`, and changes nothing. `None` if there is none.
///
/// Takes the directory's lock meanwhile: a server that runs on it is an error.
pub(crate) async fn inspect_all(directory: &Path) -> Result<Option<DeepInspection>, StorageError> {
    let file = directory.join(FILE_NAME);
    // Before the lock, which makes the directory.
    if !file.exists() {
        return Ok(None);
    }
    let _lock = DirectoryLock::take(directory)?;
    page_sums::register()?;
    match file_kind(&file)? {
        FileKind::Empty => return Ok(None),
        FileKind::WithChecksums => {}
        FileKind::WithoutChecksums => {
            let problems = vec!["the database has no checksums yet; start the server on it once".to_owned()];
            return Ok(Some(DeepInspection { problems, ..DeepInspection::default() }));
        }
    }
    let database = connect_to_read(&file).await.map_err(|error| or_no_database(error, directory))?;
    let mut reading = Reading { database, found: DeepInspection::default() };
    reading.all().await;
    let Reading { database, found } = reading;
    database.close().await?;
    Ok(Some(found))
}

/// Whether a map is as it was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Soundness {
    Sound,
    Damaged,
}

struct Reading {
    database: AnyConnection,
    found: DeepInspection,
}

impl Reading {
    async fn all(&mut self) {
        self.sqlite().await;
        self.models().await;
        self.known_damage().await;
        let maps = sqlx::query_as(
            "SELECT maps.id, maps.name, models.words FROM maps LEFT JOIN models ON models.hash = maps.model \
             WHERE state = 'live' ORDER BY maps.name",
        );
        let maps: Result<Vec<InspectedMap>, _> = maps.fetch_all(&mut self.database).await;
        let counted = self.sessions_are_counted().await;
        for map in self.read("the maps", maps).unwrap_or_default() {
            self.found.maps += 1;
            let sound = self.map(&map).await == Soundness::Sound;
            if sound && counted {
                self.kept(&map).await;
            }
        }
    }

    /// Whether it is noted what sessions keep: not yet where an earlier server was the last.
    async fn sessions_are_counted(&mut self) -> bool {
        let column = sqlx::query("SELECT 1 FROM pragma_table_info('sessions') WHERE name = 'kept_bytes'");
        let column = column.fetch_optional(&mut self.database).await;
        let to_do = sqlx::query("SELECT 1 FROM upkeep WHERE task = 'kept_bytes'");
        matches!(column, Ok(Some(_))) && matches!(to_do.fetch_optional(&mut self.database).await, Ok(None))
    }

    /// What sessions keep is what is noted of them.
    async fn kept(&mut self, map: &InspectedMap) {
        let InspectedMap { id, name, words: _ } = map;
        let wrong = sqlx::query_as(sqlx::AssertSqlSafe(wrongly_noted())).bind(id);
        let wrong: Result<Vec<(String, i64, i64)>, _> = wrong.fetch_all(&mut self.database).await;
        let wrong = self.read(&format!("map {name}: what its sessions keep"), wrong).unwrap_or_default();
        self.found.problems.extend(wrong.into_iter().take(MOST_TOLD).map(|(session, noted, counted)| {
            format!(
                "map {name}, session {session}: it keeps {counted} bytes, and {noted} are noted for quotas"
            )
        }));
    }

    /// What was read, or else the problem.
    fn read<T>(&mut self, what: &str, read: Result<T, sqlx::Error>) -> Option<T> {
        match read {
            Ok(read) => Some(read),
            Err(error) => {
                self.found.problems.push(format!("{what} cannot be read: {}", StorageError::from(error)));
                None
            }
        }
    }

    /// All pages, the indices against their tables, and what rows say of each other.
    async fn sqlite(&mut self) {
        let told: Result<Vec<String>, _> =
            sqlx::query_scalar("PRAGMA integrity_check(20)").fetch_all(&mut self.database).await;
        let told = self.read("the database as a whole", told).unwrap_or_default();
        let wrong = told.iter().filter(|line| *line != "ok");
        self.found.problems.extend(wrong.map(|line| format!("SQLite finds: {}", in_one_line(line))));
        let orphans: Result<Vec<String>, _> =
            sqlx::query_scalar("SELECT DISTINCT \"table\" FROM pragma_foreign_key_check")
                .fetch_all(&mut self.database)
                .await;
        for table in self.read("references between tables", orphans).unwrap_or_default() {
            self.found.problems.push(format!("the table {table} has rows of what is not there"));
        }
    }

    async fn models(&mut self) {
        let hashes: Result<Vec<String>, _> =
            sqlx::query_scalar("SELECT hash FROM models ORDER BY hash").fetch_all(&mut self.database).await;
        for hash in self.read("the models", hashes).unwrap_or_default() {
            self.found.models += 1;
            let file = sqlx::query_scalar("SELECT file FROM models WHERE hash = $1").bind(&hash);
            let file: Result<Vec<u8>, _> = file.fetch_one(&mut self.database).await;
            let Some(file) = self.read(&format!("the model {hash}"), file) else { continue };
            if !Model::from_bytes(&file).is_ok_and(|model| model.hash().to_string() == hash) {
                self.found.problems.push(format!("the model {hash} is not what was stored under this name"));
            }
        }
    }

    async fn known_damage(&mut self) {
        let known: Result<Vec<String>, _> = sqlx::query_scalar(
            "SELECT found FROM map_damage JOIN maps ON maps.id = map_id WHERE state = 'live' ORDER BY map_id",
        )
        .fetch_all(&mut self.database)
        .await;
        let known = self.read("what was found damaged before", known).unwrap_or_default();
        self.found.problems.extend(known.into_iter().map(|found| format!("a server found, {found}")));
    }

    async fn map(&mut self, map: &InspectedMap) -> Soundness {
        let InspectedMap { id, name, words } = map;
        let sessions = sqlx::query_as("SELECT number, name FROM sessions WHERE map_id = $1").bind(id);
        let sessions: Result<Vec<SessionName>, _> = sessions.fetch_all(&mut self.database).await;
        let sessions = self.read(&format!("map {name}: its sessions"), sessions).unwrap_or_default();
        let sessions: BTreeMap<_, _> =
            sessions.into_iter().map(|SessionName { number, name }| (number, name)).collect();
        let last = sqlx::query_scalar("SELECT max(position) FROM log WHERE map_id = $1").bind(id);
        let last: Result<Option<i64>, _> = last.fetch_one(&mut self.database).await;
        let last = self.read(&format!("map {name}: its log"), last).flatten();
        let mut problems = Problems::default();
        let mut chain = CHAIN_START;
        let mut opened = BTreeSet::new();
        for position in 0..=last.unwrap_or(-1) {
            self.found.events += 1;
            let event = self.event(*id, position, words.unwrap_or(0), &mut chain, &mut problems, &sessions);
            if let Some(MapEvent::SessionOpened { session }) = event.await {
                opened.insert(session);
            }
        }
        if problems.0.is_empty() && opened != sessions.keys().copied().collect() {
            problems.add("its sessions are not those of its log".to_owned());
        }
        self.notes(*id, &sessions, &mut problems).await;
        self.media(*id, &sessions, &mut problems).await;
        let told = problems.0.len().min(MOST_TOLD);
        let told = problems.0[..told].iter().map(|problem| format!("map {name}, {problem}"));
        self.found.problems.extend(told);
        if let Some(more) = problems.0.len().checked_sub(MOST_TOLD).filter(|more| *more > 0) {
            self.found.problems.push(format!("map {name}: {more} more of the kind"));
        }
        if problems.0.is_empty() { Soundness::Sound } else { Soundness::Damaged }
    }

    /// The event at a position, if it is as it was written.
    async fn event(
        &mut self,
        map: MapId,
        position: i64,
        words: i64,
        chain: &mut i64,
        problems: &mut Problems,
        sessions: &BTreeMap<SessionId, String>,
    ) -> Option<MapEvent> {
        let row = sqlx::query_as("SELECT * FROM log WHERE map_id = $1 AND position = $2");
        let row = row.bind(map).bind(position).fetch_optional(&mut self.database).await;
        let row: WholeEvent = match row {
            Ok(Some(row)) => row,
            Ok(None) => {
                problems.add(format!("event {position} of the log is gone"));
                return None;
            }
            Err(error) => {
                problems.add(format!("event {position} of the log: {}", StorageError::from(error)));
                return None;
            }
        };
        let WholeEvent { stored, columns } = row;
        let named = named(sessions, Some(columns.session), columns.sequence, position);
        let before = std::mem::replace(chain, stored.chain());
        let followed = stored.follow(u64::try_from(position).unwrap_or(0), before);
        let decoded = followed.and_then(|_| stored.decode(usize::try_from(words).unwrap_or(0)));
        match decoded {
            Ok(event) if columns.are_of(&event) => Some(event),
            Ok(_) => {
                problems.add(format!("{named}: the log's columns are not those of the event"));
                None
            }
            Err(error) => {
                problems.add(format!("{named}: {error}"));
                None
            }
        }
    }

    /// What frames are called can be read, and is of frames.
    async fn notes(&mut self, map: MapId, sessions: &BTreeMap<SessionId, String>, problems: &mut Problems) {
        let mut after = -1;
        loop {
            let next = sqlx::query_as(
                "SELECT position, note, session, sequence FROM frame_notes LEFT JOIN log USING (map_id, position) \
                 WHERE map_id = $1 AND position > $2 ORDER BY position LIMIT 1",
            );
            let next = next.bind(map).bind(after).fetch_optional(&mut self.database).await;
            let KeptNote { position, note, session, sequence } = match next {
                Ok(Some(next)) => next,
                Ok(None) => return,
                Err(error) => return problems.unread("what its frames are called", error),
            };
            after = position;
            self.found.notes += 1;
            if sequence.is_none() {
                let named = named(sessions, session, None, position);
                problems.add(format!("{named}: the note {note:?} is of a frame that is none"));
            }
        }
    }

    /// What is kept of frames can be read, and is of frames.
    async fn media(&mut self, map: MapId, sessions: &BTreeMap<SessionId, String>, problems: &mut Problems) {
        let mut after = (-1, MediumKind::Features);
        loop {
            let next = sqlx::query_as(
                "SELECT position, kind, session, sequence FROM frame_media LEFT JOIN log USING (map_id, position) \
                 WHERE map_id = $1 AND (position, kind) > ($2, $3) ORDER BY position, kind LIMIT 1",
            );
            let next = next.bind(map).bind(after.0).bind(after.1).fetch_optional(&mut self.database).await;
            let KeptMedium { position, kind, session, sequence } = match next {
                Ok(Some(next)) => next,
                Ok(None) => return,
                Err(error) => return problems.unread("what is kept of its frames", error),
            };
            after = (position, kind);
            self.found.media += 1;
            let named = named(sessions, session, sequence, position);
            if sequence.is_none() {
                problems.add(format!("{named}: something is kept of a frame that is none"));
            }
            let content = sqlx::query_scalar(
                "SELECT content FROM frame_media WHERE map_id = $1 AND position = $2 AND kind = $3",
            );
            let content = content.bind(map).bind(position).bind(kind).fetch_one(&mut self.database).await;
            if let Err(error) = content.map(|content: Vec<u8>| content.len()) {
                problems.add(format!("{named}, its {}: {}", kept(kind), StorageError::from(error)));
            }
        }
    }
}

/// What is kept of a frame, for people.
fn kept(kind: MediumKind) -> &'static str {
    match kind {
        MediumKind::Features => "features",
        MediumKind::Thumbnail => "thumbnail",
        MediumKind::Image => "image",
    }
}

/// What SQLite finds, without what only follows from it.
pub(super) fn in_one_line(found: &str) -> String {
    let lines = || found.lines().filter(|line| !line.starts_with("***"));
    let causes: Vec<&str> = lines().filter(|line| !line.ends_with("never used")).collect();
    if causes.is_empty() { lines().collect::<Vec<_>>().join("; ") } else { causes.join("; ") }
}

/// A frame, or another event, as people name it.
fn named(
    sessions: &BTreeMap<SessionId, String>,
    session: Option<SessionId>,
    sequence: Option<i64>,
    position: i64,
) -> String {
    let Some(session) = session else { return format!("event {position} of the log") };
    let session = sessions.get(&session).map_or("?", String::as_str);
    match sequence {
        Some(sequence) => format!("session {session}, frame {sequence}"),
        None => format!("session {session}, event {position} of the log"),
    }
}

/// What is wrong with one map.
#[derive(Default)]
struct Problems(Vec<String>);

impl Problems {
    fn add(&mut self, problem: String) {
        self.0.push(problem);
    }

    fn unread(&mut self, what: &str, error: sqlx::Error) {
        self.add(format!("{what}: {}", StorageError::from(error)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_sqlite_finds_is_one_line_of_causes() {
        let found = "*** in database main ***\nTree 21 page 1005 cell 0: failed to get page 1001\nPage 1002: never used";
        assert_eq!(in_one_line(found), "Tree 21 page 1005 cell 0: failed to get page 1001");
        assert_eq!(
            in_one_line("Page 7: never used\nPage 8: never used"),
            "Page 7: never used; Page 8: never used"
        );
    }
}
