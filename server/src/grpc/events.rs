use futures::StreamExt;
use futures::stream::BoxStream;
use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::event_service_server::EventService;

use super::Adapter;
use super::reach::within;
use crate::wire::events::map_event;

#[tonic::async_trait]
impl EventService for Adapter {
    type WatchStream = BoxStream<'static, Result<v1::MapEvent, Status>>;

    async fn watch(&self, request: Request<v1::WatchRequest>) -> Result<Response<Self::WatchStream>, Status> {
        let v1::WatchRequest { map, from_position, log } = within(request)?;
        let events = self.service.events.watch(&map, from_position, &log).await?;
        Ok(Response::new(events.map(|event| Ok(map_event(event?))).boxed()))
    }
}
