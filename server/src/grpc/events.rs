use futures::StreamExt;
use futures::stream::BoxStream;
use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::event_service_server::EventService;

use super::Adapter;
use super::reach::within;
use crate::pages::Page;
use crate::wire::events::{map_event, metrics_history, refusal};

#[tonic::async_trait]
impl EventService for Adapter {
    type WatchStream = BoxStream<'static, Result<v1::MapEvent, Status>>;

    async fn watch(&self, request: Request<v1::WatchRequest>) -> Result<Response<Self::WatchStream>, Status> {
        let v1::WatchRequest { map, from_position, log } = within(request)?;
        let events = self.service.events.watch(&map, from_position, &log).await?;
        Ok(Response::new(events.map(|event| Ok(map_event(event?))).boxed()))
    }

    async fn get_metrics_history(
        &self,
        request: Request<v1::GetMetricsHistoryRequest>,
    ) -> Result<Response<v1::MetricsHistory>, Status> {
        let v1::GetMetricsHistoryRequest {} = request.into_inner();
        Ok(Response::new(metrics_history(self.service.history.view())))
    }

    async fn list_refusals(
        &self,
        request: Request<v1::ListRefusalsRequest>,
    ) -> Result<Response<v1::ListRefusalsResponse>, Status> {
        let v1::ListRefusalsRequest { page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.refusals.list(page_size, &page_token)?;
        let refusals = items.into_iter().map(refusal).collect();
        Ok(Response::new(v1::ListRefusalsResponse { refusals, next_page_token: next }))
    }
}
