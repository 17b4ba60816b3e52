//! Maps without metres: which places can be matched from which, the spaces that they form, and what people call them.

mod graph;
mod growth;
mod labels;

use std::sync::Arc;

use fabmap::appearance::PlaceId;
use tokio::runtime::Handle;

pub(crate) use self::graph::{Graph, Shown};
use self::growth::Ground;
pub(crate) use self::growth::GrowingGraph;
pub(crate) use self::labels::LabelReach;
pub(super) use self::labels::check_label;
use super::Service;
use super::map_settings::{self, NavigationStrategy};
use super::map_writer::MapHandle;
use super::names::{map_in, map_name};
use crate::error::ServiceError;
use crate::storage::{MapEdition, MapRow};

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
    pub(crate) label: String,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LinkView {
    pub(crate) from: PlaceId,
    pub(crate) to: PlaceId,
    pub(crate) similarity: f64,
}

impl Service {
    /// The graph of a map with spaces and labels.
    pub(crate) async fn appearance_graph(self: &Arc<Self>, map: &str) -> Result<GraphView, ServiceError> {
        let row = self.map_row(map_in(map)?).await?;
        let graph = self.graph_of(&row).await?;
        let labels = self.storage.labels(row.id, 0, u32::MAX).await?;
        let label = |place: PlaceId| {
            let found = labels.binary_search_by_key(&place, |row| row.place);
            found.map_or_else(|_| String::new(), |index| labels[index].label.clone())
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
    pub(super) async fn graph_of(self: &Arc<Self>, row: &MapRow) -> Result<Arc<Graph>, ServiceError> {
        if map_settings::from_json(&row.settings)?.strategy != NavigationStrategy::Appearance {
            return Err(ServiceError::precondition(format_args!(
                "the map {} is not navigated by appearance, so its places form no graph of what they look like; make a \
                 map with the navigation strategy appearance",
                row.name
            )));
        }
        let map = self.open_map_of(row).await?;
        map.appearance().up_to_date(self.ground(map.edition(), row).await?).await
    }

    /// Has the graph of an open map take in what came lately.
    pub(super) fn grow_graph(self: &Arc<Self>, map: &MapHandle, name: &str) {
        let Some(growing) = map.appearance().wanted() else { return };
        let (service, name, map) = (self.clone(), name.to_owned(), map.edition());
        self.jobs.track(async move {
            let grown = async {
                let row = service.map_row(&name).await?;
                if row.edition() != map {
                    return Ok(());
                }
                growing.grow(service.ground(map, &row).await?).await
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
            model: self.loaded_model(&row.model).await?,
            stopping: self.stopping.clone(),
        })
    }
}
