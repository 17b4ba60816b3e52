//! A robot's time is that of its stamps: however fast it runs beside the server's, the commands are the same.

use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt;
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;
use waypost_client::{FrameContent, FrameInput, v1};
use waypost_proto::v1::navigate_request::Content;
use waypost_proto::v1::navigate_response;
use waypost_proto::v1::navigation_service_client::NavigationServiceClient;
use waypost_sim::drive::{Building, TWICE_A_SECOND};
use waypost_sim::link::{Link, LinkSettings};
use waypost_sim::pose::Pose;
use waypost_sim::render::Shot;
use waypost_sim::robot::{Command, WheelErrors};
use waypost_sim::simulation::{CameraTrigger, Obedience, Simulation, SimulationSettings};

use super::metric::{teach, to_place, way};
use crate::harness::{
    Panoramas, Server, camera_ahead, channel, frame_input, import_model, in_time, odometry,
};

const PERIOD: Duration = Duration::from_millis(100);
/// 0.3 s each way.
const REPORTS_LATE: u64 = 6;
const REPORTS: u64 = 45;

fn report(number: u64) -> v1::NavigateRequest {
    let pose = v1::Pose {
        position_m: Some(v1::Vector3::default()),
        orientation: Some(v1::Quaternion { w: 1.0, ..v1::Quaternion::default() }),
    };
    let wheels = v1::WheelReport {
        stamp_ns: 1 + (number * PERIOD.as_nanos() as u64) as i64,
        odometry: Some(v1::Odometry { pose: Some(pose), covariance: Vec::new() }),
        obeyed_number: number.checked_sub(REPORTS_LATE),
        reflex: false,
    };
    v1::NavigateRequest { content: Some(Content::Wheels(wheels)) }
}

/// What a robot that recognises nothing is told at each of its reports, sent so many times as fast as stamped.
async fn told(server: &Server, robot: &str, pace: f64) -> Vec<(v1::VelocityCommand, i32)> {
    let mut service = NavigationServiceClient::new(channel(&server.endpoint()).await);
    let open = v1::OpenNavigation {
        map: "maps/drive".to_owned(),
        navigation_id: robot.to_owned(),
        camera: Some(camera_ahead()),
        ..Default::default()
    };
    let (requests, receiver) = mpsc::channel(4);
    requests.send(v1::NavigateRequest { content: Some(Content::Open(open)) }).await.unwrap();
    let mut answers = service.navigate(ReceiverStream::new(receiver)).await.unwrap().into_inner();
    in_time(answers.message()).await.unwrap();
    let name = format!("maps/drive/navigations/{robot}");
    let goal = v1::Goal { target: Some(v1::goal::Target::PlaceNumber(0)) };
    service.set_goal(v1::SetGoalRequest { name, goal: Some(goal) }).await.unwrap();
    let mut told = Vec::new();
    for number in 0..REPORTS {
        requests.send(report(number)).await.unwrap();
        let answer = in_time(answers.next()).await.unwrap().unwrap();
        let Some(navigate_response::Content::Guidance(guidance)) = answer.content else {
            panic!("{answer:?}")
        };
        told.push((guidance.command.unwrap(), guidance.status));
        tokio::time::sleep(PERIOD.div_f64(pace)).await;
    }
    told
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_drive_gives_the_same_commands_at_any_pace() {
    let (server, client) = Server::with_map().await;
    crate::harness::answers_of(
        &client,
        crate::harness::session_options("drive", "teacher"),
        vec![crate::harness::frame(1)],
    )
    .await;
    let (slow, real, fast) =
        tokio::join!(told(&server, "slow", 0.3), told(&server, "real", 1.0), told(&server, "fast", 8.0));
    // It stands and looks for two seconds, and turns.
    let turns =
        |told: &[(v1::VelocityCommand, i32)]| told.iter().position(|(command, _)| command.turn_rad_s != 0.0);
    assert_eq!(turns(&real), Some(20));
    // Its wheels do not follow: blocked, and it is told to stand.
    let blocked = i32::from(v1::NavigationStatus::Blocked);
    assert!(real.iter().any(|(command, status)| *status == blocked && command.turn_rad_s == 0.0));
    assert_eq!(fast, real);
    assert_eq!(slow, real);
    server.stop().await;
}

/// Simulated seconds to each of the server's: slower than real time, at it, and faster.
const PACES: [f64; 3] = [0.3, 1.0, 8.0];
/// Time on the way, each way, by the robot's clock.
const DELAY_NS: i64 = 300_000_000;
/// Steps of the simulation from wheel report to wheel report.
const STEPS_A_REPORT: u64 = 5;

/// A command with the report or panorama that it answers.
type Told = (i64, v1::VelocityCommand, i32);

/// What answers what a robot sends.
#[derive(Clone, Copy, PartialEq)]
enum Eyes {
    /// A frame is answered by what was seen in it.
    Ahead,
    /// A panorama is answered by a command.
    AllAround,
}

/// A robot in step with its server: what is under way takes [`DELAY_NS`] of the robot's own time, and none of the
/// server's.
struct InStep {
    robot: Simulation,
    requests: mpsc::Sender<v1::NavigateRequest>,
    answers: Streaming<v1::NavigateResponse>,
    eyes: Eyes,
    up: Link<Content>,
    down: Link<v1::VelocityCommand>,
    obeyed: Option<u64>,
    steps: u64,
    told: Vec<Told>,
}

impl InStep {
    async fn open(server: &Server, open: v1::OpenNavigation, robot: Simulation, eyes: Eyes) -> Self {
        let mut service = NavigationServiceClient::new(channel(&server.endpoint()).await);
        let (requests, receiver) = mpsc::channel(4);
        requests.send(v1::NavigateRequest { content: Some(Content::Open(open)) }).await.unwrap();
        let mut answers = service.navigate(ReceiverStream::new(receiver)).await.unwrap().into_inner();
        in_time(answers.message()).await.unwrap();
        let late = LinkSettings { latency_ns: DELAY_NS, ..LinkSettings::PERFECT };
        let (up, down) = (Link::new(late, 1).unwrap(), Link::new(late, 2).unwrap());
        Self { robot, requests, answers, eyes, up, down, obeyed: None, steps: 0, told: Vec::new() }
    }

    /// One step of the simulation, and what reaches either side in it. `image` renders what the camera takes.
    async fn step(&mut self, image: impl Fn(&Shot) -> Vec<u8>) {
        let tick = self.robot.advance();
        if self.steps.is_multiple_of(STEPS_A_REPORT) {
            self.up.send(
                tick.stamp_ns,
                Content::Wheels(v1::WheelReport {
                    stamp_ns: tick.stamp_ns + 1,
                    odometry: (self.eyes == Eyes::Ahead).then(|| odometry(&tick.odometry)),
                    obeyed_number: self.obeyed,
                    reflex: tick.obedience == Obedience::Reflex,
                }),
            );
        }
        self.steps += 1;
        if let Some(frame) = &tick.frame {
            let mut input = match self.eyes {
                Eyes::Ahead => frame_input(frame, image(&frame.shot)),
                Eyes::AllAround => {
                    FrameInput::new(frame.number + 1, 0, FrameContent::Image(image(&frame.shot)))
                }
            };
            // Stamps of one stream rise: the panorama comes after the report of the same step.
            input.stamp_ns = frame.stamp_ns + 2;
            self.up.send(tick.stamp_ns, Content::Frame(input.into()));
        }
        while let Some((at_ns, content)) = self.up.receive(tick.stamp_ns) {
            if let Some(command) = self.answered(content).await {
                self.down.send(at_ns, command);
            }
        }
        while let Some((_, command)) = self.down.receive(tick.stamp_ns) {
            let v1::VelocityCommand { number, forward_m_s, turn_rad_s, valid_ns } = command;
            self.obeyed = Some(number);
            self.robot.command(Command { forward_m_s, turn_rad_s, valid_ns });
        }
    }

    /// The server's command in answer to what it is sent.
    async fn answered(&mut self, content: Content) -> Option<v1::VelocityCommand> {
        let is_seen_alone = self.eyes == Eyes::Ahead && matches!(content, Content::Frame(_));
        self.requests.send(v1::NavigateRequest { content: Some(content) }).await.unwrap();
        loop {
            match in_time(self.answers.message()).await.unwrap().unwrap().content.unwrap() {
                navigate_response::Content::Guidance(guidance) => {
                    let command = guidance.command.unwrap();
                    self.told.push((guidance.stamp_ns, command, guidance.status));
                    return Some(command);
                }
                navigate_response::Content::Seen(_) if is_seen_alone => return None,
                navigate_response::Content::Seen(_) => {}
                other => panic!("{other:?}"),
            }
        }
    }

    /// Drives for some steps, so many simulated seconds to each real one.
    async fn drive(&mut self, steps: u64, pace: f64, image: impl Fn(&Shot) -> Vec<u8>) {
        let step = Duration::from_nanos(self.robot.settings().period_ns as u64).div_f64(pace);
        let mut ticks = interval(step);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        for _ in 0..steps {
            ticks.tick().await;
            self.step(&image).await;
        }
    }
}

/// What a robot with wheels and a camera ahead is told on a way that it was taught.
async fn driven_ahead(server: &Server, building: &Building, goal: u32, pace: f64) -> Vec<Told> {
    let robot = format!("ahead-{}", pace * 10.0);
    let open = v1::OpenNavigation {
        map: "maps/taught".to_owned(),
        navigation_id: robot.clone(),
        camera: Some(camera_ahead()),
        ..Default::default()
    };
    let simulated = building.robot(WheelErrors::drawn(7), 7, TWICE_A_SECOND).unwrap();
    let mut in_step = InStep::open(server, open, simulated, Eyes::Ahead).await;
    let image = |shot: &Shot| building.image(shot).to_jpeg().unwrap();
    // It recognises where it is; then it is sent off, and the way is planned in the server's own time.
    in_step.drive(100, pace, image).await;
    let client = server.client().await;
    let name = format!("maps/taught/navigations/{robot}");
    client.set_goal(&name, to_place(goal)).await.unwrap();
    let planned = async {
        while client.navigation(&name).await.unwrap().route.is_none() {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    in_time(planned).await;
    in_step.drive(500, pace, image).await;
    in_step.told
}

/// What a robot is told that sees all around and has no odometry.
async fn driven_by_looks(server: &Server, panoramas: &Panoramas, goal: u32, pace: f64) -> Vec<Told> {
    let robot = format!("looks-{}", pace * 10.0);
    let open = v1::OpenNavigation {
        map: "maps/looks".to_owned(),
        navigation_id: robot.clone(),
        camera: Some(panoramas.camera()),
        goal: Some(to_place(goal)),
        ..Default::default()
    };
    let settings = SimulationSettings {
        trigger: CameraTrigger::Period { period_ns: 250_000_000 },
        seed: 5,
        ..SimulationSettings::new(panoramas.rig.clone())
    };
    let start = Pose::new(9.1, 2.6, -1.5);
    let simulated = Simulation::new(Arc::clone(&panoramas.scene), start, settings).unwrap();
    let mut in_step = InStep::open(server, open, simulated, Eyes::AllAround).await;
    in_step.drive(400, pace, |shot: &Shot| panoramas.image(shot)).await;
    in_step.told
}

/// How many of the commands drive on.
fn driving(told: &[Told]) -> usize {
    told.iter().filter(|(_, command, _)| command.forward_m_s > 0.1).count()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_sees_ahead_is_led_alike_at_any_pace() {
    let building = way(5.0);
    let server = Server::start().await;
    let (_, goal) = teach(&building, &server.client().await).await;
    let drives = PACES.map(|pace| driven_ahead(&server, &building, goal, pace));
    let [slow, real, fast]: [Vec<Told>; 3] = futures::future::join_all(drives).await.try_into().unwrap();
    assert!(driving(&real) > 60, "{real:?}");
    assert_eq!(slow, real);
    assert_eq!(fast, real);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_sees_all_around_is_led_alike_at_any_pace() {
    let panoramas = Panoramas::new();
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    let taught = panoramas.teach(&client, ("looks", &model.name), &[&[[9.2, 2.0], [9.2, 5.0]]]).await;
    let goal = taught[taught.len() - 1].place;
    let drives = PACES.map(|pace| driven_by_looks(&server, &panoramas, goal, pace));
    let [slow, real, fast]: [Vec<Told>; 3] = futures::future::join_all(drives).await.try_into().unwrap();
    assert!(driving(&real) > 5, "{real:?}");
    assert_eq!(slow, real);
    assert_eq!(fast, real);
    server.stop().await;
}
