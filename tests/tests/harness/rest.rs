//! The REST API: asking, and a server that has something to tell.

use futures::stream;
use reqwest::StatusCode;
use reqwest::header::HeaderMap;
use serde_json::Value;
use waypost_client::{
    Client, FrameInput, FrameOutcome, Navigation, NavigationOptions, Reading, SessionOptions,
};
use waypost_proto::v1;

use super::{
    Server, answers, first_return, frame, images, in_time, session_options, stream as stream_frames,
};

/// A client that takes the direct way, whatever the environment says.
pub(crate) fn http() -> reqwest::Client {
    // The library of its TLS is for who uses it to say, though the tests have none.
    let _known = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
    reqwest::Client::builder().no_proxy().build().unwrap()
}

/// What a server answered.
pub(crate) struct Answer {
    pub(crate) status: StatusCode,
    pub(crate) headers: HeaderMap,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) async fn to(request: reqwest::RequestBuilder) -> Self {
        let response = in_time(request.send()).await.unwrap();
        let (status, headers) = (response.status(), response.headers().clone());
        Self { status, headers, body: in_time(response.bytes()).await.unwrap().to_vec() }
    }

    /// The beginning of an answer that does not end.
    pub(crate) async fn begun(request: reqwest::RequestBuilder) -> Self {
        let mut response = in_time(request.send()).await.unwrap();
        let (status, headers) = (response.status(), response.headers().clone());
        let body = in_time(response.chunk()).await.unwrap();
        Self { status, headers, body: body.map(|body| body.to_vec()).unwrap_or_default() }
    }

    pub(crate) fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().unwrap())
    }

    pub(crate) fn text(&self) -> &str {
        std::str::from_utf8(&self.body).unwrap()
    }

    /// The body, if it is JSON and says so.
    #[track_caller]
    pub(crate) fn json(&self) -> Value {
        let kind = if self.status.is_success() { "application/json" } else { "application/problem+json" };
        assert_eq!(self.header("content-type"), kind, "{}", self.text());
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.text()))
    }
}

/// What is at a path.
pub(crate) async fn get(server: &Server, path: &str) -> Answer {
    Answer::to(http().get(server.url(path))).await
}

/// The JSON that is at a path.
pub(crate) async fn found(server: &Server, path: &str) -> Value {
    let answer = get(server, path).await;
    assert_eq!(answer.status, StatusCode::OK, "{path}: {}", answer.text());
    answer.json()
}

/// A server with something of everything that can be read.
pub(crate) struct Surveyed {
    pub(crate) server: Server,
    /// Number of a training that has ended well.
    pub(crate) job: String,
    /// Numbers of merges into `drive`: of a map that overlaps with it, which waits for a decision, and of one that does
    /// not.
    pub(crate) merges: [String; 2],
    /// A hash of the words that the maps' model knows.
    pub(crate) words_hash: String,
    /// A frame of `drive` that closed a loop, and the position after its log.
    pub(crate) closed: (String, u64),
}

impl Surveyed {
    /// Maps `drive`, which keeps images, its copy `twin`, and `empty`; in `drive` the sessions `first`, with a camera and odometry,
    /// and `second`, which comes back to places of the first; a trained model beside the shipped one.
    pub(crate) async fn start() -> Self {
        let server = Server::start().await;
        let client = server.client().await;
        let model = super::import_model(&client).await;
        let settings = v1::MapSettings {
            keep: v1::map_settings::Keep::Images.into(),
            true_positive_rate: Some(0.4),
            false_positive_rate: Some(0.01),
            closure_threshold: Some(super::BY_WORDS_THRESHOLD),
            ..v1::MapSettings::default()
        };
        let request = super::map_request("drive", &model.name);
        client.create_map(v1::CreateMapRequest { settings: Some(settings), ..request }).await.unwrap();
        client.create_map(super::map_request("empty", &model.name)).await.unwrap();

        let options = SessionOptions { camera: Some(camera()), ..session_options("drive", "first") };
        let first = client.open_session(options).await.unwrap();
        let outcomes = stream_frames(first, (1..=15).map(driven)).await;
        assert!(outcomes.iter().all(|outcome| matches!(outcome, FrameOutcome::Answer(_))), "{outcomes:?}");
        let again = first_return();
        answers(&client, "drive", "second", (again..again + 10).map(frame)).await;
        let matches = client.loop_closures("drive").await.unwrap();
        let last = matches.last().and_then(|closure| closure.frame.clone()).expect("no loop was closed");
        // Two sessions were opened.
        let events = 2 + client.map("drive", v1::MapView::Basic).await.unwrap().frames;
        let closed = (format!("{}/frames/{}", last.session, last.sequence), events);
        let job = trained(&client).await;
        let twin = server.directory().join("twin.waypost-map");
        let mut file = tokio::fs::File::create(&twin).await.unwrap();
        client.export_map("drive", &mut file).await.unwrap();
        let imported = client.import_map("twin", tokio::fs::File::open(&twin).await.unwrap()).await.unwrap();
        super::followed(&client, &imported).await;
        let merges = [proposed(&client, "twin").await, proposed(&client, "empty").await];
        Self { server, job, merges, words_hash: model.words_hash, closed }
    }
}

/// The number of a merge of a map into `drive`, once it was looked for.
async fn proposed(client: &Client, map: &str) -> String {
    let request = v1::MergeMapsRequest {
        sources: vec![format!("maps/{map}")],
        target: "maps/drive".to_owned(),
        ..v1::MergeMapsRequest::default()
    };
    let merge = client.merge_maps(request).await.unwrap();
    let job = client.job(&merge.job).await.unwrap();
    super::followed(client, &job).await;
    merge.name.strip_prefix("merges/").unwrap().to_owned()
}

/// Robots `robot`, which is to go to place 1, and `scout`, which stands; in the map `drive`.
pub(crate) async fn led(client: &Client) -> [Navigation; 2] {
    let goal = v1::Goal { target: Some(v1::goal::Target::PlaceNumber(1)) };
    let open = async |name: &str, goal| {
        let options = NavigationOptions::new("drive", camera());
        let options = NavigationOptions { navigation_id: name.to_owned(), goal, ..options };
        client.navigate(options).await.unwrap()
    };
    let robot = open("robot", Some(goal)).await;
    let mut guidance = robot.guidance();
    let odometry = v1::Odometry { pose: Some(pose(1.0)), covariance: Vec::new() };
    robot.report(Reading { stamp_ns: 1, odometry, reflex: false });
    guidance.changed().await.unwrap();
    [robot, open("scout", None).await]
}

fn camera() -> v1::Camera {
    v1::Camera {
        model: Some(v1::camera::Model::Pinhole(v1::Pinhole {
            fx_px: 500.0,
            fy_px: 501.5,
            cx_px: 320.0,
            cy_px: 240.25,
            distortion: vec![0.1, -0.01, 0.0, 0.001],
        })),
        image_width_px: Some(640),
        image_height_px: Some(360),
        base_to_camera: Some(pose(0.2)),
    }
}

fn pose(x: f64) -> v1::Pose {
    v1::Pose {
        position_m: Some(v1::Vector3 { x, y: -0.5, z: 0.125 }),
        orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 }),
    }
}

/// A frame with odometry; every second one knows how sure it is of it.
fn driven(sequence: u64) -> FrameInput {
    let mut covariance = vec![0.0; if sequence.is_multiple_of(2) { 36 } else { 0 }];
    for (index, value) in covariance.iter_mut().enumerate() {
        *value = if index % 7 == 0 { 0.01 * (index + 1) as f64 } else { 0.001 };
    }
    let odometry = v1::Odometry { pose: Some(pose(0.5 * sequence as f64)), covariance };
    FrameInput { odometry: Some(odometry), ..frame(sequence) }
}

/// The number of a small training, once it has ended.
async fn trained(client: &Client) -> String {
    let settings = v1::TrainModelSettings {
        display_name: "small".to_owned(),
        extractor: Some("orb features=100 width=320".to_owned()),
        words: 20,
        seed: 7,
        image_count: Some(8),
    };
    let shown = stream::iter(images().iter().take(8).cloned().map(Ok));
    let job = in_time(client.train_model(settings, shown)).await.unwrap();
    let mut steps = client.watch_job(&job.name).await.unwrap();
    let mut last = job;
    while let Some(step) = in_time(steps.next()).await.unwrap() {
        last = step;
    }
    assert_eq!(last.state(), v1::job::State::Succeeded, "{last:?}");
    last.name.strip_prefix("jobs/").unwrap().to_owned()
}
