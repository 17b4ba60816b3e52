//! Ways over places by their looks: goals that nothing joins with where the robot is, robots that stand while they map, and
//! what odometry is good for.

use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use waypost_client::{
    Client, Code, FrameContent, FrameInput, Navigation, NavigationOptions, Reading, SessionOptions, v1,
};
use waypost_sim::pose::Pose;

use crate::harness::{
    Answer, Panoramas, Server, TaughtPlace, answers_of, assert_status, by_looks_request, found, get, http,
    import_model, in_time, refused, session_options, state_hash,
};

const SECOND_NS: i64 = 1_000_000_000;

/// Through one room, and through another one that cannot be seen from there.
const APART: [&[[f64; 2]]; 2] = [&[[4.6, 4.0], [5.4, 5.5]], &[[7.1, 3.6], [7.1, 5.6]]];

fn seen_from(panoramas: &Panoramas, sequence: u64, pose: Pose) -> FrameInput {
    FrameInput {
        sequence,
        stamp_ns: sequence as i64 * SECOND_NS,
        content: FrameContent::Image(panoramas.taken_at(pose, 500 + sequence)),
        odometry: None,
        note: String::new(),
    }
}

async fn led(client: &Client, panoramas: &Panoramas) -> Navigation {
    let options = NavigationOptions {
        navigation_id: "robot".to_owned(),
        ..NavigationOptions::new("looks", panoramas.camera())
    };
    client.navigate(options).await.unwrap()
}

/// What is said to a stamp.
async fn told(navigation: &Navigation, stamp_ns: i64) -> v1::Guidance {
    let mut guidance = navigation.guidance();
    let told = guidance.wait_for(|told| told.as_ref().is_some_and(|told| told.stamp_ns == stamp_ns));
    in_time(told).await.unwrap().clone().unwrap()
}

async fn look(navigation: &Navigation, frame: FrameInput) -> v1::Guidance {
    let stamp_ns = frame.stamp_ns;
    navigation.see(frame);
    told(navigation, stamp_ns).await
}

async fn send_to(server: &Server, goal: Value) -> Value {
    let path = server.url("/v1/maps/looks/navigations/robot/goal");
    let answer = Answer::to(http().request(Method::PUT, path).json(&goal)).await;
    assert_eq!(answer.status, StatusCode::OK, "{}", answer.text());
    answer.json()
}

fn label(place: u32) -> String {
    format!("maps/looks/places/{place}")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_that_nothing_leads_to_is_said_and_another_one_taken_if_there_is() {
    let panoramas = Panoramas::new();
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    let taught = panoramas.teach(&client, ("looks", &model.name), &APART).await;
    let (here, there): (Vec<TaughtPlace>, Vec<TaughtPlace>) =
        taught.iter().partition(|place| place.pose.position()[0] < 6.0);
    assert!(here.len() >= 3 && there.len() >= 3, "{taught:?}");
    let [start, far] = [here[0], there[there.len() - 1]];
    for place in &there[there.len() - 2..] {
        client.set_label(&label(place.place), "kitchen", v1::LabelScope::Place).await.unwrap();
    }

    let navigation = led(&client, &panoramas).await;
    send_to(&server, json!({ "place_number": far.place })).await;
    let standing = look(&navigation, seen_from(&panoramas, 1, start.pose)).await;
    let missing = format!(
        "no links lead from where the robot is (place {}) to the goal (place {}): map a drive that joins them",
        start.place, far.place
    );
    let held = |told: &v1::Guidance| {
        let command = told.command.unwrap();
        assert_eq!(told.status(), v1::NavigationStatus::Blocked, "{told:?}");
        assert_eq!((command.forward_m_s, command.turn_rad_s), (0.0, 0.0), "{told:?}");
    };
    held(&standing);
    assert!(
        standing.detail.as_ref().unwrap().starts_with(&missing),
        "{:?} is not {missing:?}",
        standing.detail
    );
    let view = found(&server, "/v1/maps/looks/navigations/robot").await;
    assert_eq!(view["guidance"]["detail"], json!(standing.detail), "{view}");
    // A room of several places.
    send_to(&server, json!({ "label": "kitchen" })).await;
    let standing = look(&navigation, seen_from(&panoramas, 2, start.pose)).await;
    held(&standing);
    assert!(standing.detail.as_ref().unwrap().contains("and another one)"), "{:?}", standing.detail);

    // The plan says the same, over REST and gRPC.
    let path =
        format!("/v1/maps/looks/route?from_place_number={}&to_place_number={}", start.place, far.place);
    let answer = get(&server, &path).await;
    let missing = format!("no links lead from the place {} to the goal (place {})", start.place, far.place);
    assert_eq!(answer.status, StatusCode::CONFLICT);
    assert!(answer.text().contains(&missing), "{}", answer.text());
    let to = |target| v1::PlanRouteRequest {
        map: "maps/looks".to_owned(),
        from_place_number: start.place,
        goal: Some(v1::Goal { target: Some(target) }),
        reverse_travel: v1::ReverseTravel::Unspecified.into(),
    };
    let (code, message) = refused(client.plan_route(to(v1::goal::Target::PlaceNumber(far.place))).await);
    assert_status("no links", (code, &message), Code::FailedPrecondition, &missing);

    // Somebody calls a place a kitchen that can be reached: that one is meant now.
    let near = here[here.len() - 1];
    client.set_label(&label(near.place), "kitchen", v1::LabelScope::Place).await.unwrap();
    send_to(&server, json!({ "label": "kitchen" })).await;
    let driving = look(&navigation, seen_from(&panoramas, 3, start.pose)).await;
    assert_eq!(driving.status(), v1::NavigationStatus::Following, "{driving:?}");
    assert_eq!((driving.appearance.unwrap().goal_place_number, driving.detail), (Some(near.place), None));
    let planned = client.plan_route(to(v1::goal::Target::Label("kitchen".to_owned()))).await.unwrap();
    let ends =
        [planned.waypoints[0].place_number, planned.waypoints[planned.waypoints.len() - 1].place_number];
    assert_eq!(ends, [start.place, near.place], "{planned:?}");
    assert!(planned.appearance_cost.unwrap() > 1.0 && planned.waypoints[0].pose.is_none(), "{planned:?}");
    let path =
        format!("/v1/maps/looks/route?from_place_number={}&to_place_number={}", start.place, near.place);
    let by_rest = found(&server, &path).await;
    assert_eq!(by_rest["appearance_cost"].as_f64(), planned.appearance_cost, "{by_rest}");
    assert_eq!(by_rest["waypoints"].as_array().unwrap().len(), planned.waypoints.len(), "{by_rest}");

    // Carried to the other room, it is somewhere that does not lead to its place either; and carried back it goes on.
    send_to(&server, json!({ "place_number": near.place })).await;
    held(&look(&navigation, seen_from(&panoramas, 4, far.pose)).await);
    let back = look(&navigation, seen_from(&panoramas, 5, start.pose)).await;
    assert_eq!(back.status(), v1::NavigationStatus::Following, "{back:?}");
    drop(navigation);
    server.stop().await;
}

/// Places of frames that are seen from some poses, one after the other.
async fn mapped(client: &Client, panoramas: &Panoramas, session: &str, poses: &[Pose]) -> Vec<Option<u32>> {
    let frames: Vec<FrameInput> =
        (1..).zip(poses).map(|(sequence, &pose)| seen_from(panoramas, sequence, pose)).collect();
    let options = SessionOptions { camera: Some(panoramas.camera()), ..session_options("looks", session) };
    answers_of(client, options, frames).await.into_iter().map(|answer| answer.place_number).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_stands_or_turns_on_the_spot_adds_no_places() {
    let panoramas = Panoramas::new();
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(by_looks_request("looks", &model.name)).await.unwrap();
    let at = |x, y, heading_rad| Pose::new(x, y, heading_rad);
    let mut drive = vec![at(9.2, 2.0, 1.57); 8];
    drive.extend((0..6).map(|step| at(9.2, 2.0, 1.57 + f64::from(step))));
    drive.push(at(9.2, 2.5, 1.57));
    drive.extend([at(9.2, 3.0, 1.57); 3]);
    let places = mapped(&client, &panoramas, "first", &drive).await;
    let expected: Vec<Option<u32>> = [[Some(0); 14].as_slice(), &[Some(1)], &[Some(2); 3]].concat();
    assert_eq!(places, expected);
    // Another robot's panoramas are its own, even from there.
    assert_eq!(mapped(&client, &panoramas, "second", &drive[..2]).await, [Some(3), Some(3)]);
    let graph = found(&server, "/v1/maps/looks/appearance-graph").await;
    assert_eq!(graph["nodes"].as_array().unwrap().len(), 4, "{graph}");

    // Decided once: what is sent again gets the same answer, and the log tells it all.
    let hash = state_hash(&client, "looks").await;
    assert_eq!(mapped(&client, &panoramas, "first", &drive).await, expected);
    assert_eq!(state_hash(&client, "looks").await, hash);
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    assert_eq!(state_hash(&client, "looks").await, hash);
    assert_eq!(found(&server, "/v1/maps/looks/appearance-graph").await, graph);
    // And after a start the session goes on where it stood.
    let mut longer = drive.clone();
    longer.extend([at(9.2, 3.0, 0.3), at(9.2, 3.5, 0.3)]);
    let places = mapped(&client, &panoramas, "first", &longer).await;
    assert_eq!(places[drive.len()..], [Some(2), Some(4)]);
    server.stop().await;
}

fn odometry(yaw_rad: f64) -> v1::Odometry {
    let orientation = v1::Quaternion { x: 0.0, y: 0.0, z: (yaw_rad / 2.0).sin(), w: (yaw_rad / 2.0).cos() };
    let pose = v1::Pose { position_m: Some(v1::Vector3::default()), orientation: Some(orientation) };
    v1::Odometry { pose: Some(pose), ..v1::Odometry::default() }
}

fn wrapped(angle_rad: f64) -> f64 {
    angle_rad.sin().atan2(angle_rad.cos())
}

/// Wheels tell between two panoramas what the next panorama shows.
#[tokio::test(flavor = "multi_thread")]
async fn the_heading_turns_as_the_robot_does() {
    let panoramas = Panoramas::new();
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    let line: &[[f64; 2]] = &[[9.2, 2.0], [9.2, 5.0]];
    let taught = panoramas.teach(&client, ("looks", &model.name), &[line]).await;
    let navigation = led(&client, &panoramas).await;
    send_to(&server, json!({ "place_number": taught.last().unwrap().place })).await;
    let heading = |told: &v1::Guidance| told.appearance.unwrap().heading_rad.unwrap();
    // Wheels begin anywhere.
    for (turn, (sequence, turned_rad)) in (1_u64..).zip([0.6, -0.9]).enumerate() {
        let (sequence, stood_rad) = (2 * sequence, 1.1 + turn as f64);
        let ahead = Pose { heading_rad: stood_rad, ..taught[0].pose };
        let frame = FrameInput { odometry: Some(odometry(2.5)), ..seen_from(&panoramas, sequence, ahead) };
        let before = look(&navigation, frame).await;
        let stamp_ns = sequence as i64 * SECOND_NS + SECOND_NS / 10;
        navigation.report(Reading { stamp_ns, odometry: odometry(2.5 + turned_rad), reflex: false });
        let between = told(&navigation, stamp_ns).await;
        let error = wrapped(heading(&between) - (heading(&before) - turned_rad));
        assert!(error.abs() < 1e-9, "turned by {turned_rad}: {before:?}, then {between:?}");
        // What is there to be seen says so, too: the truth of the turn is that of the world.
        let turned = Pose { heading_rad: stood_rad + turned_rad, ..ahead };
        let after = look(&navigation, seen_from(&panoramas, sequence + 1, turned)).await;
        let error = wrapped(heading(&after) - heading(&between));
        assert!(error.abs() < 0.1, "turned by {turned_rad}: by wheels {between:?}, by looks {after:?}");
    }
    drop(navigation);
    server.stop().await;
}
