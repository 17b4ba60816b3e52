//! A simulated robot is led along a map over gRPC, by camera and wheels; and what cannot be led is refused.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Instant, MissedTickBehavior, interval};
use waypost_client::{
    Client, ClientOptions, Code, Command, FrameContent, FrameInput, Navigation, NavigationEvent,
    NavigationOptions, Reading, SessionOptions, v1,
};
use waypost_sim::drive::{Building, TWICE_A_SECOND};
use waypost_sim::pose::Pose;
use waypost_sim::robot::WheelErrors;
use waypost_sim::simulation::{CameraFrame, Obedience, Simulation};
use waypost_sim::worlds::NamedWorld;

use crate::harness::{
    CommandLine, Proxy, Server, answers_of, assert_status, building, by_words_request, camera_ahead, channel,
    driven, frame, frame_input, import_model, in_time, map_request, odometry, refused, session_options,
    state_hash,
};

/// The first metres of a way through an office.
pub(super) fn way(length_m: f64) -> Building {
    let mut office = building(NamedWorld::Office, 2, "teach");
    office.route = office.route.cut(length_m);
    office
}

fn follower(building: &Building, seed: u64) -> Simulation {
    building.robot(WheelErrors::drawn(seed), seed, TWICE_A_SECOND).unwrap()
}

fn sent(building: &Building, frame: &CameraFrame) -> FrameInput {
    frame_input(frame, building.image(&frame.shot).to_jpeg().unwrap())
}

/// Teaches the map `taught`; true poses of the way, and the place that it ends at.
pub(super) async fn teach(building: &Building, client: &Client) -> (Vec<Pose>, u32) {
    let model = import_model(client).await;
    client.create_map(map_request("taught", &model.name)).await.unwrap();
    let taught = driven(building, WheelErrors::drawn(1), 1);
    let frames: Vec<FrameInput> = taught.frames().map(|frame| sent(building, frame)).collect();
    let options = SessionOptions { camera: Some(camera_ahead()), ..session_options("taught", "teacher") };
    let answers = answers_of(client, options, frames).await;
    (taught.ticks.iter().map(|tick| tick.truth).collect(), answers.last().unwrap().place_number.unwrap())
}

pub(super) fn to_place(place: u32) -> v1::Goal {
    v1::Goal { target: Some(v1::goal::Target::PlaceNumber(place)) }
}

/// What came of a drive.
struct Led {
    truth: Vec<Pose>,
    /// Whether the robot stood still although it has a goal, at each step.
    stood: Vec<bool>,
    events: Vec<NavigationEvent>,
}

/// Drives in real time as it is told, until it has arrived. `at_step` may do something to the world.
async fn drive(
    building: &Building,
    robot: &mut Simulation,
    navigation: &mut Navigation,
    mut at_step: impl FnMut(usize, Command),
) -> Led {
    let mut steps = interval(Duration::from_millis(20));
    steps.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let guidance = navigation.guidance();
    let mut led = Led { truth: Vec::new(), stood: Vec::new(), events: Vec::new() };
    let began = Instant::now();
    while guidance.borrow().as_ref().is_none_or(|told| told.status() != v1::NavigationStatus::Arrived) {
        assert!(
            began.elapsed() < Duration::from_secs(100),
            "not there: {:?}, {:?}",
            *guidance.borrow(),
            led.events
        );
        steps.tick().await;
        let command = navigation.command();
        at_step(led.truth.len(), command);
        let Command { forward_m_s, turn_rad_s } = command;
        robot.command(waypost_sim::robot::Command { forward_m_s, turn_rad_s, valid_ns: 40_000_000 });
        let tick = robot.advance();
        navigation.report(Reading {
            stamp_ns: tick.stamp_ns + 1,
            odometry: odometry(&tick.odometry),
            reflex: tick.obedience == Obedience::Reflex,
        });
        if let Some(frame) = &tick.frame {
            navigation.see(sent(building, frame));
        }
        led.truth.push(tick.truth);
        led.stood.push(command == Command::default());
        while let Some(event) = navigation.try_next() {
            led.events.push(event);
        }
    }
    led
}

/// It repeats what it was taught with other wheels, loses the connection on the way, stands until it is back, and goes on.
#[tokio::test(flavor = "multi_thread")]
async fn a_robot_drives_the_way_that_it_was_taught_though_the_connection_breaks() {
    let building = way(8.0);
    let server = Server::start().await;
    let (taught, goal) = teach(&building, &server.client().await).await;
    let hash = state_hash(&server.client().await, "taught").await;

    let proxy = Arc::new(Proxy::start().await);
    let address = server.endpoint().trim_start_matches("http://").parse().unwrap();
    proxy.forward_to(Some(address));
    let client = Client::connect(ClientOptions::new(proxy.endpoint())).await.unwrap();
    let options = NavigationOptions {
        navigation_id: "robot".to_owned(),
        goal: Some(to_place(goal)),
        ..NavigationOptions::new("taught", camera_ahead())
    };
    let mut navigation = client.navigate(options).await.unwrap();
    assert_eq!(navigation.opened().navigation, "maps/taught/navigations/robot");
    let mut robot = follower(&building, 7);
    let (mut cut_at, mut stood) = (None, false);
    let led = drive(&building, &mut robot, &mut navigation, |step, command| {
        let driving = command.forward_m_s > 0.3;
        match cut_at {
            // Well on its way.
            None if driving && step > 400 => {
                cut_at = Some(step);
                proxy.forward_to(None);
                proxy.cut();
            }
            Some(cut) if step == cut + 75 => proxy.forward_to(Some(address)),
            // A command holds for half a second and no longer.
            Some(cut) if (cut + 40..cut + 75).contains(&step) => {
                assert_eq!(command, Command::default(), "{step}");
                stood = true;
            }
            None | Some(_) => {}
        }
    })
    .await;
    assert!(stood, "it arrived before the connection was cut");
    let is = |wanted: fn(&NavigationEvent) -> bool| led.events.iter().filter(|event| wanted(event)).count();
    assert!(is(|event| matches!(event, NavigationEvent::Disconnected { .. })) >= 1, "{:?}", led.events);
    assert_eq!(
        is(|event| matches!(event, NavigationEvent::Reconnected { resumed: true })),
        1,
        "{:?}",
        led.events
    );
    let seen: Vec<&v1::FrameSeen> = led
        .events
        .iter()
        .filter_map(|event| match event {
            NavigationEvent::Seen(seen) => Some(seen),
            _ => None,
        })
        .collect();
    let closures = seen.iter().filter(|seen| seen.place_number.is_some()).count();
    assert!(closures * 10 >= seen.len() * 6, "{closures} closures of {}", seen.len());
    let off_m = |pose: &Pose| taught.iter().map(|truth| truth.distance_m(pose)).fold(f64::INFINITY, f64::min);
    let most_m = led.truth.iter().map(off_m).fold(0.0, f64::max);
    assert!(most_m < 0.25, "{most_m} m off the way");
    let end_m = led.truth.last().unwrap().distance_m(taught.last().unwrap());
    assert!(end_m < 0.7, "{end_m} m from where the way ended");
    assert_eq!(robot.collisions(), 0);
    // It only looked.
    let client = server.client().await;
    assert_eq!(state_hash(&client, "taught").await, hash);
    let view = client.navigation("maps/taught/navigations/robot").await.unwrap();
    assert!(view.connected && view.recognitions as usize >= closures, "{view:?}");
    let route = view.route.unwrap();
    assert_eq!(route.waypoints.last().unwrap().place_number, goal);
    drop(navigation);
    server.stop().await;
}

/// A person sends it somewhere else, and stops it.
#[tokio::test(flavor = "multi_thread")]
async fn people_send_and_stop_a_robot_that_is_led() {
    let building = way(4.0);
    let waypost = CommandLine::new();
    let client = Client::connect(&waypost.endpoint()).await.unwrap();
    let (_, goal) = teach(&building, &client).await;
    let options = NavigationOptions {
        navigation_id: "robot".to_owned(),
        ..NavigationOptions::new("taught", camera_ahead())
    };
    let mut navigation = client.navigate(options).await.unwrap();
    let mut robot = follower(&building, 8);
    let refusal = waypost.fails(&["navigate", "taught", "nobody", "--to", "1"]);
    assert!(refusal.0 == 4 && refusal.1.contains("no robot nobody is being led"), "{refusal:?}");
    assert!(waypost.text(&["navigate", "taught"]).contains("robot"));
    let (map, place) = ("taught".to_owned(), goal.to_string());
    let sent = tokio::task::spawn_blocking(move || {
        let led = waypost.json(&["navigate", &map, "robot", "--to", &place]);
        (waypost, led)
    });
    drive(&building, &mut robot, &mut navigation, |_, _| {}).await;
    let (waypost, led) = in_time(sent).await.unwrap();
    assert_eq!(
        (led["guidance"]["status"].as_str(), led["goal"]["place_number"].as_u64()),
        (Some("arrived"), Some(goal.into())),
        "{led}"
    );
    // What it was told of one goal is nothing of the next.
    let name = "maps/taught/navigations/robot";
    assert_eq!(
        client.navigation(name).await.unwrap().guidance.unwrap().status(),
        v1::NavigationStatus::Arrived
    );
    let sent = client.set_goal(name, to_place(goal)).await.unwrap();
    assert_eq!((sent.guidance, sent.goal), (None, Some(to_place(goal))));
    let stopped = waypost.json(&["navigate", "taught", "robot", "--cancel"]);
    assert!(stopped["goal"].is_null(), "{stopped}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_led_is_refused_with_the_way_out() {
    let (server, client) = Server::with_map().await;
    let model = import_model(&client).await;
    client.create_map(by_words_request("words", &model.name)).await.unwrap();
    // The images are not the simulator's.
    let any_size = v1::Camera { image_width_px: None, image_height_px: None, ..camera_ahead() };
    let good = || NavigationOptions {
        navigation_id: "robot".to_owned(),
        ..NavigationOptions::new("drive", any_size.clone())
    };
    let speed =
        |speed_m_s| v1::DrivingSettings { speed_m_s: Some(speed_m_s), ..v1::DrivingSettings::default() };
    let fisheye =
        v1::Fisheye { fx_px: 100.0, fy_px: 100.0, cx_px: 50.0, cy_px: 50.0, distortion: Vec::new() };
    for (case, options, code, fragment) in [
        ("no map", NavigationOptions::new("nowhere", camera_ahead()), Code::NotFound, "nowhere"),
        (
            "by words",
            NavigationOptions::new("words", camera_ahead()),
            Code::FailedPrecondition,
            "verification",
        ),
        (
            "no camera",
            NavigationOptions { camera: v1::Camera::default(), ..good() },
            Code::InvalidArgument,
            "field of view",
        ),
        (
            "a fisheye",
            NavigationOptions {
                camera: v1::Camera { model: Some(v1::camera::Model::Fisheye(fisheye)), ..camera_ahead() },
                ..good()
            },
            Code::InvalidArgument,
            "field of view",
        ),
        (
            "a bad name",
            NavigationOptions { navigation_id: "No".to_owned(), ..good() },
            Code::InvalidArgument,
            "a-z",
        ),
        (
            "backwards",
            NavigationOptions { driving: speed(-1.0), ..good() },
            Code::InvalidArgument,
            "speed_m_s",
        ),
        ("NaN", NavigationOptions { driving: speed(f64::NAN), ..good() }, Code::InvalidArgument, "speed_m_s"),
        (
            "no goal",
            NavigationOptions { goal: Some(v1::Goal::default()), ..good() },
            Code::InvalidArgument,
            "empty",
        ),
        (
            "words",
            NavigationOptions { words_hash: "0".repeat(64), ..good() },
            Code::FailedPrecondition,
            "words_hash",
        ),
    ] {
        let (said, message) = refused(client.navigate(options).await);
        assert_status(case, (said, &message), code, fragment);
    }

    for (x_m, heading_rad) in [(f64::NAN, None), (0.0, Some(f64::INFINITY))] {
        let position = v1::PositionGoal { part: 0, x_m: Some(x_m), y_m: Some(0.0), heading_rad };
        let goal = Some(v1::Goal { target: Some(v1::goal::Target::Position(position)) });
        let (said, message) = refused(client.navigate(NavigationOptions { goal, ..good() }).await);
        assert_status("a goal that is not finite", (said, &message), Code::InvalidArgument, "not finite");
    }

    // One commander a robot.
    let mut navigation = client.navigate(good()).await.unwrap();
    let (code, message) = refused(client.navigate(good()).await);
    assert_status("a second one", (code, &message), Code::FailedPrecondition, "one commander at a time");

    // Wheels that no robot has, and frames that say nothing of where they were taken.
    let at = |x: f64| v1::Odometry {
        pose: Some(v1::Pose {
            position_m: Some(v1::Vector3 { x, y: 0.0, z: 0.0 }),
            orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
        }),
        covariance: Vec::new(),
    };
    let mut told = navigation.guidance();
    navigation.report(Reading { stamp_ns: 1_000_000_000, odometry: at(0.0), reflex: false });
    in_time(told.changed()).await.unwrap();
    assert_eq!(told.borrow_and_update().as_ref().unwrap().status(), v1::NavigationStatus::Idle);
    for (case, stamp_ns, odometry, fragment) in [
        ("400 m/s", 1_020_000_000, at(8.0), "jumped 8.0 m"),
        ("NaN", 1_020_000_000, at(f64::NAN), "not a finite number"),
        ("no pose", 1_020_000_000, v1::Odometry::default(), "has no pose"),
        ("an old stamp", 1_000_000_000, at(0.0), "is not after"),
        ("no stamp", 0, at(0.0), "has no stamp"),
    ] {
        navigation.report(Reading { stamp_ns, odometry, reflex: false });
        let event = in_time(navigation.next()).await.unwrap().unwrap();
        let NavigationEvent::WheelsRefused(refusal) = event else { panic!("{case}: {event:?}") };
        assert_eq!(refusal.stamp_ns, stamp_ns);
        assert!(refusal.status.as_ref().unwrap().message.contains(fragment), "{case}: {refusal:?}");
    }
    for (case, spoil, fragment) in [
        (
            "no odometry",
            (|frame: &mut FrameInput| frame.odometry = None) as fn(&mut FrameInput),
            "no odometry",
        ),
        ("no image", |frame| frame.content = FrameContent::Image(b"nothing".to_vec()), "JPEG"),
        ("no stamp", |frame| frame.stamp_ns = 0, "no stamp"),
    ] {
        let mut wrong = FrameInput { odometry: Some(at(0.0)), ..frame(1) };
        spoil(&mut wrong);
        navigation.see(wrong);
        let event = in_time(navigation.next()).await.unwrap().unwrap();
        let NavigationEvent::FrameRefused(refusal) = event else { panic!("{case}: {event:?}") };
        assert!(refusal.status.as_ref().unwrap().message.contains(fragment), "{case}: {refusal:?}");
    }
    // After all that the navigation goes on.
    navigation.report(Reading { stamp_ns: 1_040_000_000, odometry: at(0.01), reflex: false });
    in_time(told.changed()).await.unwrap();
    navigation.see(FrameInput { odometry: Some(at(0.01)), ..frame(2) });
    let event = in_time(navigation.next()).await.unwrap().unwrap();
    assert!(matches!(&event, NavigationEvent::Seen(seen) if seen.sequence == 2), "{event:?}");

    // Ended, it can be led by another.
    drop(navigation);
    let again = async {
        loop {
            match client.navigate(good()).await {
                Ok(navigation) => return navigation,
                Err(_) => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        }
    };
    drop(in_time(again).await);
    server.stop().await;
}

/// What the contract says of the order of messages.
#[tokio::test(flavor = "multi_thread")]
async fn a_stream_begins_by_opening() {
    use v1::navigate_request::Content;
    use waypost_proto::v1::navigation_service_client::NavigationServiceClient;
    let (server, _client) = Server::with_map().await;
    let mut service = NavigationServiceClient::new(channel(&server.endpoint()).await);
    let request = |content| v1::NavigateRequest { content: Some(content) };
    let stop = || request(Content::Stop(v1::StopNavigation {}));
    let refusal = service.navigate(futures::stream::iter([stop()])).await.unwrap_err();
    assert_status(
        "stop",
        (refusal.code(), refusal.message()),
        Code::InvalidArgument,
        "must open a navigation",
    );
    let open = || v1::OpenNavigation {
        map: "maps/drive".to_owned(),
        camera: Some(camera_ahead()),
        ..Default::default()
    };
    let twice = [request(Content::Open(open())), stop(), request(Content::Open(open()))];
    let mut answers = service.navigate(futures::stream::iter(twice)).await.unwrap().into_inner();
    let opened = in_time(answers.message()).await.unwrap().unwrap();
    assert!(
        matches!(&opened.content, Some(v1::navigate_response::Content::Opened(opened)) if opened.navigation == "maps/drive/navigations/robot-0"),
        "{opened:?}"
    );
    let ended = in_time(answers.message()).await.unwrap_err();
    assert_status("twice", (ended.code(), ended.message()), Code::InvalidArgument, "after the first message");
    server.stop().await;
}
