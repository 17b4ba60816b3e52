use bytes::Bytes;
use futures::stream::{self, BoxStream, StreamExt};
use tonic::{Request, Response, Status, Streaming};
use waypost_proto::v1;
use waypost_proto::v1::model_service_server::ModelService;
use waypost_proto::v1::train_model_request::Content;

use super::Adapter;
use crate::pages::Page;
use crate::service::models::MAX_MODEL_BYTES;
use crate::wire::jobs::job;
use crate::wire::models::model;

/// Size of the chunks that a model file is sent in.
const CHUNK_BYTES: usize = 1 << 20;

#[tonic::async_trait]
impl ModelService for Adapter {
    async fn train_model(
        &self,
        request: Request<Streaming<v1::TrainModelRequest>>,
    ) -> Result<Response<v1::Job>, Status> {
        let mut requests = request.into_inner();
        let first = self.first(&mut requests).await?.and_then(|first| first.content);
        let Some(Content::Settings(settings)) = first else {
            return Err(Status::invalid_argument("the first message of a training must be its settings"));
        };
        let v1::TrainModelSettings { display_name, extractor, words, seed, image_count } = settings;
        let extractor = extractor.unwrap_or_default();
        let mut upload =
            self.service.models.begin_training(&display_name, &extractor, words, seed, image_count)?;
        while let Some(v1::TrainModelRequest { content }) = self.next(&mut requests).await? {
            match content {
                Some(Content::Image(image)) => {
                    self.service.models.add_training_image(&mut upload, Bytes::from(image)).await?;
                }
                Some(Content::Settings(_)) | None => {
                    return Err(Status::invalid_argument(
                        "after the settings, each message must be an image",
                    ));
                }
            }
        }
        Ok(Response::new(job(self.service.models.start_training(upload).await?)))
    }

    async fn list_models(
        &self,
        request: Request<v1::ListModelsRequest>,
    ) -> Result<Response<v1::ListModelsResponse>, Status> {
        let v1::ListModelsRequest { page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.models.list(page_size, &page_token).await?;
        let models = items.into_iter().map(model).collect();
        Ok(Response::new(v1::ListModelsResponse { models, next_page_token: next }))
    }

    async fn get_model(&self, request: Request<v1::GetModelRequest>) -> Result<Response<v1::Model>, Status> {
        let v1::GetModelRequest { name } = request.into_inner();
        Ok(Response::new(model(self.service.models.find(&name).await?)))
    }

    type ExportModelStream = BoxStream<'static, Result<v1::ExportModelResponse, Status>>;

    async fn export_model(
        &self,
        request: Request<v1::ExportModelRequest>,
    ) -> Result<Response<Self::ExportModelStream>, Status> {
        let v1::ExportModelRequest { name } = request.into_inner();
        let mut file = Bytes::from(self.service.models.export(&name).await?);
        let chunks = std::iter::from_fn(move || {
            let chunk = file.split_to(file.len().min(CHUNK_BYTES));
            (!chunk.is_empty()).then(|| Ok(v1::ExportModelResponse { chunk: chunk.into() }))
        });
        Ok(Response::new(stream::iter(chunks).boxed()))
    }

    async fn import_model(
        &self,
        request: Request<Streaming<v1::ImportModelRequest>>,
    ) -> Result<Response<v1::Model>, Status> {
        let mut requests = request.into_inner();
        let mut name = None;
        let mut file = Vec::new();
        while let Some(v1::ImportModelRequest { display_name, chunk }) = self.next(&mut requests).await? {
            name.get_or_insert(display_name);
            file.extend_from_slice(&chunk);
            if file.len() > MAX_MODEL_BYTES {
                let message =
                    format!("a model file has at most {MAX_MODEL_BYTES} bytes; train one with fewer words");
                return Err(Status::resource_exhausted(message));
            }
        }
        Ok(Response::new(model(self.service.models.import(&name.unwrap_or_default(), file).await?)))
    }

    async fn rename_model(
        &self,
        request: Request<v1::RenameModelRequest>,
    ) -> Result<Response<v1::Model>, Status> {
        let v1::RenameModelRequest { name, display_name } = request.into_inner();
        Ok(Response::new(model(self.service.models.rename(&name, &display_name).await?)))
    }

    async fn delete_model(
        &self,
        request: Request<v1::DeleteModelRequest>,
    ) -> Result<Response<v1::DeleteModelResponse>, Status> {
        let v1::DeleteModelRequest { name } = request.into_inner();
        self.service.models.delete(&name).await?;
        Ok(Response::new(v1::DeleteModelResponse {}))
    }
}
