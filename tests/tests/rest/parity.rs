// long: one comparison for each thing that can be read.
//! REST and gRPC give the same answer to the same question, field by field. What gRPC answers is turned into
//! JSON here by the contract's own descriptors, and not by anything that the server uses.

use std::sync::LazyLock;

use prost::Message;
use prost_reflect::{DescriptorPool, DynamicMessage, FieldDescriptor, Kind, ReflectMessage};
use reqwest::StatusCode;
use serde_json::{Map, Value, json};
use tonic::transport::Channel;
use tonic::{Code, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::appearance_service_client::AppearanceServiceClient;
use waypost_proto::v1::cluster_service_client::ClusterServiceClient;
use waypost_proto::v1::correction_service_client::CorrectionServiceClient;
use waypost_proto::v1::event_service_client::EventServiceClient;
use waypost_proto::v1::job_service_client::JobServiceClient;
use waypost_proto::v1::label_service_client::LabelServiceClient;
use waypost_proto::v1::map_service_client::MapServiceClient;
use waypost_proto::v1::merge_service_client::MergeServiceClient;
use waypost_proto::v1::model_service_client::ModelServiceClient;
use waypost_proto::v1::navigation_service_client::NavigationServiceClient;
use waypost_proto::v1::query_request::Content;
use waypost_proto::v1::recognition_service_client::RecognitionServiceClient;
use waypost_proto::v1::session_service_client::SessionServiceClient;
use waypost_proto::v1::token_service_client::TokenServiceClient;

use crate::harness::{
    Answer, RawStream, Server, Surveyed, channel, found, frame, get, http, images, import_model, led, open,
    taught_hall, wire,
};

static CONTRACT: LazyLock<DescriptorPool> =
    LazyLock::new(|| DescriptorPool::decode(waypost_proto::FILE_DESCRIPTOR_SET).unwrap());

/// A message as REST has it.
fn json_of(name: &str, message: &impl Message) -> Value {
    let descriptor = CONTRACT.get_message_by_name(name).expect("a message of the contract");
    let dynamic = DynamicMessage::decode(descriptor, message.encode_to_vec().as_slice()).unwrap();
    // As it is once written and read: the reader may be a bit off in the last digit.
    serde_json::from_str(&object(&dynamic).to_string()).unwrap()
}

fn object(message: &DynamicMessage) -> Value {
    // Bytes are not shown; a status is its code's name and its message.
    let shown = |field: &FieldDescriptor| {
        field.kind() != Kind::Bytes && field.full_name() != "google.rpc.Status.details"
    };
    let mut object = Map::new();
    for field in message.descriptor().fields().filter(shown) {
        let none = field.supports_presence() && !message.has_field(&field);
        let value = if none { Value::Null } else { object_field(&field, &message.get_field(&field)) };
        object.insert(field.name().to_owned(), value);
    }
    if let ("google.rpc.Status", Some(code)) = (message.descriptor().full_name(), object.get_mut("code")) {
        let known = Code::from(code.as_i64().unwrap() as i32);
        *code = json!(snake(&format!("{known:?}")));
    }
    Value::Object(object)
}

fn object_field(field: &FieldDescriptor, value: &prost_reflect::Value) -> Value {
    use prost_reflect::Value as Proto;
    match value {
        Proto::Bool(value) => json!(value),
        Proto::I32(value) => json!(value),
        Proto::I64(value) => json!(value),
        Proto::U32(value) => json!(value),
        Proto::U64(value) => json!(value),
        Proto::F32(value) => json!(value),
        Proto::F64(value) => json!(value),
        Proto::String(value) => json!(value),
        Proto::EnumNumber(number) => enumeration(field, *number),
        Proto::Message(message) => object(message),
        Proto::List(values) => values.iter().map(|value| object_field(field, value)).collect(),
        Proto::Bytes(_) | Proto::Map(_) => panic!("{} has no form in JSON", field.full_name()),
    }
}

/// `REASON_LOOP_CLOSURE` of the enum `Reason` is `loop_closure`; unspecified is nothing.
fn enumeration(field: &FieldDescriptor, number: i32) -> Value {
    let Kind::Enum(descriptor) = field.kind() else { panic!("{} is no enum", field.full_name()) };
    let value = descriptor.get_value(number).expect("a value of the contract");
    let prefix = format!("{}_", snake(descriptor.name()));
    let name = value.name().to_lowercase();
    let short = name.strip_prefix(&prefix).expect("values have their enum's name in front");
    if short == "unspecified" { Value::Null } else { json!(short) }
}

/// `NewPlace` as `new_place`.
fn snake(camel: &str) -> String {
    let mut snake = String::new();
    for (index, letter) in camel.chars().enumerate() {
        if letter.is_uppercase() && index > 0 {
            snake.push('_');
        }
        snake.extend(letter.to_lowercase());
    }
    snake
}

/// A server, asked in two ways.
struct Both {
    server: Server,
    maps: MapServiceClient<Channel>,
    corrections: CorrectionServiceClient<Channel>,
    sessions: SessionServiceClient<Channel>,
    models: ModelServiceClient<Channel>,
    navigations: NavigationServiceClient<Channel>,
    merges: MergeServiceClient<Channel>,
    appearance: AppearanceServiceClient<Channel>,
    labels: LabelServiceClient<Channel>,
    recognition: RecognitionServiceClient<Channel>,
    jobs: JobServiceClient<Channel>,
}

impl Both {
    async fn of(server: Server) -> Self {
        let channel = channel(&server.endpoint()).await;
        Self {
            server,
            maps: MapServiceClient::new(channel.clone()),
            corrections: CorrectionServiceClient::new(channel.clone()),
            sessions: SessionServiceClient::new(channel.clone()),
            models: ModelServiceClient::new(channel.clone()),
            navigations: NavigationServiceClient::new(channel.clone()),
            merges: MergeServiceClient::new(channel.clone()),
            appearance: AppearanceServiceClient::new(channel.clone()),
            labels: LabelServiceClient::new(channel.clone()),
            recognition: RecognitionServiceClient::new(channel.clone()),
            jobs: JobServiceClient::new(channel),
        }
    }

    /// Whether the answer at a path is what gRPC said, be it an error; gives what it was.
    async fn agree<M: Message>(
        &self,
        path: &str,
        message: &str,
        over_grpc: Result<Response<M>, Status>,
    ) -> Value {
        same(path, &get(&self.server, path).await, message, over_grpc)
    }

    /// Whether all pages agree, of any size; gives all entries. A token that the one gave is taken by the other.
    async fn lists_agree<M: Message>(
        &self,
        path: &str,
        (message, items): (&str, &str),
        call: impl AsyncFn(u32, String) -> Result<Response<M>, Status>,
    ) -> Vec<Value> {
        let mut whole = None;
        for size in [0, 1000, 1, 4] {
            let (mut entries, mut token) = (Vec::new(), String::new());
            loop {
                let asked = format!("{path}?page_size={size}&page_token={token}");
                let page = self.agree(&asked, message, call(size, token).await).await;
                entries.extend(page[items].as_array().unwrap().iter().cloned());
                token = page["next_page_token"].as_str().unwrap().to_owned();
                if token.is_empty() {
                    break;
                }
                assert_eq!(page[items].as_array().unwrap().len(), size as usize, "{asked} is not full");
            }
            assert_eq!(whole.get_or_insert_with(|| entries.clone()), &entries, "{path} in pages of {size}");
        }
        whole.unwrap()
    }
}

#[track_caller]
fn same<M: Message>(
    path: &str,
    answer: &Answer,
    message: &str,
    over_grpc: Result<Response<M>, Status>,
) -> Value {
    let told = answer.json();
    match over_grpc {
        Ok(response) => {
            assert_eq!(answer.status, StatusCode::OK, "{path}: {told}");
            assert_eq!(told, json_of(message, response.get_ref()), "{path}");
        }
        Err(status) => {
            assert!(!answer.status.is_success(), "{path}: {status} over gRPC, but {told}");
            let code = snake(&format!("{:?}", status.code()));
            let (title, message) = (answer.status.canonical_reason(), status.message());
            let problem = json!({ "type": "about:blank", "title": title, "status": answer.status.as_u16(),
                "detail": message, "error": { "code": code, "message": message } });
            assert_eq!(told, problem, "{path}");
        }
    }
    told
}

#[tokio::test(flavor = "multi_thread")]
async fn maps_and_places_are_the_same() {
    let both = Both::of(Surveyed::start().await.server).await;
    let listed = both
        .lists_agree("/v1/maps", ("waypost.v1.ListMapsResponse", "maps"), async |page_size, page_token| {
            both.maps.clone().list_maps(v1::ListMapsRequest { page_size, page_token }).await
        })
        .await;
    assert_eq!(listed.len(), 3);
    for map in ["drive", "empty", "nowhere", "No"] {
        let name = format!("maps/{map}");
        for (view, query) in [(v1::MapView::Unspecified, ""), (v1::MapView::Full, "?view=full")] {
            let request = v1::GetMapRequest { name: name.clone(), view: view.into() };
            let over_grpc = both.maps.clone().get_map(request).await;
            both.agree(&format!("/v1/{name}{query}"), "waypost.v1.Map", over_grpc).await;
        }
    }
    let message = ("waypost.v1.ListLoopClosuresResponse", "loop_closures");
    let matches = both
        .lists_agree("/v1/maps/drive/loop-closures", message, async |page_size, page_token| {
            let map = "maps/drive".to_owned();
            both.maps
                .clone()
                .list_loop_closures(v1::ListLoopClosuresRequest { map, page_size, page_token })
                .await
        })
        .await;
    assert!(matches.len() > 1, "{matches:?}");
    places_agree(&both).await;
    matrices_agree(&both).await;
    both.server.stop().await;
}

async fn matrices_agree(both: &Both) {
    let mut matrices = 0;
    for (map, against) in [
        ("drive", ""),
        ("drive", "drive"),
        ("drive", "empty"),
        ("empty", ""),
        ("nowhere", ""),
        ("drive", "No"),
    ] {
        let map = format!("maps/{map}");
        let (other, query) = match against {
            "" => (String::new(), String::new()),
            other => (format!("maps/{other}"), format!("?against={other}")),
        };
        let request = v1::GetMatchMatrixRequest { map: map.clone(), against: other.clone() };
        let over_grpc = both.maps.clone().get_match_matrix(request).await;
        let told = both.agree(&format!("/v1/{map}/matrix{query}"), "waypost.v1.MatchMatrix", over_grpc).await;
        matrices += usize::from(told["levels"] == 1);
        for (level, row, column) in [(0, 0, 0), (0, 0, 1), (7, 0, 0)] {
            let (map, against) = (map.clone(), other.clone());
            let path = format!("/v1/{map}/matrix/tiles/{level}/{row}/{column}{query}");
            let request = v1::GetMatchMatrixTileRequest { map, against, level, row, column };
            let answer = get(&both.server, &path).await;
            match both.maps.clone().get_match_matrix_tile(request).await.map(Response::into_inner) {
                Ok(v1::GetMatchMatrixTileResponse { content_type, picture }) => {
                    assert_eq!(answer.header("content-type"), content_type, "{path}");
                    assert!(!picture.is_empty() && answer.body == picture, "{path}: the pictures differ");
                }
                Err(status) => {
                    same::<v1::GetMatchMatrixTileResponse>(&path, &answer, "", Err(status));
                }
            }
        }
    }
    assert_eq!(matrices, 4);
}

/// The lists that a correction shows in are compared once there is one.
#[tokio::test(flavor = "multi_thread")]
async fn corrections_are_the_same() {
    let Surveyed { server, closed: (frame, correction), .. } = Surveyed::start().await;
    let both = Both::of(server).await;
    let request = v1::WithdrawLoopClosureRequest { frame: frame.clone() };
    let withdrawn = both.corrections.clone().withdraw_loop_closure(request).await.unwrap().into_inner();
    assert_eq!(withdrawn.name, format!("maps/drive/corrections/{correction}"));
    let message = ("waypost.v1.ListCorrectionsResponse", "corrections");
    let listed = async || {
        both.lists_agree("/v1/maps/drive/corrections", message, async |page_size, page_token| {
            let map = "maps/drive".to_owned();
            both.corrections
                .clone()
                .list_corrections(v1::ListCorrectionsRequest { map, page_size, page_token })
                .await
        })
        .await
    };
    assert_eq!(listed().await.len(), 1);
    let request = v1::GetFrameRequest { name: frame.clone() };
    let over_grpc = both.sessions.clone().get_frame(request).await;
    both.agree(&format!("/v1/{frame}"), "waypost.v1.FrameRecord", over_grpc).await;
    let request = v1::ExplainFrameRequest { name: frame.clone(), ..v1::ExplainFrameRequest::default() };
    let over_grpc = both.sessions.clone().explain_frame(request).await;
    both.agree(&format!("/v1/{frame}/explanation"), "waypost.v1.FrameExplanation", over_grpc).await;
    let request = v1::GetMapRequest { name: "maps/drive".to_owned(), view: v1::MapView::Full.into() };
    let over_grpc = both.maps.clone().get_map(request).await;
    both.agree("/v1/maps/drive?view=full", "waypost.v1.Map", over_grpc).await;
    let message = ("waypost.v1.ListLoopClosuresResponse", "loop_closures");
    let closures = both
        .lists_agree("/v1/maps/drive/loop-closures", message, async |page_size, page_token| {
            let map = "maps/drive".to_owned();
            let request = v1::ListLoopClosuresRequest { map, page_size, page_token };
            both.maps.clone().list_loop_closures(request).await
        })
        .await;
    assert_eq!(closures.iter().filter(|closure| !closure["correction"].is_null()).count(), 1);

    // Undone over HTTP, by the path that it has there.
    let url = both.server.url(&format!("/v1/{}/undo", withdrawn.name));
    let undone = Answer::to(http().post(url)).await.json();
    assert_eq!(undone["name"], withdrawn.name.as_str());
    assert!(undone["undone"]["create_time_ns"].as_i64() > Some(withdrawn.create_time_ns), "{undone}");
    assert_eq!(listed().await, [undone]);
    both.server.stop().await;
}

async fn places_agree(both: &Both) {
    let message = ("waypost.v1.ListPlacesResponse", "places");
    let places = both
        .lists_agree("/v1/maps/drive/places", message, async |page_size, page_token| {
            let map = "maps/drive".to_owned();
            both.maps
                .clone()
                .list_places(v1::ListPlacesRequest { map, page_size, page_token, ..Default::default() })
                .await
        })
        .await;
    assert!(places.len() > 4, "{places:?}");
    let mut words = Vec::new();
    for number in 0..=places.len() {
        let name = format!("maps/drive/places/{number}");
        let over_grpc = both.maps.clone().get_place(v1::GetPlaceRequest { name: name.clone() }).await;
        let place = both.agree(&format!("/v1/{name}"), "waypost.v1.Place", over_grpc).await;
        words.extend(place["word_hits"][0]["word"].as_u64());
    }
    assert_eq!(words.len(), places.len(), "each place has words, and one place more is none");
    let message = ("waypost.v1.ListWordPlacesResponse", "places");
    let mut most = 0;
    for word in words {
        let word = u32::try_from(word).unwrap();
        let path = format!("/v1/maps/drive/words/{word}/places");
        let found = both
            .lists_agree(&path, message, async |page_size, page_token| {
                let map = "maps/drive".to_owned();
                let request = v1::ListWordPlacesRequest { map, word, page_size, page_token };
                both.maps.clone().list_word_places(request).await
            })
            .await;
        most = most.max(found.len());
    }
    assert!(most > 1, "no word is shown by more than one place");
    let request =
        v1::ListWordPlacesRequest { map: "maps/drive".to_owned(), word: 3000, ..Default::default() };
    let over_grpc = both.maps.clone().list_word_places(request).await;
    both.agree("/v1/maps/drive/words/3000/places", "waypost.v1.ListWordPlacesResponse", over_grpc).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_and_frames_are_the_same() {
    let both = Both::of(Surveyed::start().await.server).await;
    let message = ("waypost.v1.ListSessionsResponse", "sessions");
    let sessions = both
        .lists_agree("/v1/maps/drive/sessions", message, async |page_size, page_token| {
            let map = "maps/drive".to_owned();
            both.sessions.clone().list_sessions(v1::ListSessionsRequest { map, page_size, page_token }).await
        })
        .await;
    assert!(!sessions[0]["camera"]["pinhole"].is_null() && sessions[1]["camera"].is_null(), "{sessions:?}");
    for name in ["maps/drive/sessions/first", "maps/drive/sessions/second", "maps/drive/sessions/third"] {
        let request = v1::GetSessionRequest { name: name.to_owned() };
        let over_grpc = both.sessions.clone().get_session(request).await;
        both.agree(&format!("/v1/{name}"), "waypost.v1.Session", over_grpc).await;
    }
    let mut reasons = Vec::new();
    for session in ["maps/drive/sessions/first", "maps/drive/sessions/second"] {
        let message = ("waypost.v1.ListFramesResponse", "frames");
        let frames = both
            .lists_agree(&format!("/v1/{session}/frames"), message, async |page_size, page_token| {
                let session = session.to_owned();
                both.sessions
                    .clone()
                    .list_frames(v1::ListFramesRequest {
                        session,
                        page_size,
                        page_token,
                        ..Default::default()
                    })
                    .await
            })
            .await;
        for frame in frames {
            reasons.push(frame["answer"]["reason"].as_str().unwrap().to_owned());
            frame_agrees(&both, frame["name"].as_str().unwrap()).await;
        }
    }
    for reason in ["new_place", "loop_closure"] {
        assert!(reasons.iter().any(|found| found == reason), "no frame is {reason}: {reasons:?}");
    }
    frame_agrees(&both, "maps/drive/sessions/first/frames/999").await;
    frame_agrees(&both, "maps/drive/sessions/first/frames/x").await;
    both.server.stop().await;
}

async fn frame_agrees(both: &Both, name: &str) {
    let over_grpc = both.sessions.clone().get_frame(v1::GetFrameRequest { name: name.to_owned() }).await;
    both.agree(&format!("/v1/{name}"), "waypost.v1.FrameRecord", over_grpc).await;
    for (place, words, query) in
        [(None, None, ""), (None, Some(2), "?max_words=2"), (Some(0), Some(1), "?place_number=0&max_words=1")]
    {
        let request =
            v1::ExplainFrameRequest { name: name.to_owned(), place_number: place, max_words: words };
        let over_grpc = both.sessions.clone().explain_frame(request).await;
        let path = format!("/v1/{name}/explanation{query}");
        both.agree(&path, "waypost.v1.FrameExplanation", over_grpc).await;
    }
    let beside = |frame: &str, expected_words: &[u32]| v1::GetFramePictureRequest {
        beside_frame: frame.to_owned(),
        expected_words: expected_words.to_vec(),
        ..Default::default()
    };
    let of_place = |place| v1::GetFramePictureRequest { place_number: Some(place), ..Default::default() };
    let first = "maps/drive/sessions/first/frames/1";
    for (asked, query) in [
        (v1::GetFramePictureRequest::default(), String::new()),
        (of_place(0), "?place_number=0".to_owned()),
        (of_place(999), "?place_number=999".to_owned()),
        (beside(first, &[3, 1]), format!("?beside_frame={first}&expected_words=3,1")),
        (beside("maps/nowhere/places/3", &[]), "?beside_frame=maps/nowhere/places/3".to_owned()),
        (beside("", &[u32::MAX]), format!("?expected_words={}", u32::MAX)),
        (beside("", &[7; 101]), format!("?expected_words={}", ["7"; 101].join(","))),
        (
            v1::GetFramePictureRequest { place_number: Some(0), ..beside(first, &[]) },
            format!("?place_number=0&beside_frame={first}"),
        ),
    ] {
        let request = v1::GetFramePictureRequest { name: name.to_owned(), ..asked };
        let path = format!("/v1/{name}/picture{query}");
        let answer = get(&both.server, &path).await;
        match both.sessions.clone().get_frame_picture(request).await.map(Response::into_inner) {
            Ok(v1::GetFramePictureResponse { content_type, picture }) => {
                assert_eq!(answer.header("content-type"), content_type, "{path}");
                assert!(!picture.is_empty() && answer.body == picture, "{path}: the pictures differ");
            }
            Err(status) => {
                same::<v1::GetFramePictureResponse>(&path, &answer, "", Err(status));
            }
        }
    }
    use v1::get_frame_image_request::Size;
    let sizes =
        [(Size::Unspecified, ""), (Size::Original, "?size=original"), (Size::Thumbnail, "?size=thumbnail")];
    for (size, query) in sizes {
        let request = v1::GetFrameImageRequest { name: name.to_owned(), size: size.into() };
        let path = format!("/v1/{name}/image{query}");
        let answer = get(&both.server, &path).await;
        match both.sessions.clone().get_frame_image(request).await.map(Response::into_inner) {
            Ok(v1::GetFrameImageResponse { content_type, image }) => {
                assert_eq!(answer.header("content-type"), content_type, "{path}");
                assert!(!image.is_empty() && answer.body == image, "{path}: the images differ");
            }
            Err(status) => {
                same::<v1::GetFrameImageResponse>(&path, &answer, "", Err(status));
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn queries_are_answered_the_same() {
    let Surveyed { server, words_hash, .. } = Surveyed::start().await;
    let both = Both::of(server).await;
    let seen = found(&both.server, "/v1/maps/drive/sessions/first/frames/9").await;
    let numbers = |list: &Value| -> Vec<u32> { serde_json::from_value(list.clone()).unwrap() };
    let (words, counts) = (numbers(&seen["histogram"]["words"]), numbers(&seen["histogram"]["counts"]));
    let points: Vec<f32> = (0..words.len()).map(|index| index as f32 * 0.5).collect();
    let histogram = v1::WordHistogram { words: words.clone(), counts: counts.clone() };
    let list = v1::WordList {
        words: words.clone(),
        x_px: points.clone(),
        y_px: points.clone(),
        image_width_px: 640,
        image_height_px: 480,
        ..v1::WordList::default()
    };
    let json_histogram =
        json!({ "words_hash": words_hash, "histogram": { "words": words, "counts": counts } });
    let json_list = json!({ "words_hash": words_hash, "words": { "words": words, "x_px": points, "y_px": points,
        "image_width_px": 640, "image_height_px": 480 } });
    let unknown = v1::WordHistogram { words: vec![3000], counts: Vec::new() };
    let json_unknown = json!({ "words_hash": words_hash, "histogram": { "words": [3000] } });
    let image = images()[8].clone();
    let cases = [
        ("image/jpeg", image.clone(), Content::Image(image)),
        ("image/png", b"none".to_vec(), Content::Image(b"none".to_vec())),
        ("application/json", json_histogram.to_string().into_bytes(), Content::Histogram(histogram)),
        ("application/json", json_list.to_string().into_bytes(), Content::Words(list)),
        ("application/json", json_unknown.to_string().into_bytes(), Content::Histogram(unknown)),
    ];
    let mut matched = 0;
    for (kind, body, content) in &cases {
        for (map, explained_words) in
            [("drive", 0), ("drive", 3), ("empty", 3), ("nowhere", 0), ("drive", 101)]
        {
            let words_hash = if *kind == "application/json" { words_hash.clone() } else { String::new() };
            let (map_name, content) = (format!("maps/{map}"), Some(content.clone()));
            let request = v1::QueryRequest {
                map: map_name,
                content,
                words_hash,
                explained_words: Some(explained_words),
            };
            let over_grpc = both.recognition.clone().query(request).await;
            let path = format!("/v1/maps/{map}/query?explained_words={explained_words}");
            let request = http().post(both.server.url(&path)).header("content-type", *kind);
            let answer = Answer::to(request.body(body.clone())).await;
            let told = same(&path, &answer, "waypost.v1.QueryResponse", over_grpc);
            matched += usize::from(told["match"].is_object());
        }
    }
    assert_eq!(matched, 6, "an image, a histogram and a list, each with and without an explanation");
    both.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn models_jobs_and_what_the_server_says_of_itself_are_the_same() {
    let Surveyed { server, job, .. } = Surveyed::start().await;
    let events = EventServiceClient::new(channel(&server.endpoint()).await);
    let both = Both::of(server).await;
    let message = ("waypost.v1.ListModelsResponse", "models");
    let models = both
        .lists_agree("/v1/models", message, async |page_size, page_token| {
            both.models.clone().list_models(v1::ListModelsRequest { page_size, page_token }).await
        })
        .await;
    assert_eq!(models.len(), 2);
    let hash = models[0]["name"].as_str().unwrap().strip_prefix("models/").unwrap();
    for model in [hash, &hash[..8], "shipped", "nothing", &"f".repeat(64)] {
        let over_grpc = both.models.clone().get_model(v1::GetModelRequest { name: model.to_owned() }).await;
        both.agree(&format!("/v1/models/{model}"), "waypost.v1.Model", over_grpc).await;
    }
    let streams = async |map: &str| {
        let request = v1::ListOpenStreamsRequest { map: map.to_owned() };
        both.sessions.clone().list_open_streams(request).await
    };
    let (mut robot, _) = RawStream::open(&both.server.endpoint(), open("drive", "third")).await.unwrap();
    robot.answered(wire(frame(1))).await;
    for (path, map) in [
        ("/v1/streams", ""),
        ("/v1/streams?map=drive", "maps/drive"),
        ("/v1/streams?map=empty", "maps/empty"),
        ("/v1/streams?map=nowhere", "maps/nowhere"),
    ] {
        let told = both.agree(path, "waypost.v1.ListOpenStreamsResponse", streams(map).await).await;
        let listed = told["streams"].as_array().map_or(0, Vec::len);
        assert_eq!(listed, usize::from(["", "maps/drive"].contains(&map)), "{told}");
    }
    let clusters = ClusterServiceClient::new(channel(&both.server.endpoint()).await);
    let over_grpc = clusters.clone().get_cluster(v1::GetClusterRequest {}).await.unwrap().into_inner();
    let mut told = [json_of("waypost.v1.Cluster", &over_grpc), get(&both.server, "/v1/cluster").await.json()];
    for cluster in &mut told {
        for server in cluster["servers"].as_array_mut().unwrap() {
            // Time goes on between the two.
            assert!(server["silent_s"].as_f64().unwrap() < 10.0, "{server}");
            server["silent_s"] = json!(0.0);
        }
    }
    assert_eq!(told[0], told[1]);
    assert_eq!(told[0]["servers"][0]["role"], "owner");
    assert_eq!(told[0]["load"]["open_streams"], 1, "{}", told[0]);
    let path = "/v1/metrics-history";
    let history = async || events.clone().get_metrics_history(v1::GetMetricsHistoryRequest {}).await;
    let (before, answer, after) = (history().await, get(&both.server, path).await, history().await);
    // It may be looked at just now.
    let is_before = json!(before.as_ref().unwrap().get_ref().times_ns) == answer.json()["times_ns"];
    let told = same(path, &answer, "waypost.v1.MetricsHistory", if is_before { before } else { after });
    let series = told["series"].as_array().unwrap();
    let maps = series.iter().find(|series| series["metric"] == "waypost_maps").unwrap();
    assert_eq!(maps["values"].as_array().unwrap().len(), told["times_ns"].as_array().unwrap().len());
    let message = ("waypost.v1.ListRefusalsResponse", "refusals");
    let refusals = both
        .lists_agree("/v1/refusals", message, async |page_size, page_token| {
            events.clone().list_refusals(v1::ListRefusalsRequest { page_size, page_token }).await
        })
        .await;
    // The models that there are not, and the map.
    assert!(refusals.len() >= 4, "{refusals:?}");
    let message = ("waypost.v1.ListJobsResponse", "jobs");
    let jobs = both
        .lists_agree("/v1/jobs", message, async |page_size, page_token| {
            both.jobs.clone().list_jobs(v1::ListJobsRequest { page_size, page_token }).await
        })
        .await;
    assert!(!jobs.is_empty());
    for job in [job.as_str(), "999999", "first"] {
        let over_grpc = both.jobs.clone().get_job(v1::GetJobRequest { name: format!("jobs/{job}") }).await;
        both.agree(&format!("/v1/jobs/{job}"), "waypost.v1.Job", over_grpc).await;
    }
    both.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn tokens_are_the_same() {
    let both = Both::of(Server::start().await).await;
    let tokens = TokenServiceClient::new(channel(&both.server.endpoint()).await);
    let nobody = tokens.clone().get_caller(v1::GetCallerRequest {}).await;
    let told = both.agree("/v1/whoami", "waypost.v1.Caller", nobody).await;
    let everything = json!(["read", "localize", "stream", "navigate", "admin"]);
    let unlimited = |token: &str, asks: bool| {
        json!({
            "token": token,
            "role": "admin",
            "asks_for_token": asks,
            "abilities": everything,
            "maps": [],
            "expire_time_ns": null,
            "quotas": {
                "max_maps": null, "max_sessions": null, "max_frames_per_second": null, "max_kept_mib": null
            }
        })
    };
    assert_eq!(told, unlimited("", false));
    let client = both.server.client().await;
    let (_, admin) = client.create_token("operator", v1::token::Role::Admin).await.unwrap();
    let bearer = format!("Bearer {admin}");
    fn shown<T>(bearer: &str, message: T) -> tonic::Request<T> {
        let mut request = tonic::Request::new(message);
        request.metadata_mut().insert("authorization", bearer.parse().unwrap());
        request
    }
    let robot = shown(
        &bearer,
        v1::CreateTokenRequest {
            token_id: "robot".to_owned(),
            role: v1::token::Role::Robot.into(),
            maps: vec!["floor2-*".to_owned()],
            lifetime_s: Some(3600),
            quotas: Some(v1::Quotas {
                max_sessions: Some(3),
                max_frames_per_second: Some(0.5),
                ..v1::Quotas::default()
            }),
            ..v1::CreateTokenRequest::default()
        },
    );
    tokens.clone().create_token(robot).await.unwrap();
    let ask = async |path: &str| Answer::to(http().get(both.server.url(path)).bearer_auth(&admin)).await;
    let caller = tokens.clone().get_caller(shown(&bearer, v1::GetCallerRequest {})).await;
    let told = same("/v1/whoami", &ask("/v1/whoami").await, "waypost.v1.Caller", caller);
    assert_eq!(told, unlimited("tokens/operator", true));
    for (size, token) in [(0, ""), (1, ""), (1, "x"), (1001, "")] {
        let request = v1::ListTokensRequest { page_size: size, page_token: token.to_owned() };
        let listed = tokens.clone().list_tokens(shown(&bearer, request)).await;
        let path = format!("/v1/tokens?page_size={size}&page_token={token}");
        same(&path, &ask(&path).await, "waypost.v1.ListTokensResponse", listed);
    }
    both.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn merges_are_the_same() {
    let Surveyed { server, merges, .. } = Surveyed::start().await;
    let both = Both::of(server).await;
    let message = ("waypost.v1.ListMergesResponse", "merges");
    let listed = both
        .lists_agree("/v1/merges", message, async |page_size, page_token| {
            both.merges.clone().list_merges(v1::ListMergesRequest { page_size, page_token }).await
        })
        .await;
    assert_eq!((&listed[0]["state"], &listed[1]["state"]), (&json!("no_overlap"), &json!("proposed")));
    assert!(listed[1]["sources"][0]["overlap"]["fused_places"].as_u64().unwrap() >= 5, "{}", listed[1]);
    for merge in [merges[0].as_str(), merges[1].as_str(), "999999", "first"] {
        let request = v1::GetMergeRequest { name: format!("merges/{merge}") };
        let over_grpc = both.merges.clone().get_merge(request).await;
        both.agree(&format!("/v1/merges/{merge}"), "waypost.v1.Merge", over_grpc).await;
    }
    let request = v1::GetMergePictureRequest { name: format!("merges/{}", merges[0]) };
    let picture = both.merges.clone().get_merge_picture(request).await.unwrap().into_inner().picture;
    let over_http = get(&both.server, &format!("/v1/merges/{}/picture", merges[0])).await;
    assert!(over_http.body == picture && !picture.is_empty());
    both.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn navigations_and_routes_are_the_same() {
    let Surveyed { server, .. } = Surveyed::start().await;
    let client = server.client().await;
    let both = Both::of(server).await;
    let _led = led(&client).await;
    let message = ("waypost.v1.ListNavigationsResponse", "navigations");
    let navigations = both
        .lists_agree("/v1/maps/drive/navigations", message, async |page_size, page_token| {
            let map = "maps/drive".to_owned();
            both.navigations
                .clone()
                .list_navigations(v1::ListNavigationsRequest { map, page_size, page_token })
                .await
        })
        .await;
    let names: Vec<&str> = navigations.iter().map(|led| led["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["maps/drive/navigations/robot", "maps/drive/navigations/scout"]);
    assert_eq!(
        (&navigations[0]["goal"]["place_number"], &navigations[0]["connected"]),
        (&json!(1), &json!(true))
    );
    assert_eq!(
        (&navigations[0]["guidance"]["status"], &navigations[1]["guidance"]),
        (&json!("lost"), &json!(null))
    );
    for (map, robot) in
        [("drive", "robot"), ("drive", "scout"), ("drive", "nobody"), ("no", "robot"), ("drive", "No")]
    {
        let name = format!("maps/{map}/navigations/{robot}");
        let over_grpc =
            both.navigations.clone().get_navigation(v1::GetNavigationRequest { name: name.clone() }).await;
        both.agree(&format!("/v1/{name}"), "waypost.v1.Navigation", over_grpc).await;
    }
    let mut planned = 0;
    for (map, from, to, against) in [
        ("drive", 0, 5, "forbidden"),
        ("drive", 5, 0, "forbidden"),
        ("drive", 5, 0, "costly"),
        ("drive", 0, 999, "forbidden"),
        ("drive", 999, 0, "costly"),
        ("empty", 0, 0, "costly"),
        ("no", 0, 1, "costly"),
    ] {
        let way = if against == "costly" { v1::ReverseTravel::Costly } else { v1::ReverseTravel::Forbidden };
        let request = v1::PlanRouteRequest {
            map: format!("maps/{map}"),
            from_place_number: from,
            goal: Some(v1::Goal { target: Some(v1::goal::Target::PlaceNumber(to)) }),
            reverse_travel: way.into(),
        };
        let over_grpc = both.navigations.clone().plan_route(request).await;
        let route = over_grpc.map(|response| response.map(|response| response.route.unwrap()));
        planned += usize::from(route.is_ok());
        let path = format!(
            "/v1/maps/{map}/route?from_place_number={from}&to_place_number={to}&reverse_travel={against}"
        );
        both.agree(&path, "waypost.v1.Route", route).await;
    }
    assert!((2..5).contains(&planned), "{planned} ways");
    both.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn labels_and_appearance_graphs_are_the_same() {
    let (server, client) = Server::with_map().await;
    let model = import_model(&client).await;
    taught_hall(&client, &model.name).await;
    let both = Both::of(server).await;
    for (place, label) in [(0, "hall"), (2, "Küche"), (3, "hall")] {
        let path = format!("/v1/maps/looks/places/{place}/label");
        let request = http().put(both.server.url(&path)).json(&json!({ "label": label }));
        let named = v1::SetLabelRequest {
            place: format!("maps/looks/places/{place}"),
            label: label.to_owned(),
            scope: v1::LabelScope::Place.into(),
        };
        let over_grpc = both.labels.clone().set_label(named).await;
        same(&path, &Answer::to(request).await, "waypost.v1.SetLabelResponse", over_grpc);
    }
    let message = ("waypost.v1.ListLabelsResponse", "labels");
    let labels = both
        .lists_agree("/v1/maps/looks/labels", message, async |page_size, page_token| {
            let map = "maps/looks".to_owned();
            both.labels.clone().list_labels(v1::ListLabelsRequest { map, page_size, page_token }).await
        })
        .await;
    assert_eq!(labels.len(), 3);
    for map in ["looks", "drive", "nowhere"] {
        let request = v1::GetAppearanceGraphRequest { map: format!("maps/{map}") };
        let over_grpc = both.appearance.clone().get_appearance_graph(request).await;
        let path = format!("/v1/maps/{map}/appearance-graph");
        let graph = both.agree(&path, "waypost.v1.AppearanceGraph", over_grpc).await;
        assert_eq!(
            graph["links"].as_array().is_some_and(|links| !links.is_empty()),
            map == "looks",
            "{graph}"
        );
    }
    for (place, told) in [(0, true), (0, false), (999, false)] {
        let path = format!("/v1/maps/looks/places/{place}/label");
        let over_rest = Answer::to(http().delete(both.server.url(&path))).await;
        assert_eq!(over_rest.status == StatusCode::OK, told, "{}", over_rest.text());
        let request = v1::DeleteLabelRequest { place: format!("maps/looks/places/{place}") };
        let over_grpc = both.labels.clone().delete_label(request).await;
        if !told {
            same(&path, &over_rest, "waypost.v1.DeleteLabelResponse", over_grpc);
        }
    }
    both.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_read_of_grpc_has_a_route() {
    let server = Server::start().await;
    let description = found(&server, "/v1/openapi.json").await;
    let paths = description["paths"].as_object().unwrap().values();
    let operations = paths.flat_map(|methods| methods.as_object().unwrap().values());
    let routes: Vec<&str> = operations.map(|operation| operation["operationId"].as_str().unwrap()).collect();
    let methods: Vec<String> = CONTRACT
        .services()
        .flat_map(|service| service.methods().map(|method| method.name().to_owned()).collect::<Vec<_>>())
        .filter(|method| ["List", "Get", "Explain", "Query"].iter().any(|read| method.starts_with(read)))
        .collect();
    assert!(methods.len() > 12, "{methods:?}");
    for method in &methods {
        assert!(routes.contains(&snake(method).as_str()), "REST has no {method}");
    }
    server.stop().await;
}
