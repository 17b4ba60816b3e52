//! Models: training, files, lists.

use std::io;

use futures::{Stream, StreamExt, TryStreamExt};
use tokio::io::{AsyncRead, AsyncWrite};
use waypost_proto::v1;
use waypost_proto::v1::train_model_request::Content;

use super::transfer::{chunks, download, upload};
use crate::client::{Call, Client, MAX_REQUEST_BYTES, PAGE_SIZE};
use crate::error::Error;

impl Client {
    /// Uploads JPEG or PNG images, in the order in which they were taken, and trains a model from
    /// them: what is learnt of revisits and look-alikes comes from neighbours in a drive. Returns
    /// the job that does so; see [`watch_job`](Self::watch_job). To stop the upload, let `images` yield an error: a call that
    /// is only dropped may look complete to the server.
    ///
    /// # Errors
    /// [`Error::Read`] if an image cannot be read: no model is trained. [`Error::Status`] if the
    /// server refuses the settings or an image.
    pub async fn train_model(
        &self,
        settings: v1::TrainModelSettings,
        images: impl Stream<Item = io::Result<Vec<u8>>> + Send + 'static,
    ) -> Result<v1::Job, Error> {
        let settings = futures::stream::once(async { Ok(Content::Settings(settings)) });
        let requests = settings
            .chain(images.map_ok(Content::Image))
            .map_ok(|content| v1::TrainModelRequest { content: Some(content) });
        let mut models = self.models_client();
        let unsendable =
            || v1::TrainModelRequest { content: Some(Content::Image(vec![0; MAX_REQUEST_BYTES])) };
        let call = |requests| async move { models.train_model(requests).await };
        upload(requests, unsendable, self.endpoint(), call).await
    }

    /// All models, newest first.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub fn models(&self) -> Call<'_, Vec<v1::Model>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let request = v1::ListModelsRequest { page_size: PAGE_SIZE, page_token };
                let page = self.models_client().list_models(request).await?.into_inner();
                Ok((page.models, page.next_page_token))
            })
            .await
        })
    }

    /// A model by its hash, by the beginning of it, or by a display name that only one model has.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn model<'a>(&'a self, name: &'a str) -> Call<'a, v1::Model> {
        Box::pin(async move {
            self.taken(self.models_client().get_model(v1::GetModelRequest { name: name.to_owned() }).await)
        })
    }

    /// Writes a model file; returns its length in bytes.
    ///
    /// # Errors
    /// [`Error::Write`] if it cannot be written, [`Error::Status`] with NOT_FOUND.
    pub async fn export_model(&self, name: &str, file: &mut (impl AsyncWrite + Unpin)) -> Result<u64, Error> {
        let request = v1::ExportModelRequest { name: name.to_owned() };
        let response = self.models_client().export_model(request).await;
        download(self, response, |v1::ExportModelResponse { chunk }| chunk, file).await
    }

    /// Uploads a model file. With an empty display name the server chooses one.
    ///
    /// # Errors
    /// [`Error::Read`] if the file cannot be read, [`Error::Status`] if it is no model file.
    pub async fn import_model(
        &self,
        display_name: &str,
        file: impl AsyncRead + Send + Unpin + 'static,
    ) -> Result<v1::Model, Error> {
        let display_name = display_name.to_owned();
        let requests = chunks(file)
            .map_ok(move |chunk| v1::ImportModelRequest { display_name: display_name.clone(), chunk });
        let mut models = self.models_client();
        let unsendable =
            || v1::ImportModelRequest { display_name: String::new(), chunk: vec![0; MAX_REQUEST_BYTES] };
        let call = |requests| async move { models.import_model(requests).await };
        upload(requests, unsendable, self.endpoint(), call).await
    }

    /// Gives a model another display name.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or INVALID_ARGUMENT for what is no name.
    pub fn rename_model<'a>(&'a self, name: &'a str, display_name: &'a str) -> Call<'a, v1::Model> {
        Box::pin(async move {
            let request =
                v1::RenameModelRequest { name: name.to_owned(), display_name: display_name.to_owned() };
            self.taken(self.models_client().rename_model(request).await)
        })
    }

    /// Deletes a model that no map uses.
    ///
    /// # Errors
    /// [`Error::Status`] with FAILED_PRECONDITION while a map uses it.
    pub fn delete_model<'a>(&'a self, name: &'a str) -> Call<'a, ()> {
        Box::pin(async move {
            let request = v1::DeleteModelRequest { name: name.to_owned() };
            let v1::DeleteModelResponse {} = self.taken(self.models_client().delete_model(request).await)?;
            Ok(())
        })
    }
}
