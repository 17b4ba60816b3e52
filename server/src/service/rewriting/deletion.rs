//! Maps are deleted.

use tokio::runtime::Handle;

use super::Rewriting;
use crate::error::ServiceError;
use crate::names::map_in;
use crate::open_map::no_such_map;

impl Rewriting {
    /// Deletes a map with all it holds, by `maps/{map}`, unless a robot is being led along it. Streams into it end.
    pub(crate) async fn delete_map(&self, name: &str) -> Result<(), ServiceError> {
        let map = map_in(name)?;
        let row = self.open_maps.row(map).await?;
        if self.led.any_connected_on(row.id) {
            return Err(ServiceError::precondition(format_args!(
                "a robot is being led along the map {map}, and would stop without it; end its navigation first, or take \
                 it to another map"
            )));
        }
        let storage = self.storage.clone();
        let deleted_maps = self.deleted_maps.clone();
        let name = map.to_owned();
        let retire = move |runtime: &Handle| {
            // Its name is free at once; its rows are deleted in the background.
            let retired = runtime.block_on(storage.retire_map(&name));
            deleted_maps.wanted();
            Ok(retired?)
        };
        let deleted = self.open_maps.with_closed(map, retire).await?;
        if deleted { Ok(()) } else { Err(no_such_map(map)) }
    }
}
