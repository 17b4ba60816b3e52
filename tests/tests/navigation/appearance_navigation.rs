//! A simulated robot is led by looks alone, over the real server: panoramas, no odometry, a room that a person named.

mod refusals;

use std::time::Duration;

use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use waypost_client::{
    Client, Code, FrameContent, FrameInput, Navigation, NavigationEvent, NavigationOptions, Reading,
    SessionOptions, v1,
};
use waypost_sim::drive::REFLEX_IN_DOORS;
use waypost_sim::pose::Pose;
use waypost_sim::robot::{Body, Command};
use waypost_sim::simulation::{CameraTrigger, Obedience, Simulation, SimulationSettings};

use crate::harness::{
    Answer, CommandLine, Panoramas, Server, TaughtPlace, assert_status, by_looks_request, found, get, http,
    import_model, in_time, map_request, path, refused, said, session_options, state_hash, taught_at,
    taught_hall,
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
    navigation.see(FrameInput { sequence, stamp_ns, content, odometry: None, note: String::new() });
    let told = guidance.wait_for(|told| told.as_ref().is_some_and(|told| told.stamp_ns == stamp_ns));
    in_time(told).await.unwrap().clone().unwrap()
}

fn robot_at(panoramas: &Panoramas, start: Pose) -> Simulation {
    let settings = SimulationSettings {
        trigger: CameraTrigger::Period { period_ns: OBSERVATION_NS },
        seed: 5,
        reflex: Some(REFLEX_IN_DOORS),
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
        end("from_place_number").distance_m(&end("to_place_number"))
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
    let labelled = ask(&server, Method::PUT, &path, json!({ "label": "kitchen", "scope": "space" })).await;
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
    let at = view["guidance"]["appearance"]["goal_place_number"].as_u64().unwrap();
    assert!(taught[at as usize].pose.distance_m(&end) < 1.5, "{view}, at {end:?}");
    // It only looked.
    assert_eq!(state_hash(&client, "looks").await, hash);

    // Back to where an image was taken.
    let there = taught[2];
    let image = panoramas.taken_at(Pose { heading_rad: 1.0, ..there.pose }, 99);
    let request = http().put(server.url(goal)).header("content-type", "image/jpeg").body(image);
    let sent = Answer::to(request).await;
    let place = sent.json()["goal"]["place_number"].as_u64().unwrap_or_else(|| panic!("{}", sent.text()));
    assert!(taught[place as usize].pose.distance_m(&there.pose) < 0.6, "place {place}");
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
    let made = waypost.json(&[
        "map",
        "create",
        "looks",
        "--model",
        "shipped",
        "--navigation-strategy",
        "appearance",
    ]);
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
    assert_eq!(
        (&led["guidance"]["status"], &led["goal"]["label"]),
        (&json!("arrived"), &json!("the end")),
        "{led}"
    );
    let goal_place = &led["guidance"]["appearance"]["goal_place_number"];
    assert_eq!(goal_place.as_u64(), Some(last.place.into()), "{led}");
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
            .is_none_or(|goal| goal.target != Some(v1::goal::Target::PlaceNumber(last.place)))
        {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    in_time(goes_there).await;
    robot.advance();
    drive(&panoramas, &mut robot, &mut navigation, 1000).await;
    let (waypost, led) = in_time(sent).await.unwrap();
    assert_eq!(
        (&led["guidance"]["status"], led["goal"]["place_number"].as_u64()),
        (&json!("arrived"), Some(last.place.into())),
        "{led}"
    );
    let again = waypost.json(&["navigate", "looks", "robot", "--cancel"]);
    assert!(again["goal"].is_null(), "{again}");
    let removed = waypost.json(&["map", "label", "looks", &place, "--remove"]);
    assert!(removed["unlabelled"].as_str().unwrap().ends_with(&place), "{removed}");
    assert!(client.labels("looks").await.unwrap().is_empty());
}

/// Cameras make larger panoramas than a server takes: what somebody sends as a goal is made smaller before.
#[tokio::test(flavor = "multi_thread")]
async fn a_large_panorama_of_a_goal_is_made_smaller_and_taken() {
    let panoramas = Panoramas::new();
    let waypost = CommandLine::new();
    let client = Client::connect(&waypost.endpoint()).await.unwrap();
    let model = import_model(&client).await;
    let taught = taught_hall(&client, &model.name).await;
    let there = taught[2];
    // 21 megapixels.
    let small = image::load_from_memory(&panoramas.taken_at(there.pose, 99)).unwrap();
    let large = small.resize_exact(9216, 2304, image::imageops::FilterType::Triangle);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("there.jpg");
    large.save(&file).unwrap();
    let navigation = client.navigate(options(&panoramas, "robot")).await.unwrap();
    let name = "maps/looks/navigations/robot";
    let as_it_is = v1::goal::Target::Image(std::fs::read(&file).unwrap());
    let (code, message) = refused(client.set_goal(name, to(as_it_is)).await);
    assert_status("as it is", (code, &message), Code::InvalidArgument, "the 16 megapixels allowed");
    assert_eq!(client.navigation(name).await.unwrap().goal, None);

    let sent = tokio::task::spawn_blocking(move || {
        let led = waypost.json(&["navigate", "looks", "robot", "--to-image", path(&file)]);
        (waypost, led)
    });
    let taken = async {
        loop {
            let goal = client.navigation(name).await.unwrap().goal;
            if goal.is_some() || sent.is_finished() {
                return goal;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    let taken = in_time(taken).await;
    let Some(v1::Goal { target: Some(v1::goal::Target::PlaceNumber(place)) }) = taken else {
        panic!("{taken:?}");
    };
    assert!(taught[place as usize].pose.distance_m(&there.pose) < 0.6, "place {place}");
    // Nobody drives there: it ends where the goal is given up.
    client.cancel_goal(name).await.unwrap();
    let (_waypost, led) = in_time(sent).await.unwrap();
    assert!(led["goal"].is_null(), "{led}");
    drop(navigation);
}
