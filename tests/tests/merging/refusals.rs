//! Maps that cannot be merged: each refusal says why.

use waypost_client::v1::merge::State;
use waypost_client::v1::merge_source::Outcome;
use waypost_client::{Code, SessionOptions, v1};

use crate::harness::{
    Server, answers_of, as_histogram, assert_status, camera_ahead, found, http, import_model, map_request,
    model_of_other_words, refused, take_model, words_options,
};

use super::rounds::{OnceFound, done, request};

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_merged_is_said() {
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    let other = take_model(&client, "other", &model_of_other_words()).await;
    client.create_map(map_request("empty", &model.name)).await.unwrap();
    client.create_map(map_request("bare", &model.name)).await.unwrap();
    client.create_map(crate::harness::by_words_request("foreign", &other.name)).await.unwrap();
    for (sources, target, code, fragment) in [
        (&["empty", "empty"][..], "new", Code::InvalidArgument, "named twice"),
        (&["empty"], "new", Code::InvalidArgument, "name two maps or more"),
        (&["empty"], "empty", Code::InvalidArgument, "nothing is to go into the map empty"),
        (&[], "empty", Code::InvalidArgument, "nothing is to go into"),
        (&["nowhere"], "empty", Code::NotFound, "there is no map nowhere"),
        (&["foreign"], "empty", Code::FailedPrecondition, "different words"),
        (&["foreign", "empty"], "new", Code::FailedPrecondition, "different words"),
        (&["No"], "empty", Code::InvalidArgument, "is no map name"),
    ] {
        let answer = refused(client.merge_maps(request(sources, target, OnceFound::Commit)).await);
        assert_status(&format!("{sources:?} into {target}"), (answer.0, &answer.1), code, fragment);
    }
    let few = v1::MergeMapsRequest { min_support: Some(2), ..request(&["bare"], "empty", OnceFound::Commit) };
    let answer = refused(client.merge_maps(few).await);
    assert_status("support", (answer.0, &answer.1), Code::InvalidArgument, "least support cannot be 2");
    assert_eq!(refused(client.merge("merges/77").await).0, Code::NotFound);
    assert_eq!(refused(client.merge("77").await).0, Code::InvalidArgument);
    assert_eq!(refused(client.commit_merge("merges/77").await).0, Code::NotFound);
    assert_eq!(refused(client.delete_session("maps/empty/sessions/none").await).0, Code::NotFound);

    // Nothing overlaps with an empty map: that is an answer.
    let asked = client.merge_maps(request(&["bare"], "empty", OnceFound::Commit)).await.unwrap();
    let apart = done(&client, &asked).await;
    assert_eq!(apart.state(), State::NoOverlap);
    let Some(Outcome::NoOverlapReason(why)) = &apart.sources[0].outcome else { panic!("{apart:?}") };
    assert!(why.contains("no two places"), "{why}");
    // It is seen over REST, too, and asked for there.
    let list = found(&server, "/v1/merges").await;
    assert_eq!(list["merges"][0]["state"], "no_overlap");
    let body = r#"{"sources": ["maps/bare"], "target": "maps/empty"}"#;
    let asked = http()
        .post(server.url("/v1/merges"))
        .header("content-type", "application/json")
        .body(body)
        .send()
        .await
        .unwrap();
    assert!(asked.status().is_success(), "{asked:?}");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn maps_of_cameras_that_see_otherwise_say_so() {
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    // Two stretches of the drive that show different places.
    for (map, horizontal_deg, stretch) in [("wide", 85_f64, 1..=4), ("narrow", 65.0, 30..=33)] {
        client.create_map(map_request(map, &model.name)).await.unwrap();
        let seen = v1::FieldOfView { horizontal_rad: horizontal_deg.to_radians() };
        let camera = v1::Camera { model: Some(v1::camera::Model::FieldOfView(seen)), ..camera_ahead() };
        let options = SessionOptions { camera: Some(camera), ..words_options(map, "drive") };
        answers_of(&client, options, stretch.map(as_histogram)).await;
    }
    let asked = client.merge_maps(request(&["wide"], "narrow", OnceFound::Commit)).await.unwrap();
    let apart = done(&client, &asked).await;
    let Some(Outcome::NoOverlapReason(why)) = &apart.sources[0].outcome else { panic!("{apart:?}") };
    assert!(
        why.contains("wide was mapped by a camera that sees 85 degrees across, narrow by one that sees 65"),
        "{why}"
    );
    server.stop().await;
}
