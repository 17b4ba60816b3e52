//! All that one database holds, brought into another: from SQLite to PostgreSQL, and back.
//!
//! What is read is one snapshot of the source, which may be served meanwhile. What is written is hidden until every row
//! was read back and compared. One that was cut off goes on where it was.

mod media;
mod tables;

use std::path::Path;

use sqlx::any::AnyRow;
use sqlx::query::Query;
use sqlx::{Any, AnyConnection, AssertSqlSafe, Row, Transaction};

use tables::Kind::{self, Bytes, Real, Text, Whole};
use tables::{JOBS, MAPS, MERGES, MODELS, NUMBERED, OF_MAPS, TOKENS, Table};

use super::objects::Objects;
use super::values::MaybeReal;
use super::{MapId, MediaAddress, Storage, StorageError, engine, postgres, sqlite};

/// What was brought over.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Moved {
    /// Names, in their order.
    pub(crate) maps: Vec<String>,
    /// Of all tables.
    pub(crate) rows: u64,
}

/// A database that is read from outside, without being its owner.
pub(crate) struct Source {
    connection: AnyConnection,
    numbers: &'static str,
    /// Where its media lie that are not in it.
    objects: Option<Objects>,
}

/// A value of a column. Reals by their bits: what is copied is the same to the last of them.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Value {
    Whole(Option<i64>),
    Real(Option<u64>),
    Text(Option<String>),
    Bytes(Option<Vec<u8>>),
}

impl Source {
    /// The SQLite database of a directory, which a server may run on.
    pub(crate) async fn of_directory(directory: &Path) -> Result<Self, StorageError> {
        let mut connection = sqlite::open_to_read(directory).await?;
        sqlx::query("BEGIN").execute(&mut connection).await?;
        Ok(Self { connection, numbers: sqlite::LAST_NUMBER, objects: None })
    }

    /// A database of PostgreSQL, which a server may run on.
    pub(crate) async fn of_postgres(address: &str, media: &MediaAddress) -> Result<Self, StorageError> {
        let mut connection = postgres::open_to_read(address).await?;
        sqlx::query(engine::POSTGRES_SNAPSHOT).execute(&mut connection).await?;
        Ok(Self { connection, numbers: postgres::LAST_NUMBER, objects: Objects::at(media)? })
    }

    /// The numbers of its maps.
    async fn maps(&mut self) -> Result<Vec<MapId>, StorageError> {
        let maps = sqlx::query_scalar("SELECT id FROM maps WHERE state = 'live' ORDER BY id");
        Ok(maps.fetch_all(&mut self.connection).await?)
    }

    /// The last number that was given in a table; 0 if none was.
    async fn last_number(&mut self, table: &str, column: &str) -> Result<i64, StorageError> {
        let highest: i64 =
            sqlx::query_scalar(AssertSqlSafe(format!("SELECT coalesce(max({column}), 0) FROM {table}")))
                .fetch_one(&mut self.connection)
                .await?;
        let given: Option<Option<i64>> =
            sqlx::query_scalar(self.numbers).bind(table).fetch_optional(&mut self.connection).await?;
        Ok(highest.max(given.flatten().unwrap_or(0)))
    }
}

impl Storage {
    /// Brings over all that `source` holds. [`StorageError::Unfit`] if something else is here, or if what was written is
    /// not what was read.
    pub(crate) async fn take_over_from(&self, mut source: Source) -> Result<Moved, StorageError> {
        let maps = source.maps().await?;
        self.check_only_of(&mut source, &maps).await?;
        let mut moved = Moved::default();
        self.copy(&mut source, &MODELS, None, &mut moved).await?;
        for &map in &maps {
            self.begin_map(&mut source, map, &mut moved).await?;
            for table in &OF_MAPS {
                self.copy(&mut source, table, Some(map), &mut moved).await?;
            }
        }
        for table in [&TOKENS, &JOBS, &MERGES] {
            self.copy(&mut source, table, None, &mut moved).await?;
        }
        for (table, column) in NUMBERED {
            let last = source.last_number(table, column).await?;
            self.write(async |transaction| {
                self.engine.give_no_number_up_to(transaction, (table, column), last).await
            })
            .await?;
        }
        self.show(&mut source, &maps).await?;
        self.count_used().await?;
        Ok(moved)
    }

    /// What is here is of the same source.
    async fn check_only_of(&self, source: &mut Source, maps: &[MapId]) -> Result<(), StorageError> {
        let select = "SELECT id, name, created_ns FROM maps";
        let here: Vec<(MapId, String, i64)> = sqlx::query_as(select).fetch_all(&self.readers).await?;
        let there: Vec<(MapId, String, i64)> =
            sqlx::query_as(select).fetch_all(&mut source.connection).await?;
        for map in &here {
            if !maps.contains(&map.0) || !there.contains(map) {
                return Err(StorageError::Unfit(format!(
                    "the target holds the map {} of its own; name a database that holds nothing",
                    map.1
                )));
            }
        }
        Ok(())
    }

    /// A map that nobody sees yet.
    async fn begin_map(
        &self,
        source: &mut Source,
        map: MapId,
        moved: &mut Moved,
    ) -> Result<(), StorageError> {
        let mut rows =
            page(&mut source.connection, &MAPS, None, Some(&[Value::Whole(Some(map - 1))]), 1).await?;
        let row = rows.pop().ok_or_else(|| StorageError::Damaged("a map that is gone".to_owned()))?;
        if let Some(Value::Text(Some(name))) = row.get(1) {
            moved.maps.push(name.clone());
        }
        moved.rows += 1;
        self.write(async |transaction| {
            insert(transaction, &MAPS, Some(("state", "importing")), None, &row).await
        })
        .await
    }

    /// Copies what is not there yet of a table, or of a map's part of it, and then compares all of it.
    async fn copy(
        &self,
        source: &mut Source,
        table: &Table,
        map: Option<MapId>,
        moved: &mut Moved,
    ) -> Result<(), StorageError> {
        let mut after = self.last_key(table, map).await?;
        while let rows = page(&mut source.connection, table, map, after.as_deref(), table.page).await?
            && let Some(last) = rows.last()
        {
            after = Some(last[..table.key.len()].to_vec());
            let rows = media::with_content(source.objects.as_ref(), table, rows).await?;
            let rows = media::put_outside(self.objects.as_deref(), (table, map), rows).await?;
            self.write(async |transaction| {
                for row in &rows {
                    insert(transaction, table, None, map, row).await?;
                }
                Ok(())
            })
            .await?;
        }
        moved.rows += self.compare(source, table, map).await?;
        Ok(())
    }

    /// The key of the last row that is here.
    async fn last_key(&self, table: &Table, map: Option<MapId>) -> Result<Option<Vec<Value>>, StorageError> {
        let columns = names(table.key);
        let order = table.key.iter().map(|(name, _)| format!("{name} DESC")).collect::<Vec<_>>().join(", ");
        let of_map = if map.is_some() { "WHERE map_id = $1" } else { "" };
        let select = format!("SELECT {columns} FROM {} {of_map} ORDER BY {order} LIMIT 1", table.name);
        let mut query = sqlx::query(AssertSqlSafe(select));
        if let Some(map) = map {
            query = query.bind(map);
        }
        let row = query.fetch_optional(&self.readers).await?;
        row.map(|row| values(&row, table.key.iter())).transpose()
    }

    /// Every row is here as it is there, and no other; how many there are.
    async fn compare(
        &self,
        source: &mut Source,
        table: &Table,
        map: Option<MapId>,
    ) -> Result<u64, StorageError> {
        let mut here = self.readers.acquire().await?;
        let mut after: Option<Vec<Value>> = None;
        let mut rows = 0;
        loop {
            let read = page(&mut source.connection, table, map, after.as_deref(), table.page).await?;
            let written = page(&mut here, table, map, after.as_deref(), table.page).await?;
            let read = media::with_content(source.objects.as_ref(), table, read).await?;
            let written = media::with_content(self.objects.as_deref(), table, written).await?;
            if read != written {
                return Err(StorageError::Unfit(format!(
                    "the table {} is not in the target as it is in the source: the source has changed since an earlier \
                     run, or the target was written to; begin again with an empty target",
                    table.name
                )));
            }
            let Some(last) = read.last() else { return Ok(rows) };
            rows += read.len() as u64;
            after = Some(last[..table.key.len()].to_vec());
        }
    }

    /// Shows the maps, and says again which of them merges are of.
    async fn show(&self, source: &mut Source, maps: &[MapId]) -> Result<(), StorageError> {
        let of_maps: Vec<(i64, MapId)> =
            sqlx::query_as("SELECT number, map_id FROM merges WHERE map_id IS NOT NULL ORDER BY number")
                .fetch_all(&mut source.connection)
                .await?;
        self.write(async |transaction| {
            for (merge, map) in of_maps.iter().filter(|(_, map)| maps.contains(map)) {
                sqlx::query("UPDATE merges SET map_id = $1 WHERE number = $2")
                    .bind(map)
                    .bind(merge)
                    .execute(&mut **transaction)
                    .await?;
            }
            for map in maps {
                sqlx::query("UPDATE maps SET state = 'live' WHERE id = $1")
                    .bind(map)
                    .execute(&mut **transaction)
                    .await?;
            }
            Ok(())
        })
        .await
    }
}

/// The rows that follow a key, in their order.
async fn page(
    connection: &mut AnyConnection,
    table: &Table,
    map: Option<MapId>,
    after: Option<&[Value]>,
    rows: usize,
) -> Result<Vec<Vec<Value>>, StorageError> {
    let columns: Vec<_> = table.key.iter().chain(table.rest).collect();
    let mut conditions = Vec::new();
    let mut placeholders = 1..;
    let mut next = || format!("${}", placeholders.next().unwrap_or_default());
    if map.is_some() {
        conditions.push(format!("map_id = {}", next()));
    }
    if after.is_some() {
        let following = table.key.iter().map(|_| next()).collect::<Vec<_>>().join(", ");
        conditions.push(format!("({}) > ({following})", names(table.key)));
    }
    let conditions =
        if conditions.is_empty() { String::new() } else { format!("WHERE {}", conditions.join(" AND ")) };
    let select = format!(
        "SELECT {}, {} FROM {} {conditions} ORDER BY {} LIMIT {rows}",
        names(table.key),
        names(table.rest),
        table.name,
        names(table.key)
    );
    let mut query = sqlx::query(AssertSqlSafe(select));
    if let Some(map) = map {
        query = query.bind(map);
    }
    for value in after.unwrap_or_default() {
        query = bind(query, value);
    }
    let rows = query.fetch_all(connection).await?;
    rows.iter().map(|row| values(row, columns.iter().copied())).collect()
}

/// Inserts a row unless it is there; with a word in one more column, if that is wanted.
async fn insert(
    transaction: &mut Transaction<'_, Any>,
    table: &Table,
    word: Option<(&str, &str)>,
    map: Option<MapId>,
    row: &[Value],
) -> Result<(), StorageError> {
    let mut columns = Vec::new();
    columns.extend(map.map(|_| "map_id"));
    columns.extend(table.key.iter().chain(table.rest).map(|(name, _)| *name));
    columns.extend(word.map(|(column, _)| column));
    let placeholders = (1..=columns.len()).map(|number| format!("${number}")).collect::<Vec<_>>().join(", ");
    let insert = format!(
        "INSERT INTO {} ({}) VALUES ({placeholders}) ON CONFLICT DO NOTHING",
        table.name,
        columns.join(", ")
    );
    let mut query = sqlx::query(AssertSqlSafe(insert));
    if let Some(map) = map {
        query = query.bind(map);
    }
    for value in row {
        query = bind(query, value);
    }
    if let Some((_, word)) = word {
        query = query.bind(word);
    }
    query.execute(&mut **transaction).await?;
    Ok(())
}

fn names(columns: &[(&str, Kind)]) -> String {
    columns.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ")
}

type Bound<'query> = Query<'query, Any, <Any as sqlx::Database>::Arguments>;

fn bind<'query>(query: Bound<'query>, value: &'query Value) -> Bound<'query> {
    match value {
        Value::Whole(number) => query.bind(*number),
        Value::Real(bits) => query.bind(MaybeReal(bits.map(f64::from_bits))),
        Value::Text(text) => query.bind(text.as_deref()),
        Value::Bytes(bytes) => query.bind(bytes.as_deref()),
    }
}

fn values<'columns>(
    row: &AnyRow,
    columns: impl Iterator<Item = &'columns (&'columns str, Kind)>,
) -> Result<Vec<Value>, StorageError> {
    columns
        .enumerate()
        .map(|(index, (_, kind))| {
            Ok(match kind {
                Whole => Value::Whole(row.try_get(index)?),
                Real => Value::Real(row.try_get::<Option<f64>, _>(index)?.map(f64::to_bits)),
                Text => Value::Text(row.try_get(index)?),
                Bytes => Value::Bytes(row.try_get(index)?),
            })
        })
        .collect()
}
