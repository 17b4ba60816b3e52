//! Of calls: what each method and each route is asked for, about the map `drive`.

use fabmap::model::Model;
use prost::Message;
use waypost_proto::v1::{self, camera, frame, goal, navigate_request, query_request, stream_request};

use super::files::model_in;
use super::{Seed, fixture};

/// Method, and messages.
fn call(method: &str, messages: &[Vec<u8>]) -> Seed {
    let mut bytes = format!("{method}\n").into_bytes();
    for message in messages {
        bytes.extend((message.len() as u16).to_le_bytes());
        bytes.extend(message);
    }
    let name = method.replace('/', "-");
    Seed::new("grpc", name, bytes)
}

fn named(seed: Seed, name: &str) -> Seed {
    Seed { name: name.to_owned(), ..seed }
}

fn pose() -> v1::Pose {
    v1::Pose {
        position_m: Some(v1::Vector3 { x: 1.0, y: 0.5, z: 0.0 }),
        orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 }),
    }
}

fn odometry() -> v1::Odometry {
    let covariance = (0..36).map(|index| if index % 7 == 0 { 0.01 } else { 0.0 }).collect();
    v1::Odometry { pose: Some(pose()), covariance }
}

fn words() -> v1::WordList {
    v1::WordList {
        words: (0..30).collect(),
        x_px: (0..30).map(|index| index as f32 * 20.0).collect(),
        y_px: (0..30).map(|index| index as f32 * 15.0).collect(),
        size_px: vec![7.0; 30],
        angle_rad: vec![1.0; 30],
        image_width_px: 640,
        image_height_px: 480,
    }
}

fn histogram() -> v1::WordHistogram {
    v1::WordHistogram { words: (0..40).collect(), counts: vec![2; 40] }
}

fn cameras() -> Vec<(&'static str, camera::Model)> {
    let (fx_px, fy_px, cx_px, cy_px) = (500.0, 490.0, 320.0, 240.0);
    let distortion = vec![0.1, 0.01, 0.0, 0.0];
    let pinhole = v1::Pinhole { fx_px, fy_px, cx_px, cy_px, distortion: distortion.clone() };
    let fisheye = v1::Fisheye { fx_px, fy_px, cx_px, cy_px, distortion };
    let mirror = v1::HyperbolicMirror {
        center_x_px: 320.0,
        center_y_px: 240.0,
        inner_radius_px: 60.0,
        outer_radius_px: 220.0,
        eccentricity: 1.5,
        horizon_radius_px: Some(150.0),
        ahead_rad: -0.5,
    };
    vec![
        ("pinhole", camera::Model::Pinhole(pinhole)),
        ("view", camera::Model::FieldOfView(v1::FieldOfView { horizontal_rad: 1.2 })),
        ("fisheye", camera::Model::Fisheye(fisheye)),
        ("panorama", camera::Model::Panorama(v1::Panorama { projection: 1, vertical_rad: Some(1.5) })),
        ("mirror", camera::Model::HyperbolicMirror(mirror)),
    ]
}

fn camera(model: camera::Model) -> v1::Camera {
    v1::Camera {
        model: Some(model),
        image_width_px: Some(640),
        image_height_px: Some(480),
        base_to_camera: Some(pose()),
    }
}

/// Frames with these contents, one after the other.
fn frames(contents: Vec<frame::Content>) -> Vec<v1::Frame> {
    let frames = (1..).zip(contents).map(|(sequence, content)| v1::Frame {
        sequence,
        stamp_ns: sequence as i64 * 1_000_000_000,
        content: Some(content),
        odometry: Some(odometry()),
        note: "door".to_owned(),
    });
    frames.collect()
}

fn streams(words_hash: &str, images: &[Vec<u8>]) -> Vec<Seed> {
    let open = |mode: v1::SessionMode, camera: Option<v1::Camera>| v1::OpenSession {
        map: "maps/drive".to_owned(),
        session_id: format!("robot-{}", mode as i32),
        mode: mode.into(),
        camera,
        words_hash: words_hash.to_owned(),
        run_id: "run".to_owned(),
    };
    let stream = |open: v1::OpenSession, frames: Vec<v1::Frame>| {
        let request = |content| v1::StreamRequest { content: Some(content) }.encode_to_vec();
        let frames = frames.into_iter().map(|frame| request(stream_request::Content::Frame(frame)));
        let messages: Vec<_> =
            [request(stream_request::Content::Open(open))].into_iter().chain(frames).collect();
        call("SessionService/Stream", &messages)
    };
    let words = || vec![frame::Content::Words(words()); 3];
    let counts = || vec![frame::Content::Histogram(histogram()); 3];
    let pictures = images.iter().map(|image| frame::Content::Image(image.clone())).collect();
    let mut seeds = vec![
        named(stream(open(v1::SessionMode::Map, None), frames(words())), "stream-words"),
        named(stream(open(v1::SessionMode::Map, None), frames(counts())), "stream-histograms"),
        named(stream(open(v1::SessionMode::Localize, None), frames(counts())), "stream-localizing"),
        named(stream(open(v1::SessionMode::Map, None), frames(pictures)), "stream-images"),
    ];
    for (name, model) in cameras() {
        let opened = stream(open(v1::SessionMode::Map, Some(camera(model))), frames(words()));
        seeds.push(named(opened, &format!("stream-{name}")));
    }
    let turn = v1::Camera { model: Some(cameras().remove(3).1), ..v1::Camera::default() };
    let seen = frames(images.iter().map(|image| frame::Content::Image(image.clone())).collect());
    seeds.push(named(stream(open(v1::SessionMode::Map, Some(turn)), seen), "stream-panoramas"));
    seeds
}

fn navigations(words_hash: &str) -> Vec<Seed> {
    let goal = |target| v1::Goal { target: Some(target) };
    let open = v1::OpenNavigation {
        map: "maps/drive".to_owned(),
        navigation_id: "robot".to_owned(),
        run_id: "run".to_owned(),
        camera: Some(camera(cameras().remove(0).1)),
        words_hash: words_hash.to_owned(),
        goal: Some(goal(goal::Target::PlaceNumber(1))),
        driving: Some(v1::DrivingSettings {
            speed_m_s: Some(0.5),
            max_turn_rad_s: Some(1.0),
            reverse_travel: 1,
        }),
    };
    let wheels = v1::WheelReport {
        stamp_ns: 1_000_000_000,
        odometry: Some(odometry()),
        obeyed_number: Some(1),
        reflex: false,
    };
    let position = v1::PositionGoal { part: 0, x_m: Some(1.0), y_m: Some(2.0), heading_rad: Some(0.5) };
    let request = |content| v1::NavigateRequest { content: Some(content) }.encode_to_vec();
    let frame = frames(vec![frame::Content::Words(words())]).remove(0);
    let messages = [
        request(navigate_request::Content::Open(open)),
        request(navigate_request::Content::Wheels(wheels)),
        request(navigate_request::Content::Frame(frame)),
        request(navigate_request::Content::Goal(goal(goal::Target::Position(position)))),
        request(navigate_request::Content::Goal(goal(goal::Target::Label("kitchen".to_owned())))),
        request(navigate_request::Content::Stop(v1::StopNavigation {})),
    ];
    let plan = v1::PlanRouteRequest {
        map: "maps/drive".to_owned(),
        from_place_number: 0,
        goal: Some(goal(goal::Target::PlaceNumber(2))),
        reverse_travel: 1,
    };
    vec![
        call("NavigationService/Navigate", &messages),
        call("NavigationService/PlanRoute", &[plan.encode_to_vec()]),
    ]
}

/// Strings by their numbers: what most requests are.
fn strings(fields: &[(u8, &str)]) -> Vec<u8> {
    let field =
        |&(number, text): &(u8, &str)| [&[number << 3 | 2, text.len() as u8][..], text.as_bytes()].concat();
    fields.iter().flat_map(field).collect()
}

pub(super) fn grpc() -> Vec<Seed> {
    let words_hash = words_hash();
    let image = |seed: &Seed| seed.target == "image" && seed.name.starts_with("colour");
    let images: Vec<_> = super::files::seeds().into_iter().filter(image).map(|seed| seed.bytes).collect();
    let mut seeds = streams(&words_hash, &images);
    seeds.extend(navigations(&words_hash));
    let query = |content| v1::QueryRequest {
        map: "maps/drive".to_owned(),
        content: Some(content),
        words_hash: words_hash.clone(),
        explained_words: Some(3),
    };
    let queries = [
        ("query-words", query_request::Content::Words(words())),
        ("query-histogram", query_request::Content::Histogram(histogram())),
        ("query-image", query_request::Content::Image(images[0].clone())),
    ];
    for (name, content) in queries {
        seeds.push(named(call("RecognitionService/Query", &[query(content).encode_to_vec()]), name));
    }
    let settings = v1::MapSettings {
        closure_threshold: Some(0.9),
        guard_frames: Some(3),
        new_place_prior: Some(0.9),
        true_positive_rate: Some(0.4),
        false_positive_rate: Some(0.01),
        place_spacing_m: Some(0.5),
        place_spacing_rad: Some(0.5),
        keep: 2,
        ..v1::MapSettings::default()
    };
    let create = v1::CreateMapRequest {
        map_id: "other".to_owned(),
        model: "fixture".to_owned(),
        settings: Some(settings),
    };
    seeds.push(call("MapService/CreateMap", &[create.encode_to_vec()]));
    let pose = v1::AddRelativePoseRequest {
        frame: "maps/drive/sessions/first/frames/5".to_owned(),
        earlier_frame: "maps/drive/sessions/first/frames/1".to_owned(),
        pose: Some(pose()),
        covariance: odometry().covariance,
    };
    seeds.push(call("SessionService/AddRelativePose", &[pose.encode_to_vec()]));
    let (map, session) = ("maps/drive", "maps/drive/sessions/first");
    let frame = "maps/drive/sessions/first/frames/5";
    let simple: [(&str, &[(u8, &str)]); 31] = [
        ("SessionService/ListSessions", &[(1, map)]),
        ("SessionService/GetSession", &[(1, session)]),
        ("SessionService/ListFrames", &[(1, session)]),
        ("SessionService/GetFrame", &[(1, frame)]),
        ("SessionService/GetFrameImage", &[(1, frame)]),
        ("SessionService/ExplainFrame", &[(1, frame)]),
        ("SessionService/GetFramePicture", &[(1, frame)]),
        ("SessionService/DeleteSession", &[(1, "maps/drive/sessions/second")]),
        ("NavigationService/GetNavigation", &[(1, "maps/drive/navigations/robot")]),
        ("LabelService/ListLabels", &[(1, map)]),
        ("LabelService/SetLabel", &[(1, "maps/drive/places/1"), (2, "küche")]),
        ("AppearanceService/GetAppearanceGraph", &[(1, map)]),
        ("EventService/Watch", &[(1, map)]),
        ("MapService/GetMap", &[(1, map)]),
        ("MapService/ListMaps", &[]),
        ("MapService/ListPlaces", &[(1, map)]),
        ("MapService/GetPlace", &[(1, "maps/drive/places/1")]),
        ("MapService/ListWordPlaces", &[(1, map)]),
        ("MapService/GetMatchMatrix", &[(1, map)]),
        ("MapService/GetMatchMatrixTile", &[(1, map)]),
        ("MapService/ListLoopClosures", &[(1, map)]),
        ("MapService/ExportPoses", &[(1, map)]),
        ("MapService/ExportMap", &[(1, map)]),
        ("MapService/TrimMap", &[(1, map)]),
        ("MapService/CompactMap", &[(1, map)]),
        ("MapService/RebuildMap", &[(1, map), (2, "models/fixture"), (3, "again")]),
        ("CorrectionService/ConfirmLoopClosure", &[(1, frame), (2, "maps/drive/sessions/first/frames/1")]),
        ("CorrectionService/ListCorrections", &[(1, map)]),
        ("MergeService/MergeMaps", &[(1, map), (1, "maps/other"), (2, "both")]),
        ("ModelService/ListModels", &[]),
        ("JobService/ListJobs", &[]),
    ];
    seeds.extend(simple.map(|(method, fields)| call(method, &[strings(fields)])));
    let raw = b"!MapService/ListMaps\n\0\0\0\0\0".to_vec();
    seeds.push(Seed::new("grpc", "raw", raw));
    seeds
}

/// `words_hash` of the model in the fixture.
fn words_hash() -> String {
    let snapshot = fixture("tests/tests/fixtures/map-v3.snapshot");
    Model::from_bytes(&model_in(&snapshot)).unwrap().words_hash().to_string()
}

pub(super) fn rest() -> Vec<Seed> {
    let hash = words_hash();
    let query = format!(
        r#"{{"words_hash":"{hash}","histogram":{{"words":[1,2,3,4,5,6,7,8,9,10],"counts":[3,4,1,1,1,1,1,1,1,1]}}}}"#
    );
    let reads = [
        "/v1/maps?page_size=1",
        "/v1/maps/drive",
        "/v1/maps/drive/places?every=2&from_place_number=1",
        "/v1/maps/drive/places/1",
        "/v1/maps/drive/words/3/places",
        "/v1/maps/drive/loop-closures",
        "/v1/maps/drive/loop-closures.csv",
        "/v1/maps/drive/loop-closures.json",
        "/v1/maps/drive/posteriors.csv",
        "/v1/maps/drive/posteriors.json",
        "/v1/maps/drive/matrix?against=drive",
        "/v1/maps/drive/matrix/tiles/0/0/0",
        "/v1/maps/drive/sessions",
        "/v1/maps/drive/sessions/first",
        "/v1/maps/drive/sessions/first/frames?note=door&from_sequence=2",
        "/v1/maps/drive/sessions/first/frames/5",
        "/v1/maps/drive/sessions/first/frames/5/explanation?place_number=1&max_words=3",
        "/v1/maps/drive/sessions/first/frames/5/image?size=thumbnail",
        "/v1/maps/drive/sessions/first/frames/5/picture",
        "/v1/maps/drive/sessions/first/trajectory?format=tum",
        "/v1/maps/drive/graph.g2o",
        "/v1/maps/drive/corrections",
        "/v1/maps/drive/labels",
        "/v1/maps/drive/navigations",
        "/v1/maps/drive/appearance-graph",
        "/v1/maps/drive/route?from_place_number=0&to_place_number=2",
        "/v1/maps/drive/export",
        "/v1/models",
        "/v1/models/fixture/export",
        "/v1/jobs",
        "/v1/merges",
        "/v1/whoami",
        "/v1/openapi.json",
        "/",
        "/metrics",
    ];
    let writes = [
        (
            "POST",
            "/v1/maps",
            r#"{"map_id":"other","model":"fixture","settings":{"closure_threshold":0.9,"keep":"words"}}"#,
        ),
        ("POST", "/v1/maps/drive/query", &query),
        ("PUT", "/v1/maps/drive/places/1/label", r#"{"label":"kitchen"}"#),
        ("PUT", "/v1/maps/drive/navigations/robot/goal", r#"{"position":{"part":0,"x_m":1.0,"y_m":2.0}}"#),
        (
            "POST",
            "/v1/maps/drive/corrections",
            r#"{"withdraw":{"frame":"maps/drive/sessions/first/frames/5"}}"#,
        ),
        ("POST", "/v1/merges", r#"{"sources":["maps/drive","maps/other"],"target":"both"}"#),
        ("PUT", "/v1/models/fixture/display-name", r#"{"display_name":"x"}"#),
        ("DELETE", "/v1/maps/other", ""),
        ("DELETE", "/v1/maps/drive/sessions/second", ""),
        ("POST", "/v1/maps/new/import", "WPSNAP\r\n\u{4}\0\0\0"),
    ];
    let reads = reads.iter().enumerate().map(|(number, path)| {
        let headers = if number % 2 == 0 { "" } else { "host: localhost:7601\naccept-encoding: identity\n" };
        Seed::new("rest", format!("get-{number:02}"), format!("GET {path}\n{headers}\n"))
    });
    let writes = writes.iter().enumerate().map(|(number, (method, path, body))| {
        let head = format!("{method} {path}\ncontent-type: application/json\n\n");
        Seed::new("rest", format!("write-{number:02}"), format!("{head}{body}"))
    });
    reads.chain(writes).collect()
}
