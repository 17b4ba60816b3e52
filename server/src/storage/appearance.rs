//! What the panoramas of a map have in common.

use fabmap::appearance::PlaceId;
use sqlx::{Any, AssertSqlSafe, Transaction};

use super::maps::check_edition;
use super::values::{Whole, from_sql};
use super::{MapEdition, MapId, Storage, StorageError};

/// A similarity that two places were found to have.
#[derive(Clone, Copy, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct LinkRow {
    #[sqlx(try_from = "Whole")]
    pub(crate) place: PlaceId,
    #[sqlx(try_from = "Whole")]
    pub(crate) earlier: PlaceId,
    pub(crate) similarity: f64,
}

/// Links that a map has on the disk.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct KeptLinks {
    /// Places below have all theirs to earlier ones.
    pub(crate) next_place: PlaceId,
    /// By place, then by the earlier one.
    pub(crate) links: Vec<LinkRow>,
}

impl KeptLinks {
    /// Those of a place to earlier ones; `None` if they are not kept.
    pub(crate) fn links_of(&self, place: PlaceId) -> Option<&[LinkRow]> {
        if place >= self.next_place {
            return None;
        }
        let from = self.links.partition_point(|link| link.place < place);
        let links = &self.links[from..];
        Some(&links[..links.partition_point(|link| link.place == place)])
    }
}

/// Rows of one statement: SQLite takes 32,766 values.
const ROWS: usize = 4000;

impl Storage {
    /// Links of a map that these rules found; none if others did.
    pub(crate) async fn kept_links(&self, map: MapId, rules: u32) -> Result<KeptLinks, StorageError> {
        let mut snapshot = self.snapshot(&self.readers).await?;
        let next_place = kept_until(&mut snapshot, map, rules).await?;
        let select = "SELECT place, earlier, similarity FROM appearance_links WHERE map_id = $1 AND place < $2 \
                      ORDER BY place, earlier";
        let links = sqlx::query_as(select)
            .bind(map)
            .bind(i64::from(next_place.number()))
            .fetch_all(&mut *snapshot)
            .await?;
        Ok(KeptLinks { next_place, links })
    }

    /// Keeps the links of the places that follow `from`, up to `next_place`; what other rules found goes.
    ///
    /// [`StorageError::Retold`] if the log was rewritten or the map deleted meanwhile, [`StorageError::Exists`] if it is
    /// not `from` up to where links are kept; nothing changes then.
    pub(crate) async fn keep_links(
        &self,
        map: MapEdition,
        rules: u32,
        from: PlaceId,
        kept: &KeptLinks,
    ) -> Result<(), StorageError> {
        let KeptLinks { next_place, links } = kept;
        self.write(async |transaction| {
            check_edition(transaction, map).await?;
            let until = kept_until(transaction, map.map, rules).await?;
            if until != from {
                return Err(StorageError::Exists);
            }
            if until == PlaceId::new(0) {
                forget_links(transaction, map.map).await?;
            }
            for rows in links.chunks(ROWS) {
                insert_links(transaction, map.map, rows).await?;
            }
            sqlx::query(
                "INSERT INTO appearance_graphs (map_id, rules, next_place) VALUES ($1, $2, $3) \
                 ON CONFLICT (map_id) DO UPDATE SET rules = excluded.rules, next_place = excluded.next_place",
            )
            .bind(map.map)
            .bind(i64::from(rules))
            .bind(i64::from(next_place.number()))
            .execute(&mut **transaction)
            .await?;
            Ok(())
        })
        .await
    }
}

/// Inserts links by one statement.
async fn insert_links(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
    links: &[LinkRow],
) -> Result<(), StorageError> {
    let values: Vec<String> = (0..links.len())
        .map(|row| format!("($1, ${}, ${}, ${})", 3 * row + 2, 3 * row + 3, 3 * row + 4))
        .collect();
    let insert = format!(
        "INSERT INTO appearance_links (map_id, place, earlier, similarity) VALUES {}",
        values.join(", ")
    );
    let mut insert = sqlx::query(AssertSqlSafe(insert)).persistent(false).bind(map);
    for LinkRow { place, earlier, similarity } in links {
        insert = insert.bind(i64::from(place.number())).bind(i64::from(earlier.number())).bind(similarity);
    }
    insert.execute(&mut **transaction).await?;
    Ok(())
}

/// Places below have links that these rules found.
async fn kept_until(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
    rules: u32,
) -> Result<PlaceId, StorageError> {
    let select = "SELECT next_place FROM appearance_graphs WHERE map_id = $1 AND rules = $2";
    let next_place =
        sqlx::query_scalar(select).bind(map).bind(i64::from(rules)).fetch_optional(&mut **transaction);
    let next_place: Option<i64> = next_place.await?;
    Ok(PlaceId::new(next_place.map_or(Ok(0), from_sql)?))
}

/// What was found out about the places of a map.
pub(super) async fn forget_links(
    transaction: &mut Transaction<'_, Any>,
    map: MapId,
) -> Result<(), StorageError> {
    for delete in
        ["DELETE FROM appearance_links WHERE map_id = $1", "DELETE FROM appearance_graphs WHERE map_id = $1"]
    {
        sqlx::query(delete).bind(map).execute(&mut **transaction).await?;
    }
    Ok(())
}
