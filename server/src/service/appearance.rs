//! Maps without metres: which places can be matched from which, the spaces that they form, and what people call them.

use std::sync::Arc;

use fabmap::appearance::PlaceId;
use tokio::runtime::Handle;
use tokio_util::sync::CancellationToken;

use super::jobs::Jobs;
use crate::error::ServiceError;
use crate::ingest::model::LoadedModels;
use crate::map_settings::{self, NavigationStrategy};
use crate::names::{map_in, map_name};
use crate::open_map::appearance::{Graph, Ground, LinkView};
use crate::open_map::{MapHandle, OpenMaps};
use crate::storage::{MapEdition, MapRow, Storage};

/// The graph of a map, for people.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GraphView {
    /// `maps/{map}`.
    pub(crate) map: String,
    /// By number.
    pub(crate) nodes: Vec<NodeView>,
    pub(crate) links: Vec<LinkView>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NodeView {
    pub(crate) place: PlaceId,
    /// Convex space that it is in.
    pub(crate) space: u32,
    /// Empty if it has none.
    pub(crate) label: Option<String>,
}

/// The appearance graphs of maps. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct AppearanceGraphs {
    pub(super) storage: Storage,
    pub(super) models: LoadedModels,
    pub(super) open_maps: OpenMaps,
    pub(super) jobs: Jobs,
    pub(super) stopping: CancellationToken,
}

impl AppearanceGraphs {
    /// The graph of a map with spaces and labels.
    pub(crate) async fn get(&self, map: &str) -> Result<GraphView, ServiceError> {
        let row = self.open_maps.row(map_in(map)?).await?;
        let graph = self.of(&row).await?;
        let labels = self.storage.labels(row.id, PlaceId::new(0), u32::MAX).await?;
        let label = |place: PlaceId| {
            let found = labels.binary_search_by_key(&place, |row| row.place);
            found.ok().map(|index| labels[index].label.clone())
        };
        let spaces = tokio::task::spawn_blocking({
            let graph = graph.clone();
            move || graph.spaces().to_vec()
        });
        let spaces = spaces.await.map_err(ServiceError::internal)?;
        let nodes = graph.places().iter().zip(spaces);
        Ok(GraphView {
            map: map_name(&row.name),
            nodes: nodes.map(|(&place, space)| NodeView { place, space, label: label(place) }).collect(),
            links: graph.links().collect(),
        })
    }

    /// The graph of a map with all that its log has by now.
    pub(super) async fn of(&self, row: &MapRow) -> Result<Arc<Graph>, ServiceError> {
        if map_settings::from_json(&row.settings)?.strategy != NavigationStrategy::Appearance {
            return Err(ServiceError::precondition(format_args!(
                "the map {} is not navigated by appearance, so its places form no graph of what they look like; make a \
                 map with the navigation strategy appearance",
                row.name
            )));
        }
        let map = self.open_maps.open_of(row).await?;
        map.appearance().up_to_date(self.ground(map.edition(), row).await?).await
    }

    /// Has the graph of an open map take in what came lately.
    pub(super) fn grow(&self, map: &MapHandle, name: &str) {
        let Some(growing) = map.appearance().wanted() else { return };
        let graphs = self.clone();
        let name = name.to_owned();
        let map = map.edition();
        self.jobs.track(async move {
            let grown = async {
                let row = graphs.open_maps.row(&name).await?;
                if row.edition() != map {
                    return Ok(());
                }
                growing.grow(graphs.ground(map, &row).await?).await
            };
            match grown.await {
                Ok(()) => {}
                // It was deleted meanwhile, or the server stops.
                Err(ServiceError::NotFound { .. } | ServiceError::Unavailable { .. }) => {}
                Err(error) => tracing::warn!(map = name, %error, "the appearance graph did not grow"),
            }
        });
    }

    async fn ground(&self, map: MapEdition, row: &MapRow) -> Result<Ground, ServiceError> {
        Ok(Ground {
            storage: self.storage.clone(),
            runtime: Handle::current(),
            map,
            model: self.models.get(&row.model).await?,
            stopping: self.stopping.clone(),
        })
    }
}
