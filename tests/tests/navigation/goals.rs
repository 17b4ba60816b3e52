//! Goals that do not exist are refused at every door, and the robot goes on to the one that it had.

use reqwest::StatusCode;
use serde_json::json;
use waypost_client::{Code, NavigationEvent, NavigationOptions, v1};

use super::metric::{teach, to_place, way};
use crate::harness::{Server, assert_status, camera_ahead, http, in_time, refused};

fn to(target: v1::goal::Target) -> v1::Goal {
    v1::Goal { target: Some(target) }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_that_does_not_exist_takes_no_other_away() {
    use v1::goal::Target;
    let building = way(3.0);
    let server = Server::start().await;
    let client = server.client().await;
    let (_, goal) = teach(&building, &client).await;
    let options = |navigation_id: &str, goal| NavigationOptions {
        navigation_id: navigation_id.to_owned(),
        goal: Some(goal),
        ..NavigationOptions::new("taught", camera_ahead())
    };
    let mut navigation = client.navigate(options("robot", to_place(goal))).await.unwrap();
    let name = "maps/taught/navigations/robot";
    let url = server.url(&format!("/v1/{name}/goal"));
    let position = |part, x_m| {
        Target::Position(v1::PositionGoal { part, x_m: Some(x_m), y_m: Some(0.0), heading_rad: None })
    };
    for (target, body, code, status, fragment) in [
        (
            Target::PlaceNumber(9999),
            json!({ "place_number": 9999 }),
            Code::NotFound,
            StatusCode::NOT_FOUND,
            "no place 9999",
        ),
        (
            position(0, 1000.0),
            json!({ "position": { "part": 0, "x_m": 1000.0, "y_m": 0.0 } }),
            Code::FailedPrecondition,
            StatusCode::CONFLICT,
            "m from the nearest place",
        ),
        (
            position(77, 0.0),
            json!({ "position": { "part": 77, "x_m": 0.0, "y_m": 0.0 } }),
            Code::NotFound,
            StatusCode::NOT_FOUND,
            "no part of the map begins with place 77",
        ),
        (
            Target::Label("attic".to_owned()),
            json!({ "label": "attic" }),
            Code::NotFound,
            StatusCode::NOT_FOUND,
            "attic",
        ),
        (
            Target::Position(v1::PositionGoal { part: 0, x_m: None, y_m: None, heading_rad: Some(1.0) }),
            json!({ "position": { "heading_rad": 1.0 } }),
            Code::InvalidArgument,
            StatusCode::BAD_REQUEST,
            "x_m",
        ),
    ] {
        let case = format!("{body}");
        let (said, message) = refused(client.set_goal(name, to(target.clone())).await);
        assert_status(&case, (said, &message), code, fragment);
        let answer = http().put(&url).json(&body).send().await.unwrap();
        assert_eq!(answer.status(), status, "{case}");
        navigation.go_to(to(target.clone())).await.unwrap();
        let event = in_time(navigation.next()).await.unwrap().unwrap();
        let NavigationEvent::GoalRefused(refusal) = event else { panic!("{case}: {event:?}") };
        assert!(refusal.status.unwrap().message.contains(fragment), "{case}");
        let (said, message) = refused(client.navigate(options("other", to(target))).await);
        assert_status(&case, (said, &message), code, fragment);
        let view = client.navigation(name).await.unwrap();
        assert_eq!(view.goal, Some(to_place(goal)), "{case}");
    }
    // Those that were not opened are not there.
    let led: Vec<String> =
        client.navigations("taught").await.unwrap().into_iter().map(|led| led.name).collect();
    assert_eq!(led, [name]);
    let view = client.navigation(name).await.unwrap();
    assert_eq!(view.goal, Some(to_place(goal)));

    // Nor does the map go away under a robot that is led.
    let (code, message) = refused(client.delete_map("taught").await);
    assert_status("deleted map", (code, &message), Code::FailedPrecondition, "end its navigation first");
    drop(navigation);
    let gone = async {
        while client.navigation(name).await.unwrap().connected {
            tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        }
    };
    in_time(gone).await;
    client.delete_map("taught").await.unwrap();
    server.stop().await;
}
