//! Models and jobs.

use tonic::{Code, Status};
use waypost_client::v1;
use waypost_proto::v1::job_service_client::JobServiceClient;
use waypost_proto::v1::model_service_client::ModelServiceClient;
use waypost_proto::v1::train_model_request::Content;

use super::maps::bad_pages;
use super::{Cases, Ground};
use crate::harness::images;

pub(super) async fn models(ground: &Ground) -> Cases {
    let mut service = ModelServiceClient::new(ground.channel().await);
    let mut cases = Cases::new("models");
    let (invalid, missing) = (Code::InvalidArgument, Code::NotFound);
    let unknown_hash = format!("models/{}", "f".repeat(64));
    let endless = "x".repeat(100_000);
    for (case, name, code, fragment) in [
        ("no name", "", invalid, "name a model: by its hash"),
        ("no hash", "models/", invalid, "write models/"),
        ("below a model", "models/a/b", invalid, "write models/"),
        ("a map", "maps/drive", missing, "list the models to see what there is"),
        ("unknown hash", &unknown_hash, missing, "train or import one"),
        ("5 digits", "abcde", missing, "list the models to see what there is"),
        ("in capitals", "Shipped", missing, "list the models to see what there is"),
        ("endless", &endless, missing, "list the models to see what there is"),
    ] {
        let mut check = |call: &str, result: Result<(), Status>| {
            cases.refused(&format!("{call}, {case}"), result, code, fragment);
        };
        let request = v1::GetModelRequest { name: name.to_owned() };
        check("get", service.get_model(request).await.map(drop));
        let request = v1::ExportModelRequest { name: name.to_owned() };
        check("export", service.export_model(request).await.map(drop));
        let request = v1::DeleteModelRequest { name: name.to_owned() };
        check("delete", service.delete_model(request).await.map(drop));
    }
    let token_of_a_model = ("the beginning of a token", 0, "1.abc", "begin again without one");
    for (case, page_size, token, fragment) in bad_pages().into_iter().chain([token_of_a_model]) {
        let request = v1::ListModelsRequest { page_size, page_token: token.to_owned() };
        cases.refused(&format!("list, {case}"), service.list_models(request).await, invalid, fragment);
    }
    let settings = |extractor: &str, words| {
        let extractor = extractor.to_owned();
        Content::Settings(v1::TrainModelSettings { words, extractor: Some(extractor), ..Default::default() })
    };
    for (case, first, fragment) in [
        ("words in millions", settings("", u32::MAX), "5000 suit a building"),
        (
            "an extractor with too much",
            settings("orb features=500 width=640 depth=3", 10),
            "feature settings",
        ),
        ("no features", settings("orb features=0 width=640", 10), "features"),
        ("an endless extractor", settings(&endless, 10), "write them like"),
    ] {
        let contents = [first, Content::Image(images()[0].clone())];
        let requests = contents.map(|content| v1::TrainModelRequest { content: Some(content) });
        let result = service.train_model(futures::stream::iter(requests)).await;
        cases.refused(&format!("train, {case}"), result, invalid, fragment);
    }
    let empty = [v1::TrainModelRequest { content: None }];
    let result = service.train_model(futures::stream::iter(empty)).await;
    cases.refused(
        "train, empty message",
        result,
        invalid,
        "first message of a training must be its settings",
    );
    for (case, display_name, chunk, fragment) in [
        ("nothing", "", Vec::new(), "not a Waypost model file"),
        ("noise", "", vec![0xff; 5000], "not a Waypost model file; check which file"),
        ("a name with a slash", "models/x", vec![1], "a display name has at most 100 characters"),
        ("an endless name", &endless, vec![1], "a display name has at most 100 characters"),
    ] {
        let request = v1::ImportModelRequest { display_name: display_name.to_owned(), chunk };
        let result = service.import_model(futures::stream::iter([request])).await;
        cases.refused(&format!("import, {case}"), result, invalid, fragment);
    }
    cases
}

pub(super) async fn jobs(ground: &Ground) -> Cases {
    let mut service = JobServiceClient::new(ground.channel().await);
    let mut cases = Cases::new("jobs");
    let (invalid, missing) = (Code::InvalidArgument, Code::NotFound);
    for (case, name, code, fragment) in [
        ("no name", "", invalid, "write jobs/"),
        ("no number", "jobs/", invalid, "write jobs/"),
        ("a bare number", "7", invalid, "write jobs/"),
        ("below a job", "jobs/7/log", invalid, "write jobs/"),
        ("negative", "jobs/-1", missing, "there is no job"),
        ("2^64", "jobs/18446744073709551616", missing, "there is no job"),
        ("unknown", "jobs/7", missing, "there is no job"),
    ] {
        let mut check = |call: &str, result: Result<(), Status>| {
            cases.refused(&format!("{call}, {case}"), result, code, fragment);
        };
        check("get", service.get_job(v1::GetJobRequest { name: name.to_owned() }).await.map(drop));
        check("watch", service.watch_job(v1::WatchJobRequest { name: name.to_owned() }).await.map(drop));
        check("cancel", service.cancel_job(v1::CancelJobRequest { name: name.to_owned() }).await.map(drop));
    }
    cases
}
