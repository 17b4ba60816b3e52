use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::appearance_service_server::AppearanceService;

use super::Adapter;
use super::convert::known;
use crate::service::appearance::{GraphView, LabelReach, LinkView, NodeView};
use crate::service::models::Page;
use crate::service::names::{map_in, place_in, place_name};
use crate::storage::LabelRow;

#[tonic::async_trait]
impl AppearanceService for Adapter {
    async fn list_labels(
        &self,
        request: Request<v1::ListLabelsRequest>,
    ) -> Result<Response<v1::ListLabelsResponse>, Status> {
        let v1::ListLabelsRequest { map, page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.list_labels(&map, page_size, &page_token).await?;
        let labels = labels(map_in(&map)?, items);
        Ok(Response::new(v1::ListLabelsResponse { labels, next_page_token: next }))
    }

    async fn set_label(
        &self,
        request: Request<v1::SetLabelRequest>,
    ) -> Result<Response<v1::SetLabelResponse>, Status> {
        let v1::SetLabelRequest { place, label, reach } = request.into_inner();
        let reach = match known("reach", reach)? {
            v1::LabelReach::Unspecified | v1::LabelReach::Place => LabelReach::Place,
            v1::LabelReach::Space => LabelReach::Space,
        };
        let set = self.service.set_label(&place, &label, reach).await?;
        let (map, _) = place_in(&place)?;
        Ok(Response::new(v1::SetLabelResponse { labels: labels(map, set) }))
    }

    async fn delete_label(
        &self,
        request: Request<v1::DeleteLabelRequest>,
    ) -> Result<Response<v1::DeleteLabelResponse>, Status> {
        let v1::DeleteLabelRequest { place } = request.into_inner();
        self.service.delete_label(&place).await?;
        Ok(Response::new(v1::DeleteLabelResponse {}))
    }

    async fn get_appearance_graph(
        &self,
        request: Request<v1::GetAppearanceGraphRequest>,
    ) -> Result<Response<v1::AppearanceGraph>, Status> {
        let v1::GetAppearanceGraphRequest { map } = request.into_inner();
        Ok(Response::new(graph(self.service.appearance_graph(&map).await?)))
    }
}

fn labels(map: &str, rows: Vec<LabelRow>) -> Vec<v1::PlaceLabel> {
    let label = |LabelRow { place, label }| v1::PlaceLabel { place: place_name(map, place), label };
    rows.into_iter().map(label).collect()
}

fn graph(view: GraphView) -> v1::AppearanceGraph {
    let GraphView { map, nodes, links } = view;
    let node = |NodeView { place, space, label }| v1::AppearanceNode { place, space, label };
    let link =
        |LinkView { from, to, similarity }| v1::AppearanceLink { from_place: from, to_place: to, similarity };
    v1::AppearanceGraph {
        map,
        nodes: nodes.into_iter().map(node).collect(),
        links: links.into_iter().map(link).collect(),
    }
}
