use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::label_service_server::LabelService;

use super::Adapter;
use super::reach::within;
use crate::names::{map_in, place_in};
use crate::pages::Page;
use crate::service::labels::LabelScope;
use crate::wire::known;
use crate::wire::places::labels;

#[tonic::async_trait]
impl LabelService for Adapter {
    async fn list_labels(
        &self,
        request: Request<v1::ListLabelsRequest>,
    ) -> Result<Response<v1::ListLabelsResponse>, Status> {
        let v1::ListLabelsRequest { map, page_size, page_token } = within(request)?;
        let Page { items, next } = self.service.labels.list(&map, page_size, &page_token).await?;
        let labels = labels(map_in(&map)?, items);
        Ok(Response::new(v1::ListLabelsResponse { labels, next_page_token: next }))
    }

    async fn set_label(
        &self,
        request: Request<v1::SetLabelRequest>,
    ) -> Result<Response<v1::SetLabelResponse>, Status> {
        let v1::SetLabelRequest { place, label, scope } = within(request)?;
        let scope = match known("scope", scope)? {
            v1::LabelScope::Unspecified | v1::LabelScope::Place => LabelScope::Place,
            v1::LabelScope::Space => LabelScope::Space,
        };
        let set = self.service.labels.set(&place, &label, scope).await?;
        let (map, _) = place_in(&place)?;
        Ok(Response::new(v1::SetLabelResponse { labels: labels(map, set) }))
    }

    async fn delete_label(
        &self,
        request: Request<v1::DeleteLabelRequest>,
    ) -> Result<Response<v1::DeleteLabelResponse>, Status> {
        let v1::DeleteLabelRequest { place } = within(request)?;
        self.service.labels.delete(&place).await?;
        Ok(Response::new(v1::DeleteLabelResponse {}))
    }
}
