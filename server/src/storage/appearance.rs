//! What the panoramas of a map have in common.

use fabmap::appearance::PlaceId;
use sqlx::{QueryBuilder, Sqlite, Transaction};

use super::maps::check_edition;
use super::{MapEdition, MapId, Storage, StorageError};

/// A similarity that two places were found to have.
#[derive(Clone, Copy, Debug, PartialEq, sqlx::FromRow)]
pub(crate) struct LinkRow {
    pub(crate) place: PlaceId,
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
        let mut snapshot = self.readers.begin().await?;
        let next_place = kept_until(&mut snapshot, map, rules).await?;
        let select = "SELECT place, earlier, similarity FROM appearance_links WHERE map_id = ? AND place < ? \
                      ORDER BY place, earlier";
        let links = sqlx::query_as(select).bind(map).bind(next_place).fetch_all(&mut *snapshot).await?;
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
            if until == 0 {
                forget_links(transaction, map.map).await?;
            }
            for rows in links.chunks(ROWS) {
                let insert = "INSERT INTO appearance_links (map_id, place, earlier, similarity) ";
                let mut insert = QueryBuilder::new(insert);
                insert.push_values(rows, |mut values, &LinkRow { place, earlier, similarity }| {
                    values.push_bind(map.map).push_bind(place).push_bind(earlier).push_bind(similarity);
                });
                insert.build().persistent(false).execute(&mut **transaction).await?;
            }
            sqlx::query(
                "INSERT INTO appearance_graphs (map_id, rules, next_place) VALUES (?, ?, ?) \
                 ON CONFLICT (map_id) DO UPDATE SET rules = excluded.rules, next_place = excluded.next_place",
            )
            .bind(map.map)
            .bind(rules)
            .bind(next_place)
            .execute(&mut **transaction)
            .await?;
            Ok(())
        })
        .await
    }
}

/// Places below have links that these rules found.
async fn kept_until(
    transaction: &mut Transaction<'_, Sqlite>,
    map: MapId,
    rules: u32,
) -> Result<PlaceId, StorageError> {
    let select = "SELECT next_place FROM appearance_graphs WHERE map_id = ? AND rules = ?";
    let next_place = sqlx::query_scalar(select).bind(map).bind(rules).fetch_optional(&mut **transaction);
    Ok(next_place.await?.unwrap_or(0))
}

/// What was found out about the places of a map.
pub(super) async fn forget_links(
    transaction: &mut Transaction<'_, Sqlite>,
    map: MapId,
) -> Result<(), StorageError> {
    for delete in
        ["DELETE FROM appearance_links WHERE map_id = ?", "DELETE FROM appearance_graphs WHERE map_id = ?"]
    {
        sqlx::query(delete).bind(map).execute(&mut **transaction).await?;
    }
    Ok(())
}
