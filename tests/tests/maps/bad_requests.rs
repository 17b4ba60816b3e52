//! Bad requests about maps, models and jobs: an exact code, a message that helps, nothing changed.

use std::io::Cursor;

use tonic::{Code, Status};
use waypost_client::Client;
use waypost_proto::v1;
use waypost_proto::v1::job_service_client::JobServiceClient;
use waypost_proto::v1::map_service_client::MapServiceClient;
use waypost_proto::v1::model_service_client::ModelServiceClient;
use waypost_proto::v1::train_model_request::Content;

use crate::harness::{
    Server, answers, as_words, assert_status, channel, images, in_time, map_request, model_file, refused,
};

#[track_caller]
fn assert_refused<T: std::fmt::Debug>(case: &str, result: Result<T, Status>, code: Code, fragment: &str) {
    match result {
        Err(status) => assert_status(case, (status.code(), status.message()), code, fragment),
        Ok(taken) => panic!("{case}: not refused: {taken:?}"),
    }
}

/// All that a server lists; what a bad request must leave alone.
async fn listed(client: &Client) -> (Vec<v1::Map>, Vec<v1::Model>) {
    (client.maps().await.unwrap(), client.models().await.unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn maps_that_cannot_be_made() {
    let (server, client) = Server::with_map().await;
    let before = listed(&client).await;
    let bare = |settings| v1::CreateMapRequest { settings: Some(settings), ..map_request("new", "shipped") };
    let threshold = |value| bare(v1::MapSettings { closure_threshold: Some(value), ..Default::default() });
    let prior = |value| bare(v1::MapSettings { new_place_prior: Some(value), ..Default::default() });
    let rates = |true_positive_rate, false_positive_rate| {
        bare(v1::MapSettings { true_positive_rate, false_positive_rate, ..Default::default() })
    };
    let invalid = Code::InvalidArgument;
    let unknown_hash = format!("models/{}", "0".repeat(64));
    let cases = [
        (
            "unknown model",
            map_request("new", "nowhere"),
            Code::NotFound,
            "there is no model \"nowhere\"; list the models",
        ),
        ("unknown hash", map_request("new", &unknown_hash), Code::NotFound, "train or import one"),
        ("no model digits", map_request("new", "models/"), invalid, "write models/"),
        (
            "duplicate",
            map_request("drive", "shipped"),
            Code::AlreadyExists,
            "choose another name, or delete it first",
        ),
        ("no name", map_request("", "shipped"), invalid, "is no map name; use 1 to 63"),
        ("capitals", map_request("Drive", "shipped"), invalid, "a-z, 0-9, - and _"),
        ("a path", map_request("a/b", "shipped"), invalid, "is no map name"),
        ("with collection", map_request("maps/new", "shipped"), invalid, "is no map name"),
        ("64 characters", map_request(&"x".repeat(64), "shipped"), invalid, "1 to 63"),
        ("threshold 0", threshold(0.0), invalid, "above 0 and at most 1, not 0"),
        ("threshold NaN", threshold(f64::NAN), invalid, "not NaN"),
        ("threshold 1.5", threshold(1.5), invalid, "not 1.5"),
        ("threshold below 0", threshold(-0.1), invalid, "closure threshold"),
        ("prior 0", prior(0.0), invalid, "prior of a new place must lie between 0 and 1"),
        ("prior 1", prior(1.0), invalid, "between 0 and 1, not 1"),
        ("prior NaN", prior(f64::NAN), invalid, "prior of a new place"),
        ("one rate", rates(Some(0.4), None), invalid, "both rates of the detector"),
        ("other rate", rates(None, Some(0.01)), invalid, "both rates of the detector"),
        ("rates swapped", rates(Some(0.01), Some(0.4)), invalid, "below the true positive rate"),
        ("rate above 1", rates(Some(1.4), Some(0.01)), invalid, "true positive rate"),
        ("rate NaN", rates(Some(0.4), Some(f64::NAN)), invalid, "false positive rate"),
    ];
    for (case, request, code, fragment) in cases {
        let (found, message) = refused(in_time(client.create_map(request)).await);
        assert_status(case, (found, &message), code, fragment);
    }
    assert_eq!(listed(&client).await, before);

    let all = v1::MapSettings {
        dependence: v1::map_settings::Dependence::NaiveBayes.into(),
        new_place: v1::map_settings::NewPlace::MeanField.into(),
        closure_threshold: Some(1.0),
        guard_frames: Some(3),
        new_place_prior: Some(0.8),
        true_positive_rate: Some(0.4),
        false_positive_rate: Some(0.0),
        keep: v1::map_settings::Keep::Images.into(),
        verification: v1::map_settings::Verification::Epipolar.into(),
        place_spacing_m: Some(0.3),
        place_spacing_rad: Some(0.25),
        navigation_strategy: v1::map_settings::NavigationStrategy::Appearance.into(),
    };
    let made = client.create_map(bare(all)).await.unwrap();
    assert_eq!(made.settings, Some(all));
    server.stop().await;
}

/// An empty name is a forgotten field, not the name of a model that has no display name.
#[tokio::test(flavor = "multi_thread")]
async fn an_empty_name_names_no_model() {
    let server = Server::start().await;
    let client = server.client().await;
    let file = tokio::fs::File::open(model_file()).await.unwrap();
    client.import_model("", file).await.unwrap();
    let before = listed(&client).await;
    for (case, result) in [
        ("get", client.model("").await.map(drop)),
        ("export", client.export_model("", &mut Cursor::new(Vec::new())).await.map(drop)),
        ("delete", client.delete_model("").await),
    ] {
        let (code, message) = refused(result);
        assert!(matches!(code, Code::InvalidArgument | Code::NotFound), "{case}: {code:?} {message}");
    }
    assert_eq!(listed(&client).await, before);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_not_there_is_not_found() {
    let (server, client) = Server::with_map().await;
    let before = listed(&client).await;
    let (found, invalid) = (Code::NotFound, Code::InvalidArgument);
    let nowhere = "there is no map nowhere; list the maps to see what there is";
    let full = v1::MapView::Full;
    let cases = [
        ("get map", client.map("nowhere", full).await.map(drop), found, nowhere),
        ("delete map", client.delete_map("nowhere").await, found, nowhere),
        ("places", client.places("nowhere").await.map(drop), found, nowhere),
        ("matches", client.loop_closures("nowhere").await.map(drop), found, nowhere),
        ("get bad map", client.map("No Where", full).await.map(drop), invalid, "is no map name"),
        ("delete bad map", client.delete_map("maps/").await, invalid, "write maps/"),
        ("get model", client.model("nowhere").await.map(drop), found, "there is no model \"nowhere\""),
        (
            "short hash",
            client.model(&before.1[0].name["models/".len()..][..5]).await.map(drop),
            found,
            "there is no model",
        ),
        ("delete model", client.delete_model("nowhere").await, found, "there is no model"),
        (
            "export",
            client.export_model("nowhere", &mut Vec::new()).await.map(drop),
            found,
            "there is no model",
        ),
        (
            "model in use",
            client.delete_model("shipped").await,
            Code::FailedPrecondition,
            "delete the map first",
        ),
        (
            "job",
            client.job("jobs/7").await.map(drop),
            found,
            "there is no job jobs/7; list the jobs to see what there is",
        ),
        ("watch", client.watch_job("jobs/7").await.map(drop), found, "list the jobs"),
        ("cancel", client.cancel_job("jobs/0").await.map(drop), found, "there is no job"),
        ("job of words", client.job("jobs/first").await.map(drop), found, "there is no job"),
        ("no job", client.job("7").await.map(drop), invalid, "write jobs/"),
    ];
    for (case, result, code, fragment) in cases {
        let (refused, message) = refused(result);
        assert_status(case, (refused, &message), code, fragment);
    }
    assert_eq!(listed(&client).await, before);

    client.delete_map("drive").await.unwrap();
    client.delete_model("shipped").await.unwrap();
    assert_eq!(listed(&client).await, (vec![], vec![]));
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn files_that_are_no_models() {
    let server = Server::start().await;
    let client = server.client().await;
    let good = std::fs::read(model_file()).unwrap();
    let (mut flipped, mut newer, mut longer) = (good.clone(), good.clone(), good.clone());
    flipped[good.len() / 2] ^= 1;
    // Eight magic bytes, then the version, low byte first.
    newer[8] = 99;
    longer.push(0);
    let cases = [
        ("empty", vec![], "not a Waypost model file"),
        ("garbage", b"ORBvoc.txt 10 6 0 0".to_vec(), "not a Waypost model file; check which file"),
        ("an image", images()[0].clone(), "not a Waypost model file"),
        ("truncated", good[..good.len() / 3].to_vec(), "was cut short, so fetch it again"),
        ("without its checksum", good[..good.len() - 32].to_vec(), "was cut short"),
        ("flipped bit", flipped, "the checksum does not match"),
        ("newer version", newer, "format version 99, this program reads up to 3; update Waypost"),
        ("longer", longer, "follow the end of the content"),
    ];
    for (case, file, fragment) in cases {
        let (code, message) = refused(in_time(client.import_model("bad", Cursor::new(file))).await);
        assert_status(case, (code, &message), Code::InvalidArgument, fragment);
    }
    for (case, name) in
        [("control character", "a\nb"), ("a slash", "models/x"), ("101 characters", &"x".repeat(101))]
    {
        let (code, message) = refused(client.import_model(name, Cursor::new(good.clone())).await);
        assert_status(
            case,
            (code, &message),
            Code::InvalidArgument,
            "a display name has at most 100 characters",
        );
    }
    assert!(client.models().await.unwrap().is_empty());

    let first = client.import_model("first", Cursor::new(good.clone())).await.unwrap();
    // A model that is there stays as it is.
    assert_eq!(client.import_model("second", Cursor::new(good)).await.unwrap(), first);
    assert_eq!(client.models().await.unwrap(), [first]);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_have_sizes_and_tokens() {
    let (server, client) = Server::with_map().await;
    for map in ["a", "b", "c"] {
        client.create_map(map_request(map, "shipped")).await.unwrap();
    }
    answers(&client, "drive", "robot", (1..=4).map(as_words)).await;
    let mut maps = MapServiceClient::new(channel(&server.endpoint()).await);
    let mut models = ModelServiceClient::new(channel(&server.endpoint()).await);
    let map = || "maps/drive".to_owned();
    for (page_size, page_token, fragment) in [
        (1001, "", "at most 1000 entries, not 1001"),
        (u32::MAX, "", "at most 1000 entries"),
        (0, "Not A Token!", "begin again without one"),
        (0, "-1", "begin again without one"),
    ] {
        let case = format!("size {page_size}, token {page_token:?}");
        let token = page_token.to_owned();
        let request = v1::ListMapsRequest { page_size, page_token: token.clone() };
        assert_refused(&case, maps.list_maps(request).await, Code::InvalidArgument, fragment);
        let request = v1::ListModelsRequest { page_size, page_token: token.clone() };
        assert_refused(&case, models.list_models(request).await, Code::InvalidArgument, fragment);
        let request =
            v1::ListPlacesRequest { map: map(), page_size, page_token: token.clone(), ..Default::default() };
        assert_refused(&case, maps.list_places(request).await, Code::InvalidArgument, fragment);
        let request = v1::ListLoopClosuresRequest { map: map(), page_size, page_token: token };
        assert_refused(&case, maps.list_loop_closures(request).await, Code::InvalidArgument, fragment);
    }

    let mut names = Vec::new();
    let mut page_token = String::new();
    loop {
        let request = v1::ListMapsRequest { page_size: 3, page_token };
        let page = maps.list_maps(request).await.unwrap().into_inner();
        assert!(page.maps.len() <= 3);
        names.extend(page.maps.into_iter().map(|map| map.name));
        page_token = page.next_page_token;
        if page_token.is_empty() {
            break;
        }
    }
    assert_eq!(names, ["maps/a", "maps/b", "maps/c", "maps/drive"]);

    let all = client.places("drive").await.unwrap();
    let request =
        |page_token| v1::ListPlacesRequest { map: map(), page_size: 1, page_token, ..Default::default() };
    let mut one_by_one = Vec::new();
    let mut next = String::new();
    while one_by_one.is_empty() || !next.is_empty() {
        let page = maps.list_places(request(next)).await.unwrap().into_inner();
        one_by_one.extend(page.places);
        next = page.next_page_token;
    }
    assert_eq!(one_by_one, all);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn trainings_that_cannot_begin() {
    let (server, client) = Server::with_map().await;
    let before = listed(&client).await;
    let settings = |words| v1::TrainModelSettings { words, seed: 1, ..v1::TrainModelSettings::default() };
    let first = |settings| Content::Settings(settings);
    let good = || Content::Image(images()[0].clone());
    let extractor =
        |text: &str| first(v1::TrainModelSettings { extractor: Some(text.to_owned()), ..settings(10) });
    let announced = |image_count| first(v1::TrainModelSettings { image_count, ..settings(10) });
    let long = first(v1::TrainModelSettings { display_name: "x".repeat(101), ..settings(10) });
    let cases = [
        ("nothing", vec![], "first message of a training must be its settings"),
        ("image first", vec![good()], "first message of a training must be its settings"),
        ("no images", vec![first(settings(10))], "no training image was sent"),
        ("too few images", vec![announced(Some(3)), good(), good()], "3"),
        ("too many images", vec![announced(Some(1)), good(), good()], "1"),
        ("words 0", vec![first(settings(0)), good()], "at least 2 words, not 0"),
        ("words 1", vec![first(settings(1)), good()], "at least 2 words, not 1"),
        (
            "bad image",
            vec![first(settings(10)), good(), Content::Image(b"text".to_vec())],
            "training image 2: the image is neither",
        ),
        (
            "empty image",
            vec![first(settings(10)), Content::Image(vec![])],
            "training image 1: the image is empty",
        ),
        (
            "settings twice",
            vec![first(settings(10)), first(settings(10))],
            "after the settings, each message must be an image",
        ),
        ("unknown feature", vec![extractor("surf features=500 width=640"), good()], "surf"),
        ("no feature", vec![extractor("features=many"), good()], "features"),
        ("long name", vec![long, good()], "at most 100 characters"),
    ];
    let mut models = ModelServiceClient::new(channel(&server.endpoint()).await);
    for (case, contents, fragment) in cases {
        let requests: Vec<_> =
            contents.into_iter().map(|content| v1::TrainModelRequest { content: Some(content) }).collect();
        let result = in_time(models.train_model(futures::stream::iter(requests))).await;
        assert_refused(case, result, Code::InvalidArgument, fragment);
    }
    let mut jobs = JobServiceClient::new(channel(&server.endpoint()).await);
    let result = jobs.get_job(v1::GetJobRequest { name: "jobs/1".to_owned() }).await;
    assert_refused("no job was begun", result, Code::NotFound, "there is no job");
    assert_eq!(listed(&client).await, before);
    server.stop().await;
}
