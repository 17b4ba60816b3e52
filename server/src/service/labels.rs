//! What people call places.

use fabmap::appearance::PlaceId;

use super::appearance::AppearanceGraphs;
use super::maps::Maps;
use crate::error::ServiceError;
use crate::names::{map_in, place_in};
use crate::pages::{Page, numbered_page, page_from, page_size};
pub(crate) use crate::storage::LabelRow;
use crate::storage::{MapRow, Storage, StorageError};

/// Longest label, in characters.
const MAX_LABEL_LEN: usize = 63;

/// Labels that a message names when it says which there are.
const MAX_TOLD: u32 = 50;

/// On which places a label is put.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum LabelScope {
    /// On that one alone.
    #[default]
    Place,
    /// On all of the room that it is in, as the map shows it now.
    Space,
}

/// What people call places. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Labels {
    pub(super) storage: Storage,
    pub(super) maps: Maps,
    pub(super) graphs: AppearanceGraphs,
}

impl Labels {
    /// Places with labels, by number.
    pub(crate) async fn list(
        &self,
        map: &str,
        size: u32,
        token: &str,
    ) -> Result<Page<LabelRow>, ServiceError> {
        let map = map_in(map)?;
        let size = page_size(size)?;
        let from = numbered_page(token)?.unwrap_or(0);
        let row = self.maps.open_maps.row(map).await?;
        let mut items = self.storage.labels(row.id, PlaceId::new(from), size + 1).await?;
        let next = items.get(size as usize).map_or_else(String::new, |next| page_from(next.place));
        items.truncate(size as usize);
        Ok(Page { items, next })
    }

    /// Puts a label on `maps/{map}/places/{number}`, or on all places of its room; which ones.
    pub(crate) async fn set(
        &self,
        place: &str,
        label: &str,
        scope: LabelScope,
    ) -> Result<Vec<LabelRow>, ServiceError> {
        check_label(label)?;
        let (map, number) = place_in(place)?;
        // Says so if there is none.
        self.maps.place(place).await?;
        let row = self.maps.open_maps.row(map).await?;
        let places = match scope {
            LabelScope::Place => vec![PlaceId::new(number)],
            LabelScope::Space => self.room_of(&row, PlaceId::new(number)).await?,
        };
        self.storage.put_labels(row.id, &places, label).await.map_err(|error| match error {
            StorageError::InUse => {
                ServiceError::not_found(format_args!("the map {map} was deleted just now"))
            }
            error => error.into(),
        })?;
        Ok(places.into_iter().map(|place| LabelRow { place, label: label.to_owned() }).collect())
    }

    /// Takes the label of `maps/{map}/places/{number}` away.
    pub(crate) async fn delete(&self, place: &str) -> Result<(), ServiceError> {
        let (map, number) = place_in(place)?;
        let row = self.maps.open_maps.row(map).await?;
        if self.storage.delete_label(row.id, PlaceId::new(number)).await? {
            return Ok(());
        }
        Err(ServiceError::not_found(format_args!(
            "the place {number} of the map {map} has no label; list the map's labels to see which have"
        )))
    }

    /// The places that bear a label; there is one at least.
    pub(super) async fn labelled(&self, row: &MapRow, label: &str) -> Result<Vec<PlaceId>, ServiceError> {
        let places = self.storage.labelled(row.id, label).await?;
        if !places.is_empty() {
            return Ok(places);
        }
        let names = self.storage.label_names(row.id, MAX_TOLD).await?;
        let map = &row.name;
        Err(ServiceError::not_found(match names.as_slice() {
            [] => format!(
                "no place of the map {map} is called {label:?}: none has a label yet; put one on a place"
            ),
            names => format!(
                "no place of the map {map} is called {label:?}; there are the labels {}",
                names.join(", ")
            ),
        }))
    }

    async fn room_of(&self, row: &MapRow, place: PlaceId) -> Result<Vec<PlaceId>, ServiceError> {
        let graph = self.graphs.of(row).await?;
        let Some(image) = graph.image_of(place) else {
            return Err(ServiceError::precondition(format_args!(
                "the place {place} of the map {} was not made by a panorama, so it is in no room; label it alone",
                row.name
            )));
        };
        let room = tokio::task::spawn_blocking(move || {
            let room = graph.appearance().room_around(image, graph.spaces());
            room.into_iter().filter_map(|image| graph.place_of(image)).collect()
        });
        room.await.map_err(ServiceError::internal)
    }
}

/// Refuses what is no label.
pub(super) fn check_label(label: &str) -> Result<(), ServiceError> {
    let length = label.chars().count();
    let fits = (1..=MAX_LABEL_LEN).contains(&length)
        && label.trim() == label
        && !label.chars().any(char::is_control);
    if fits {
        return Ok(());
    }
    Err(ServiceError::invalid(format_args!(
        "{:?} is no label; use 1 to {MAX_LABEL_LEN} characters, none of them a control character, without blanks at \
         either end",
        label.chars().take(MAX_LABEL_LEN + 1).collect::<String>()
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_what_people_write() {
        for good in ["kitchen", "Küche", "room 2.17", "台所", &"ä".repeat(63)] {
            assert_eq!(check_label(good), Ok(()), "{good}");
        }
        for bad in ["", " ", " kitchen", "kitchen ", "a\nb", "a\u{7f}", &"x".repeat(64)] {
            assert!(matches!(check_label(bad), Err(ServiceError::InvalidArgument { .. })), "{bad:?}");
        }
    }
}
