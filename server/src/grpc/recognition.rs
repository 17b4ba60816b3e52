use bytes::Bytes;
use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::query_request;
use waypost_proto::v1::recognition_service_server::RecognitionService;

use super::Adapter;
use super::reach::with_caller;
use crate::ingest::content::Content;
use crate::wire::recognition::query_response;
use crate::wire::sessions::{histogram, word_list};

#[tonic::async_trait]
impl RecognitionService for Adapter {
    async fn query(&self, request: Request<v1::QueryRequest>) -> Result<Response<v1::QueryResponse>, Status> {
        let (caller, message) = with_caller(request)?;
        let v1::QueryRequest { map, content, words_hash, explained_words } = message;
        caller.check_resource(&map)?;
        let content = match content {
            Some(query_request::Content::Image(image)) => Content::Image(Bytes::from(image)),
            Some(query_request::Content::Histogram(words)) => histogram(words),
            Some(query_request::Content::Words(words)) => word_list(words),
            None => return Err(Status::invalid_argument("the query shows nothing; send an image or words")),
        };
        let answer = self.service.queries.query(&caller, &map, content, &words_hash, explained_words).await?;
        Ok(Response::new(query_response(answer)))
    }
}
