//! What somebody finds who has just installed a server: a model is there, and nothing has to be chosen.

use reqwest::StatusCode;
use serde_json::json;

use crate::harness::{
    CommandLine, Server, ServerProcess, model_file, model_of_other_words, path, take_model,
};

#[tokio::test(flavor = "multi_thread")]
async fn a_server_without_models_offers_the_one_that_ships() {
    let directory = tempfile::tempdir().unwrap();
    // And again after a restart, not twice.
    for _ in 0..2 {
        let server = ServerProcess::start(directory.path());
        let client = server.client().await;
        let models = client.models().await.unwrap();
        let names: Vec<&str> = models.iter().map(|model| model.display_name.as_str()).collect();
        assert_eq!(names, ["shipped"]);
        let mut file = Vec::new();
        client.export_model("shipped", &mut file).await.unwrap();
        assert!(file == std::fs::read(model_file()).unwrap(), "it is not the model of the demo");
        server.stop();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_with_a_model_of_its_own_is_left_alone() {
    let directory = tempfile::tempdir().unwrap();
    let before = Server::start_on(directory.path()).await;
    let own = take_model(&before.client().await, "site", &model_of_other_words()).await;
    before.stop().await;
    let server = ServerProcess::start(directory.path());
    assert_eq!(server.client().await.models().await.unwrap(), [own]);
    server.stop();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_needs_no_model_to_be_chosen() {
    let waypost = CommandLine::new();
    let shipped = waypost.json(&["model", "show", "shipped"])["name"].clone();
    assert_eq!(waypost.json(&["map", "create", "hall"])["model"], shipped);
    // Nor over REST.
    let create = async |map: &str| {
        let posted = crate::harness::http().post(format!("{}/v1/maps", waypost.http()));
        posted.json(&json!({ "map_id": map })).send().await.unwrap()
    };
    let made = create("attic").await;
    assert_eq!(made.status(), StatusCode::OK);
    assert_eq!(made.json::<serde_json::Value>().await.unwrap()["model"], shipped);

    // Of two models, somebody has to choose.
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("site.waypost");
    std::fs::write(&file, model_of_other_words().to_bytes()).unwrap();
    waypost.text(&["model", "import", path(&file), "--name", "site"]);
    let (code, stderr) = waypost.fails(&["map", "create", "cellar"]);
    assert!(code == 4 && stderr.contains("more than one model, so name one"), "{code}: {stderr}");
    assert!(stderr.contains("site, shipped"), "the newest first: {stderr}");
    assert_eq!(create("cellar").await.status(), StatusCode::BAD_REQUEST);

    // And of none.
    for command in
        [["map", "rm", "hall"], ["map", "rm", "attic"], ["model", "rm", "shipped"], ["model", "rm", "site"]]
    {
        waypost.text(&[&command[..], &["--yes"]].concat());
    }
    let (code, stderr) = waypost.fails(&["map", "create", "cellar"]);
    assert!(code == 4 && stderr.contains("no model; train or import one"), "{code}: {stderr}");
}
