//! Media that lie outside one of the two databases: what is brought over has them in its rows, and so it is compared.

use futures::{StreamExt, TryStreamExt};

use super::Value;
use super::tables::Table;
use crate::storage::media_store::damage;
use crate::storage::objects::{AT_ONCE, MOST_IN_ROW, NoObject, ObjectRef, Objects};
use crate::storage::values::{from_sql, to_sql};
use crate::storage::{MapId, StorageError};

/// The table whose rows may name objects, after two columns of a key.
const MEDIA: &str = "frame_media";
const CONTENT: usize = 2;

/// Rows of a table with all content in them.
pub(super) async fn with_content(
    objects: Option<&Objects>,
    table: &Table,
    rows: Vec<Vec<Value>>,
) -> Result<Vec<Vec<Value>>, StorageError> {
    if table.name != MEDIA {
        return Ok(rows);
    }
    let rows: Vec<_> = rows.into_iter().map(|row| read(objects, row)).collect();
    futures::stream::iter(rows).buffered(AT_ONCE).try_collect().await
}

async fn read(objects: Option<&Objects>, mut row: Vec<Value>) -> Result<Vec<Value>, StorageError> {
    let [_, Value::Text(Some(name)), Value::Whole(Some(bytes)), Value::Bytes(Some(sha256))] = &row[CONTENT..]
    else {
        return Ok(row);
    };
    let object = ObjectRef { name: name.clone(), bytes: from_sql(*bytes)?, sha256: sha256.clone() };
    let Some(objects) = objects else {
        let message = "media lie outside the database of PostgreSQL; say where with --media (WAYPOST_MEDIA, or media in the file)";
        return Err(StorageError::Unfit(message.to_owned()));
    };
    let content = objects.get(&object).await.map_err(|found| match found {
        NoObject::Failed(error) => error,
        NoObject::Gone | NoObject::Another => StorageError::Rot(damage(&object, &found)),
    })?;
    row.truncate(CONTENT);
    row.extend([Value::Bytes(Some(content)), Value::Text(None), Value::Whole(None), Value::Bytes(None)]);
    Ok(row)
}

/// Rows of a map's table with what goes outside the database put there.
pub(super) async fn put_outside(
    objects: Option<&Objects>,
    (table, map): (&Table, Option<MapId>),
    rows: Vec<Vec<Value>>,
) -> Result<Vec<Vec<Value>>, StorageError> {
    let (Some(objects), Some(map), MEDIA) = (objects, map, table.name) else { return Ok(rows) };
    let rows: Vec<_> = rows.into_iter().map(|row| put(objects, map, row)).collect();
    futures::stream::iter(rows).buffered(AT_ONCE).try_collect().await
}

async fn put(objects: &Objects, map: MapId, mut row: Vec<Value>) -> Result<Vec<Value>, StorageError> {
    let Value::Bytes(Some(content)) = &row[CONTENT] else { return Ok(row) };
    if content.len() <= MOST_IN_ROW {
        return Ok(row);
    }
    let ObjectRef { name, bytes, sha256 } = objects.put(map, content).await?;
    row.truncate(CONTENT);
    row.extend([
        Value::Bytes(Some(Vec::new())),
        Value::Text(Some(name)),
        Value::Whole(Some(to_sql(bytes as u64))),
        Value::Bytes(Some(sha256)),
    ]);
    Ok(row)
}
