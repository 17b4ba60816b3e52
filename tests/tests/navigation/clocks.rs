//! A robot's time is that of its stamps: however fast it runs beside the server's, the commands are the same.

use std::time::Duration;

use futures::StreamExt;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use waypost_proto::v1;
use waypost_proto::v1::navigate_request::Content;
use waypost_proto::v1::navigate_response;
use waypost_proto::v1::navigation_service_client::NavigationServiceClient;

use crate::harness::{Server, camera_ahead, channel, in_time};

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
