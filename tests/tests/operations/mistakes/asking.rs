//! What is asked of a map or a job, and what is said where there is no answer.

use reqwest::StatusCode;

use super::Beginner;
use crate::harness::{Answer, http, path};

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
    assert!(said.contains("no way that was driven joins place 1 with the start"), "{said}");
    for (from, to) in [(0, 9999), (9999, 0)] {
        let unknown = route(from, to).await;
        assert_eq!(unknown.status, StatusCode::NOT_FOUND, "{}", unknown.text());
        assert!(unknown.text().contains("no place 9999"), "{}", unknown.text());
    }
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
}
