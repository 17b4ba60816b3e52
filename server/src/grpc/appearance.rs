use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::appearance_service_server::AppearanceService;

use super::Adapter;
use super::reach::within;
use crate::wire::places::graph;

#[tonic::async_trait]
impl AppearanceService for Adapter {
    async fn get_appearance_graph(
        &self,
        request: Request<v1::GetAppearanceGraphRequest>,
    ) -> Result<Response<v1::AppearanceGraph>, Status> {
        let v1::GetAppearanceGraphRequest { map } = within(request)?;
        Ok(Response::new(graph(self.service.appearance.get(&map).await?)))
    }
}
