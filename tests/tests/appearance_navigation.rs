//! A simulated robot is led by looks alone, over the real server: panoramas, no odometry, a room that a person named.

use std::time::Duration;

use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use waypost_client::{
    Client, Code, FrameContent, FrameInput, Navigation, NavigationEvent, NavigationOptions, Reading,
    SessionOptions, v1,
};
use waypost_sim::pose::Pose;
use waypost_sim::range_sensor::ReflexSettings;
use waypost_sim::robot::{Body, Command};
use waypost_sim::simulation::{CameraTrigger, Obedience, Simulation, SimulationSettings};

use crate::harness::{
    Answer, CommandLine, Panoramas, Server, TaughtPlace, assert_status, by_looks_request, found, get, http,
    import_model, in_time, map_request, path, refused, session_options, state_hash, taught_at,
};

/// From room b through the hall, into room c; and through room c.
const LINES: [&[[f64; 2]]; 3] = [
    &[[5.0, 4.5], [5.0, 0.8], [9.2, 0.8], [9.2, 3.5], [7.1, 3.5]],
    &[[7.1, 2.4], [7.1, 5.6]],
    &[[9.2, 3.5], [9.2, 5.5]],
];

/// From panorama to panorama.
const OBSERVATION_NS: i64 = 250_000_000;

fn options(panoramas: &Panoramas, name: &str) -> NavigationOptions {
    NavigationOptions {
        navigation_id: name.to_owned(),
        ..NavigationOptions::new("looks", panoramas.camera())
    }
}

fn to(target: v1::goal::Target) -> v1::Goal {
    v1::Goal { target: Some(target) }
}

/// Asks REST with a JSON body.
async fn ask(server: &Server, method: Method, path: &str, body: Value) -> Answer {
    Answer::to(http().request(method, server.url(path)).json(&body)).await
}

/// The next panorama, and what is said to it.
async fn look(
    panoramas: &Panoramas,
    robot: &Simulation,
    navigation: &mut Navigation,
    sequence: u64,
) -> v1::Guidance {
    let mut shot = robot.look();
    shot.seed = shot.seed.wrapping_add(sequence);
    let stamp_ns = robot.now_ns() + 1;
    let content = FrameContent::Image(panoramas.image(&shot));
    let mut guidance = navigation.guidance();
    navigation.see(FrameInput { sequence, stamp_ns, content, odometry: None });
    let told = guidance.wait_for(|told| told.as_ref().is_some_and(|told| told.stamp_ns == stamp_ns));
    in_time(told).await.unwrap().clone().unwrap()
}

fn robot_at(panoramas: &Panoramas, start: Pose) -> Simulation {
    let reflex = ReflexSettings {
        stop_m: 0.15,
        margin_m: 0.02,
        turn_rad_s: 0.8,
        ahead_ns: 600_000_000,
        ahead_m_s: 0.25,
    };
    let settings = SimulationSettings {
        trigger: CameraTrigger::Period { period_ns: OBSERVATION_NS },
        seed: 5,
        reflex: Some(reflex),
        ..SimulationSettings::new(panoramas.rig.clone())
    };
    Simulation::new(panoramas.scene.clone(), start, settings).unwrap()
}

/// Drives by the server's headings, around what its own range sensor sees in the way; where it went.
async fn drive(
    panoramas: &Panoramas,
    robot: &mut Simulation,
    navigation: &mut Navigation,
    from_sequence: u64,
) -> Vec<Pose> {
    let mut path = Vec::new();
    for sequence in from_sequence..from_sequence + 400 {
        let told = look(panoramas, robot, navigation, sequence).await;
        let command = told.command.unwrap();
        assert_eq!(command.valid_ns, 500_000_000);
        if told.status() == v1::NavigationStatus::Arrived {
            assert_eq!((command.forward_m_s, command.turn_rad_s), (0.0, 0.0));
            return path;
        }
        let heading = told.appearance.and_then(|by_looks| by_looks.heading_rad);
        let free = heading.map(|heading| robot.scan().free_heading_rad(heading, Body::default().radius_m));
        let (forward_m_s, turn_rad_s) = match free {
            Some(free) => (0.4 * (1.0 - free.abs() / 0.8).max(0.0), (1.8 * free).clamp(-1.2, 1.2)),
            None => (command.forward_m_s, command.turn_rad_s),
        };
        robot.command(Command { forward_m_s, turn_rad_s, valid_ns: 2 * OBSERVATION_NS });
        let until_ns = robot.now_ns() + OBSERVATION_NS;
        while robot.now_ns() < until_ns {
            let tick = robot.advance();
            // Not the panorama's stamp, which comes next.
            navigation.report_reflex(tick.stamp_ns, tick.obedience == Obedience::Reflex);
            path.push(tick.truth);
        }
    }
    let led = navigation.guidance().borrow().clone().unwrap();
    panic!("not there, at {:?}: {led:?}", robot.robot().pose());
}

fn room_of(panoramas: &Panoramas, pose: &Pose) -> String {
    let room = panoramas.scene.plan().room_at(pose.position());
    room.map_or_else(String::new, |room| room.name.clone())
}

fn nearest(taught: &[TaughtPlace], x: f64, y: f64) -> TaughtPlace {
    let gap = |taught: &&TaughtPlace| taught.pose.distance_m(&Pose::new(x, y, 0.0));
    *taught.iter().min_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_goes_to_a_room_by_looks_alone() {
    let panoramas = Panoramas::new();
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    let taught = panoramas.teach(&client, ("looks", &model.name), &LINES).await;
    assert!(taught.len() >= 25, "{} places of {taught:?}", taught.len());
    let hash = state_hash(&client, "looks").await;

    // The graph has grown beside the stream, and comes out the same when it is built anew.
    let graph = found(&server, "/v1/maps/looks/appearance-graph").await;
    let nodes = graph["nodes"].as_array().unwrap();
    assert_eq!(nodes.len(), taught.len());
    let links = graph["links"].as_array().unwrap();
    let gap_m = |link: &Value| {
        let end = |side: &str| taught[link[side].as_u64().unwrap() as usize].pose;
        end("from_place").distance_m(&end("to_place"))
    };
    assert!(links.len() > taught.len() && links.iter().all(|link| gap_m(link) < 6.0), "{links:?}");
    drop(client);
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    assert_eq!(found(&server, "/v1/maps/looks/appearance-graph").await, graph);
    let client = server.client().await;

    // A person calls a room a kitchen, by one of its places.
    let kitchen = nearest(&taught, 7.1, 4.2);
    assert_eq!(room_of(&panoramas, &kitchen.pose), "room c");
    let path = format!("/v1/maps/looks/places/{}/label", kitchen.place);
    let labelled = ask(&server, Method::PUT, &path, json!({ "label": "kitchen", "reach": "space" })).await;
    assert_eq!(labelled.status, StatusCode::OK, "{}", labelled.text());
    let labels = labelled.json()["labels"].as_array().unwrap().clone();
    assert_eq!(found(&server, "/v1/maps/looks/labels").await["labels"].as_array().unwrap(), &labels);
    let rooms: Vec<String> = labels
        .iter()
        .map(|label| label["place"].as_str().unwrap().rsplit('/').next().unwrap().parse::<usize>().unwrap())
        .map(|place| room_of(&panoramas, &taught[place].pose))
        .collect();
    let of_the_room = rooms.iter().filter(|room| *room == "room c").count();
    assert!(of_the_room >= 5 && of_the_room * 10 >= rooms.len() * 9, "{rooms:?}");

    // The robot starts in another room, looking anywhere, and is sent by the name.
    let mut navigation = client.navigate(options(&panoramas, "robot")).await.unwrap();
    let mut robot = robot_at(&panoramas, Pose::new(4.9, 4.0, 2.0));
    assert_eq!(room_of(&panoramas, robot.robot().pose()), "room b");
    let goal = "/v1/maps/looks/navigations/robot/goal";
    let sent = ask(&server, Method::PUT, goal, json!({ "label": "kitchen" })).await;
    assert_eq!(sent.json()["goal"]["label"], json!("kitchen"), "{}", sent.text());
    drive(&panoramas, &mut robot, &mut navigation, 1).await;
    let end = *robot.robot().pose();
    assert_eq!(room_of(&panoramas, &end), "room c", "{end:?}");
    let view = found(&server, "/v1/maps/looks/navigations/robot").await;
    assert_eq!(view["guidance"]["status"], json!("arrived"), "{view}");
    let at = view["guidance"]["appearance"]["goal_place"].as_u64().unwrap();
    assert!(taught[at as usize].pose.distance_m(&end) < 1.5, "{view}, at {end:?}");
    // It only looked.
    assert_eq!(state_hash(&client, "looks").await, hash);

    // Back to where an image was taken.
    let there = taught[2];
    let image = panoramas.taken_at(Pose { heading_rad: 1.0, ..there.pose }, 99);
    let request = http().put(server.url(goal)).header("content-type", "image/jpeg").body(image);
    let sent = Answer::to(request).await;
    let place = sent.json()["goal"]["place"].as_u64().unwrap_or_else(|| panic!("{}", sent.text()));
    assert!(taught[place as usize].pose.distance_m(&there.pose) < 0.6, "place {place}");
    drop(navigation);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_led_by_looks_is_refused_with_the_way_out() {
    let panoramas = Panoramas::new();
    let (server, client) = Server::with_map().await;
    let model = import_model(&client).await;
    let taught = panoramas.teach(&client, ("looks", &model.name), &[&[[9.2, 2.0], [9.2, 5.0]]]).await;
    let settings = v1::MapSettings {
        keep: v1::map_settings::Keep::Words.into(),
        ..by_looks_request("", "").settings.unwrap()
    };
    let request = v1::CreateMapRequest { settings: Some(settings), ..map_request("words", &model.name) };
    let (code, message) = refused(client.create_map(request).await);
    assert_status("words alone", (code, &message), Code::InvalidArgument, "keep features");

    let ahead = v1::Camera {
        model: Some(v1::camera::Model::FieldOfView(v1::FieldOfView { horizontal_rad: 1.2 })),
        ..v1::Camera::default()
    };
    let session = SessionOptions { camera: Some(ahead.clone()), ..session_options("looks", "ahead") };
    let (code, message) = refused(client.open_session(session).await);
    assert_status("a session", (code, &message), Code::FailedPrecondition, "takes panoramas");
    let good = || options(&panoramas, "robot");
    let label = |label: &str| to(v1::goal::Target::Label(label.to_owned()));
    let nowhere = v1::PositionGoal { part: 0, x_m: 1.0, y_m: 1.0, heading_rad: None };
    let mirror = v1::HyperbolicMirror {
        center_x_px: 256.0,
        center_y_px: 256.0,
        inner_radius_px: 40.0,
        outer_radius_px: 250.0,
        eccentricity: 1.4,
        ..v1::HyperbolicMirror::default()
    };
    let unwound =
        v1::Camera { model: Some(v1::camera::Model::HyperbolicMirror(mirror)), ..v1::Camera::default() };
    for (case, options, code, fragment) in [
        ("ahead", NavigationOptions { camera: ahead, ..good() }, Code::InvalidArgument, "takes panoramas"),
        ("no horizon", NavigationOptions { camera: unwound, ..good() }, Code::InvalidArgument, "horizon"),
        (
            "not by looks",
            NavigationOptions { map: "maps/drive".to_owned(), ..good() },
            Code::InvalidArgument,
            "strategy appearance",
        ),
        ("no label", NavigationOptions { goal: Some(label("attic")), ..good() }, Code::NotFound, "none has"),
        (
            "a position",
            NavigationOptions { goal: Some(to(v1::goal::Target::Position(nowhere))), ..good() },
            Code::FailedPrecondition,
            "no metres",
        ),
        (
            "no place",
            NavigationOptions { goal: Some(to(v1::goal::Target::Place(99))), ..good() },
            Code::NotFound,
            "no node",
        ),
    ] {
        let (said, message) = refused(client.navigate(options).await);
        assert_status(case, (said, &message), code, fragment);
    }

    // Labels that are none, and places that are none.
    for (place, body, status, fragment) in [
        ("0", json!({ "label": "" }), StatusCode::BAD_REQUEST, "is no label"),
        ("0", json!({ "label": "a", "reach": "map" }), StatusCode::BAD_REQUEST, "\"reach\": \"space\""),
        ("999", json!({ "label": "a" }), StatusCode::NOT_FOUND, "list its places"),
    ] {
        let path = format!("/v1/maps/looks/places/{place}/label");
        let answer = ask(&server, Method::PUT, &path, body).await;
        assert_eq!(answer.status, status, "{}", answer.text());
        let message = answer.json()["error"]["message"].as_str().unwrap().to_owned();
        assert!(message.contains(fragment), "{message}");
    }
    let answer = get(&server, "/v1/maps/drive/appearance-graph").await;
    assert!(answer.status == StatusCode::CONFLICT && answer.text().contains("strategy appearance"));
    let none = ask(&server, Method::DELETE, "/v1/maps/looks/places/0/label", json!({})).await;
    assert!(none.status == StatusCode::NOT_FOUND && none.text().contains("has no label"), "{}", none.text());
    client.set_label("maps/looks/places/0", "hall", v1::LabelReach::Place).await.unwrap();
    client.set_label("maps/looks/places/1", "the end", v1::LabelReach::Place).await.unwrap();

    // One commander a robot.
    let mut navigation = client.navigate(good()).await.unwrap();
    let (code, message) = refused(client.navigate(good()).await);
    assert_status("a second one", (code, &message), Code::FailedPrecondition, "one commander at a time");

    // A label that no place has, with those that there are; by the stream and by REST.
    navigation.go_to(label("attic")).await.unwrap();
    let event = in_time(navigation.next()).await.unwrap().unwrap();
    let NavigationEvent::GoalRefused(refusal) = event else { panic!("{event:?}") };
    assert!(refusal.message.contains("there are the labels hall, the end"), "{refusal:?}");
    assert_eq!(refusal.goal, Some(label("attic")));
    let goal = "/v1/maps/looks/navigations/robot/goal";
    let answer = ask(&server, Method::PUT, goal, json!({ "label": "attic" })).await;
    assert!(answer.status == StatusCode::NOT_FOUND && answer.text().contains("hall, the end"));
    let both = ask(&server, Method::PUT, goal, json!({ "label": "hall", "place": 1 })).await;
    assert!(both.status == StatusCode::BAD_REQUEST && both.text().contains("one of them alone"));
    let robot = robot_at(&panoramas, taught[2].pose);
    navigation.go_to_image(b"nothing".to_vec()).await.unwrap();
    let event = in_time(navigation.next()).await.unwrap().unwrap();
    assert!(matches!(&event, NavigationEvent::GoalRefused(refusal) if refusal.goal.is_none()), "{event:?}");

    // Without a goal it stands; a panorama of another size is none of the declared camera.
    let told = look(&panoramas, &robot, &mut navigation, 1).await;
    assert_eq!((told.status(), told.appearance), (v1::NavigationStatus::Idle, None));
    assert!(matches!(in_time(navigation.next()).await.unwrap(), Some(NavigationEvent::Seen(_))));
    let frame = |sequence, content| FrameInput {
        sequence,
        stamp_ns: 1_000_000_000 * sequence as i64,
        content: FrameContent::Image(content),
        odometry: None,
    };
    for (case, wrong, fragment) in [
        ("another size", frame(2, crate::harness::images()[0].clone()), "declared with 512 x 128"),
        ("an old one", frame(1, panoramas.taken_at(taught[0].pose, 1)), "number frames upwards"),
    ] {
        navigation.see(wrong);
        let event = in_time(navigation.next()).await.unwrap().unwrap();
        let NavigationEvent::FrameRefused(refusal) = event else { panic!("{case}: {event:?}") };
        assert!(refusal.status.as_ref().unwrap().message.contains(fragment), "{case}: {refusal:?}");
    }
    // After all that the robot is led; while its own reflex drives it is blocked.
    navigation.go_to(label("hall")).await.unwrap();
    let waited = async {
        while client.navigation("maps/looks/navigations/robot").await.unwrap().goal.is_none() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    in_time(waited).await;
    navigation.see(frame(3, panoramas.taken_at(taught[4].pose, 1)));
    let mut guidance = navigation.guidance();
    let told =
        in_time(guidance.wait_for(|told| told.as_ref().is_some_and(|told| told.stamp_ns == 3_000_000_000)));
    let told = told.await.unwrap().clone().unwrap();
    assert_eq!(told.status(), v1::NavigationStatus::Following, "{told:?}");
    let heading_rad = told.appearance.unwrap().heading_rad.unwrap();
    // It looks along the corridor, and the hall lies behind it.
    assert!(heading_rad.abs() > 2.6 && told.command.unwrap().forward_m_s == 0.0, "{told:?}");
    navigation.report_reflex(3_100_000_000, true);
    let blocked = guidance.wait_for(|told| told.as_ref().is_some_and(|told| told.stamp_ns == 3_100_000_000));
    assert_eq!(in_time(blocked).await.unwrap().as_ref().unwrap().status(), v1::NavigationStatus::Blocked);
    navigation.report(Reading { stamp_ns: 3_000_000_000, odometry: v1::Odometry::default(), reflex: false });
    let refusal = async {
        loop {
            if let NavigationEvent::WheelsRefused(refusal) = navigation.next().await.unwrap().unwrap() {
                return refusal;
            }
        }
    };
    assert!(in_time(refusal).await.status.unwrap().message.contains("has no pose"));
    drop(navigation);
    server.stop().await;
}

/// The same for people at a terminal.
#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_names_places_and_sends_robots_there() {
    let panoramas = Panoramas::new();
    let waypost = CommandLine::new();
    waypost.prepare();
    let client = Client::connect(&waypost.endpoint()).await.unwrap();
    let made = waypost.json(&["map", "create", "looks", "--model", "shipped", "--strategy", "appearance"]);
    assert_eq!(made["settings"]["navigation_strategy"], json!("appearance"), "{made}");
    let (folder, taught) = (tempfile::tempdir().unwrap(), taught_at(&[&[[9.2, 2.0], [9.2, 5.0]]]));
    for (number, pose) in (1..).zip(&taught) {
        std::fs::write(folder.path().join(format!("{number:03}.jpg")), panoramas.taken_at(*pose, number))
            .unwrap();
    }
    let images = path(folder.path());
    let refusal = waypost.fails(&["stream", images, "--map", "looks"]);
    assert!(refusal.1.contains("waypost stream --panorama"), "{refusal:?}");
    let streamed = waypost.json(&["stream", images, "--map", "looks", "--panorama", "cylindrical"]);
    assert_eq!(streamed["places_created"], json!(taught.len()), "{streamed}");
    let last = TaughtPlace { place: taught.len() as u32 - 1, pose: taught[taught.len() - 1] };
    let place = last.place.to_string();
    let named = waypost.json(&["map", "label", "looks", &place, "the end"]);
    assert_eq!(named["labels"][0]["label"], json!("the end"), "{named}");
    assert!(waypost.text(&["map", "labels", "looks"]).contains("the end"));
    let refusal = waypost.fails(&["map", "label", "drive", "0", "hall", "--space"]);
    assert!(refusal.0 == 4 || refusal.1.contains("place"), "{refusal:?}");

    let mut navigation = client.navigate(options(&panoramas, "robot")).await.unwrap();
    let refusal = waypost.fails(&["navigate", "looks", "robot", "--to-label", "attic"]);
    assert!(refusal.1.contains("there are the labels the end"), "{refusal:?}");
    let sent = tokio::task::spawn_blocking(move || {
        let led = waypost.json(&["navigate", "looks", "robot", "--to-label", "the end"]);
        (waypost, led)
    });
    let waited = async {
        while client.navigation("maps/looks/navigations/robot").await.unwrap().goal.is_none() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    in_time(waited).await;
    let mut robot = robot_at(&panoramas, Pose::new(9.1, 2.6, -1.5));
    drive(&panoramas, &mut robot, &mut navigation, 1).await;
    let (waypost, led) = in_time(sent).await.unwrap();
    assert_eq!((&led["status"], &led["goal_label"]), (&json!("arrived"), &json!("the end")), "{led}");
    assert_eq!(led["goal_place"].as_u64(), Some(last.place.into()), "{led}");
    assert!(robot.robot().pose().distance_m(&last.pose) < 1.5);

    // There already, as an image of the place says.
    let file = folder.path().join("there.jpg");
    std::fs::write(&file, panoramas.taken_at(last.pose, 3)).unwrap();
    let sent = tokio::task::spawn_blocking(move || {
        let led = waypost.json(&["navigate", "looks", "robot", "--to-image", path(&file)]);
        (waypost, led)
    });
    let goes_there = async {
        while client
            .navigation("maps/looks/navigations/robot")
            .await
            .unwrap()
            .goal
            .is_none_or(|goal| goal.target != Some(v1::goal::Target::Place(last.place)))
        {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    in_time(goes_there).await;
    robot.advance();
    drive(&panoramas, &mut robot, &mut navigation, 1000).await;
    let (waypost, led) = in_time(sent).await.unwrap();
    assert_eq!(
        (&led["status"], led["goal_place"].as_u64()),
        (&json!("arrived"), Some(last.place.into())),
        "{led}"
    );
    let again = waypost.json(&["navigate", "looks", "robot", "--cancel"]);
    assert!(again["goal_place"].is_null(), "{again}");
    let removed = waypost.json(&["map", "label", "looks", &place, "--remove"]);
    assert!(removed["unlabelled"].as_str().unwrap().ends_with(&place), "{removed}");
    assert!(client.labels("looks").await.unwrap().is_empty());
}
