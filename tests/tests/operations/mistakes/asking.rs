//! What is asked of a map, a job or a person, and what is said where there is no answer.

use reqwest::StatusCode;
use waypost_client::{Client, NavigationOptions, v1};

use super::Beginner;
use crate::harness::{Answer, camera_ahead, http, path};

#[tokio::test(flavor = "multi_thread")]
async fn routes_that_nobody_drove() {
    let beginner = Beginner::new();
    let route = async |from: u32, to: u32| {
        let asked = format!("/v1/maps/hall/route?from_place_number={from}&to_place_number={to}");
        Answer::to(http().get(format!("{}{asked}", beginner.waypost.http()))).await
    };
    // The map has no metres. No robot is in the question, so none is in the answer.
    let apart = route(0, 1).await;
    assert_eq!(apart.status, StatusCode::CONFLICT, "{}", apart.text());
    let said = apart.text();
    assert!(said.contains("the map has no metres, and a robot is led by them"), "{said}");
    for (from, to) in [(0, 9999), (9999, 0)] {
        let unknown = route(from, to).await;
        assert_eq!(unknown.status, StatusCode::NOT_FOUND, "{}", unknown.text());
        assert!(unknown.text().contains("no place 9999"), "{}", unknown.text());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_that_the_map_lacks_is_refused_and_the_robot_keeps_its_own() {
    let beginner = Beginner::with_metres();
    let client = Client::connect(&beginner.waypost.endpoint()).await.unwrap();
    let goal = v1::Goal { target: Some(v1::goal::Target::PlaceNumber(1)) };
    let options = NavigationOptions {
        navigation_id: "robot".to_owned(),
        goal: Some(goal.clone()),
        ..NavigationOptions::new("ways", camera_ahead())
    };
    let navigation = client.navigate(options).await.unwrap();
    let nowhere = ["navigate", "ways", "robot", "--to", "9999"];
    for output in [&[][..], &["--json"]] {
        let (code, said) = beginner.waypost.fails(&[&nowhere[..], output].concat());
        assert_eq!(code, 4, "{said}");
        assert!(said.contains("the map has no place 9999; list its places"), "{said}");
    }
    let led = client.navigation("maps/ways/navigations/robot").await.unwrap();
    assert_eq!(led.goal, Some(goal));
    drop(navigation);
}

/// It would search for its way until somebody stops it.
#[tokio::test(flavor = "multi_thread")]
async fn nobody_is_led_through_a_map_without_metres() {
    let beginner = Beginner::new();
    let client = Client::connect(&beginner.waypost.endpoint()).await.unwrap();
    let options = |goal| NavigationOptions {
        navigation_id: "robot".to_owned(),
        goal,
        ..NavigationOptions::new("hall", camera_ahead())
    };
    let goal = v1::Goal { target: Some(v1::goal::Target::PlaceNumber(1)) };
    let refused = client.navigate(options(Some(goal))).await.err().unwrap().to_string();
    assert!(refused.contains("the map has no metres, and a robot is led by them"), "{refused}");

    let navigation = client.navigate(options(None)).await.unwrap();
    let name = "maps/hall/navigations/robot";
    for goal in [["--to", "1"], ["--to-position", "0,0"]] {
        let (code, said) = beginner.waypost.fails(&[&["navigate", "hall", "robot"][..], &goal].concat());
        assert!(code == 4 && said.contains("drive the way while frames bring odometry"), "{said}");
    }
    let url = format!("{}/v1/{name}/goal", beginner.waypost.http());
    let put = http().put(url).json(&serde_json::json!({ "place_number": 1 }));
    let answer = Answer::to(put).await;
    assert_eq!(answer.status, StatusCode::CONFLICT, "{}", answer.text());
    assert_eq!(client.navigation(name).await.unwrap().goal, None);
    drop(navigation);
}

#[test]
fn a_job_that_waits_for_nobody_says_so() {
    let beginner = Beginner::new();
    let images = path(beginner.images.path()).to_owned();
    let train = ["model", "train", "--images", &images, "--words", "40", "--name", "small", "--detach"];
    let job = beginner.waypost.json(&train);
    let stage = job["stage"].as_str().unwrap();
    assert!(!stage.is_empty() && !stage.contains("another job"), "{job}");
    let number = job["name"].as_str().unwrap().trim_start_matches("jobs/").to_owned();
    assert_eq!(beginner.waypost.json(&["job", "watch", &number])["state"], "succeeded");
    // Too late: nobody is to believe that it was cancelled.
    let (code, said) = beginner.waypost.fails(&["job", "cancel", &number]);
    assert!(code == 1 && said.contains("has ended already (succeeded); nothing was cancelled"), "{said}");
}

/// On a terminal, people are asked before something is lost. Only a yes is one.
#[test]
fn people_are_asked_before_something_is_lost() {
    let beginner = Beginner::new();
    let waypost = &beginner.waypost;
    let hall = waypost.json(&["map", "show", "hall"]);
    for (command, question) in [
        (
            &["session", "rm", "hall", "monday"][..],
            "delete monday from the map hall? it cannot be undone [y/N]",
        ),
        (&["map", "trim", "hall", "--places", "2", "--apply"], "[y/N]"),
        (&["map", "compact", "hall"], "so that no merge can be undone? [y/N]"),
        (&["map", "rm", "hall"], "delete the map hall with all its sessions? [y/N]"),
    ] {
        // The last two are the end of the input, before any answer and within one.
        for typed in ["n\n", "no\n", "\n", "yesterday\n", "", "n\u{4}\u{4}"] {
            let (code, screen) = waypost.on_a_terminal(command, typed);
            assert_eq!(code, 1, "{command:?}, {typed:?}: {screen}");
            assert!(screen.contains(question), "{command:?}, {typed:?}: {screen}");
            assert!(screen.contains("nothing was done; answer y, or give --yes"), "{typed:?}: {screen}");
        }
        assert_eq!(waypost.json(&["map", "show", "hall"]), hall, "{command:?}");
    }
    for (command, typed, done) in [
        (&["session", "rm", "hall", "monday"][..], "y\n", "deleted maps/hall/sessions/monday"),
        (&["map", "compact", "hall"], "Yes\n", "compacted hall"),
        (&["map", "rm", "hall"], " y \n", "deleted hall"),
    ] {
        let (code, screen) = waypost.on_a_terminal(command, typed);
        assert!(code == 0 && screen.contains("[y/N]") && screen.contains(done), "{command:?}: {screen}");
    }
    let (code, said) = waypost.fails(&["map", "show", "hall"]);
    assert!(code == 4 && said.contains("there is no map hall"), "{said}");
}
