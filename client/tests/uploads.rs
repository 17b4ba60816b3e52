//! Uploads: complete, or not taken at all.
#![allow(clippy::unwrap_used, clippy::expect_used, missing_docs)]

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll};

use futures::stream::{self, BoxStream};
use tokio::io::{AsyncRead, ReadBuf};
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::transport::Server;
use tonic::{Request, Response, Status, Streaming};
use waypost_client::{Client, Error, v1};
use waypost_proto::v1::model_service_server::{ModelService, ModelServiceServer};
use waypost_proto::v1::train_model_request::Content;

/// What a server of models was sent.
#[derive(Debug, PartialEq)]
enum Seen {
    Images(Vec<Vec<u8>>),
    File { display_name: String, length_bytes: usize },
    BrokenOff,
}

struct Models {
    seen: mpsc::UnboundedSender<Seen>,
}

/// Says that a call was broken off, unless it was told otherwise.
struct Call(mpsc::UnboundedSender<Seen>, Option<Seen>);

impl Drop for Call {
    fn drop(&mut self) {
        // A test that is over does not listen.
        let _ = self.0.send(self.1.take().unwrap_or(Seen::BrokenOff));
    }
}

#[tonic::async_trait]
impl ModelService for Models {
    async fn train_model(
        &self,
        request: Request<Streaming<v1::TrainModelRequest>>,
    ) -> Result<Response<v1::Job>, Status> {
        let mut call = Call(self.seen.clone(), None);
        let mut requests = request.into_inner();
        let mut images = Vec::new();
        while let Some(request) = requests.message().await? {
            match request.content {
                Some(Content::Image(image)) => images.push(image),
                Some(Content::Settings(settings)) => assert_eq!(settings.words, 100),
                None => return Err(Status::invalid_argument("empty")),
            }
        }
        call.1 = Some(Seen::Images(images));
        Ok(Response::new(v1::Job::default()))
    }

    async fn import_model(
        &self,
        request: Request<Streaming<v1::ImportModelRequest>>,
    ) -> Result<Response<v1::Model>, Status> {
        let mut call = Call(self.seen.clone(), None);
        let mut requests = request.into_inner();
        let (mut display_name, mut length_bytes) = (None, 0);
        while let Some(request) = requests.message().await? {
            display_name.get_or_insert(request.display_name);
            length_bytes += request.chunk.len();
        }
        let display_name = display_name.ok_or(Status::invalid_argument("the file is empty"))?;
        call.1 = Some(Seen::File { display_name, length_bytes });
        Ok(Response::new(v1::Model::default()))
    }

    async fn list_models(
        &self,
        request: Request<v1::ListModelsRequest>,
    ) -> Result<Response<v1::ListModelsResponse>, Status> {
        let page: usize = request.into_inner().page_token.parse().unwrap_or(0);
        let model = v1::Model { name: format!("models/{page}"), ..Default::default() };
        let next_page_token = if page < 2 { (page + 1).to_string() } else { String::new() };
        Ok(Response::new(v1::ListModelsResponse { models: vec![model], next_page_token }))
    }

    async fn get_model(&self, _: Request<v1::GetModelRequest>) -> Result<Response<v1::Model>, Status> {
        Err(Status::unimplemented("not needed here"))
    }

    type ExportModelStream = BoxStream<'static, Result<v1::ExportModelResponse, Status>>;

    async fn export_model(
        &self,
        _: Request<v1::ExportModelRequest>,
    ) -> Result<Response<Self::ExportModelStream>, Status> {
        Err(Status::unimplemented("not needed here"))
    }

    async fn delete_model(
        &self,
        _: Request<v1::DeleteModelRequest>,
    ) -> Result<Response<v1::DeleteModelResponse>, Status> {
        Err(Status::unimplemented("not needed here"))
    }

    async fn rename_model(&self, _: Request<v1::RenameModelRequest>) -> Result<Response<v1::Model>, Status> {
        Err(Status::unimplemented("not needed here"))
    }
}

async fn server() -> (Client, mpsc::UnboundedReceiver<Seen>) {
    let (seen, told) = mpsc::unbounded_channel();
    let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0))).await.unwrap();
    let endpoint = format!("http://{}", listener.local_addr().unwrap());
    let service = ModelServiceServer::new(Models { seen }).max_decoding_message_size(8 << 20);
    tokio::spawn(
        Server::builder().add_service(service).serve_with_incoming(TcpListenerStream::new(listener)),
    );
    (Client::connect(&endpoint).await.unwrap(), told)
}

fn settings() -> v1::TrainModelSettings {
    v1::TrainModelSettings { words: 100, ..Default::default() }
}

fn unreadable() -> io::Error {
    io::Error::other("the disk is on fire")
}

#[tokio::test]
async fn images_arrive_in_order() {
    let (client, mut seen) = server().await;
    let images: Vec<Vec<u8>> = (1..=50).map(|byte| vec![byte; 100_000]).collect();
    let upload = stream::iter(images.clone().into_iter().map(Ok));
    client.train_model(settings(), upload).await.unwrap();
    assert_eq!(seen.recv().await, Some(Seen::Images(images)));
}

#[tokio::test]
async fn an_image_that_cannot_be_read_breaks_the_upload_off() {
    let (client, mut seen) = server().await;
    let upload = stream::iter([Ok(vec![1]), Ok(vec![2]), Err(unreadable())]);
    let failed = client.train_model(settings(), upload).await;
    assert!(
        matches!(&failed, Err(Error::Read(error)) if error.to_string().contains("on fire")),
        "{failed:?}"
    );
    assert_eq!(seen.recv().await, Some(Seen::BrokenOff));
}

#[tokio::test]
async fn a_model_file_arrives_with_its_name() {
    let (client, mut seen) = server().await;
    let length_bytes = (2 << 20) + 7;
    client.import_model("office", io::Cursor::new(vec![7; length_bytes])).await.unwrap();
    assert_eq!(seen.recv().await, Some(Seen::File { display_name: "office".to_owned(), length_bytes }));
}

/// Yields a chunk and then fails.
struct FailingFile {
    left_bytes: usize,
}

impl AsyncRead for FailingFile {
    fn poll_read(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.left_bytes == 0 {
            return Poll::Ready(Err(unreadable()));
        }
        let length_bytes = buffer.remaining().min(self.left_bytes);
        buffer.put_slice(&vec![1; length_bytes]);
        self.left_bytes -= length_bytes;
        Poll::Ready(Ok(()))
    }
}

#[tokio::test]
async fn a_file_that_cannot_be_read_breaks_the_upload_off() {
    let (client, mut seen) = server().await;
    let failed = client.import_model("office", FailingFile { left_bytes: 3 << 20 }).await;
    assert!(matches!(failed, Err(Error::Read(_))), "{failed:?}");
    assert_eq!(seen.recv().await, Some(Seen::BrokenOff));
}

#[tokio::test]
async fn all_pages_are_asked_for() {
    let (client, _seen) = server().await;
    let names: Vec<String> = client.models().await.unwrap().into_iter().map(|model| model.name).collect();
    assert_eq!(names, ["models/0", "models/1", "models/2"]);
}
