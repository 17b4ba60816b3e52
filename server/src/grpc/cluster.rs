use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::cluster_service_server::ClusterService;

use super::Adapter;
use crate::wire::cluster::cluster;

#[tonic::async_trait]
impl ClusterService for Adapter {
    async fn get_cluster(
        &self,
        request: Request<v1::GetClusterRequest>,
    ) -> Result<Response<v1::Cluster>, Status> {
        let v1::GetClusterRequest {} = request.into_inner();
        Ok(Response::new(cluster(self.service.cluster.view().await?)))
    }
}
