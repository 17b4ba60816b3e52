//! People: what they say of maps, what they make of them, and who may call.

use std::io::Cursor;

use anyhow::{Context, Result, bail, ensure};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use waypost_client::v1::merge::State as MergeState;
use waypost_client::{Client, ClientOptions, Code, Error, SessionOptions, v1};

use super::material::Material;
use super::robots::{HOME, OF_IMAGES, WORDS, drive, kept, make, session};
use super::server::Backup;
use super::stage::{Caller, Stage};

/// The state of the map that nobody writes to.
pub(super) async fn is_as_it_was(caller: &Caller, home: &str) -> Result<()> {
    let now = caller.state_hash(HOME).await?;
    ensure!(now == home, "a map that nobody wrote to is another: {home}, then {now}");
    Ok(())
}

/// Two maps in metres, made one after the other by a robot, and what people do with them.
pub(super) async fn maps_in_metres(caller: &Caller, material: &Material) -> Result<()> {
    let mut random = caller.stage.random(200);
    let mut number = 0;
    loop {
        number += 1;
        let [map, other] = [number % 2, (number + 1) % 2].map(|number| format!("metres-{number}"));
        let Some(step) = caller.stage.step().await else { break };
        make(caller, &map, None).await?;
        let camera = Some(material.camera.clone());
        let options = SessionOptions { camera, ..session(&map, "robot") };
        let answers = drive(caller, options.clone(), &material.drive, OF_IMAGES).await?;
        kept(caller, options, &material.drive, &answers, &mut random).await?;
        drop(step);

        let Some(step) = caller.stage.step().await else { break };
        said(caller, &map, &mut random).await?;
        copied(caller, &map).await?;
        looked_at(caller, &map, &mut random).await?;
        drop(step);

        let Some(_step) = caller.stage.step().await else { break };
        if number > 1 {
            merged(caller, &map, &other, &mut random).await?;
            caller.ask("maps deleted", async |client| client.delete_map(&other).await).await?;
        }
    }
    Ok(())
}

/// Labels and corrections, which are taken back.
async fn said(caller: &Caller, map: &str, random: &mut ChaCha8Rng) -> Result<()> {
    let before = counts(caller, map).await?;
    let place = format!("maps/{map}/places/{}", random.random_range(0..10));
    let scope = v1::LabelScope::Place;
    caller.ask("labels set", async |client| client.set_label(&place, "dock", scope).await).await?;
    let labels = caller.read("labels listed", async |client| client.labels(map).await).await?;
    ensure!(labels.len() == 1 && labels[0].label == "dock", "the label of {place} is not there: {labels:?}");
    caller.ask("labels deleted", async |client| client.delete_label(&place).await).await?;
    let closures =
        caller.read("loop closures listed", async |client| client.loop_closures(map).await).await?;
    ensure!(!closures.is_empty(), "{map}: a robot that drove around closed no loop");
    let closure = &closures[random.random_range(0..closures.len())];
    let frame = closure.frame.as_ref().context("a loop closure without a frame")?;
    let frame = format!("{}/frames/{}", frame.session, frame.sequence);
    let withdraw = async |client: &Client| client.withdraw_loop_closure(&frame).await;
    let said = match caller.ask("closures withdrawn", withdraw).await? {
        Some(said) => said,
        None => {
            let all = caller.read("corrections listed", async |client| client.corrections(map).await).await?;
            all.into_iter().next_back().context("a correction that was made is not there")?
        }
    };
    let undo = async |client: &Client| client.undo_correction(&said.name).await;
    caller.ask("corrections undone", undo).await?;
    let now = counts(caller, map).await?;
    ensure!(before == now, "{map}: a correction was undone, and {before:?} became {now:?}");
    Ok(())
}

/// Frames, places, links and loop closures.
async fn counts(caller: &Caller, map: &str) -> Result<[u64; 4]> {
    let map = caller.read("maps looked at", async |client| client.map(map, v1::MapView::Full).await).await?;
    Ok([map.frames, map.places, map.links, map.loop_closures])
}

/// Exported, and imported under another name.
async fn copied(caller: &Caller, map: &str) -> Result<()> {
    let export = async |client: &Client| {
        let mut file = Vec::new();
        client.export_map(map, &mut file).await?;
        Ok(file)
    };
    let file = caller.read("maps exported", export).await?;
    let import = async |client: &Client| Ok(client.import_map("copy", Cursor::new(file.clone())).await?.name);
    if caller.job("maps imported", import).await? {
        let [one, other] = [caller.state_hash(map).await?, caller.state_hash("copy").await?];
        ensure!(one == other, "the copy of {map} is another: {one}, and {other}");
    }
    // Cut off, it may be there or not.
    let delete = async |client: &Client| match client.delete_map("copy").await {
        Err(Error::Status { code: Code::NotFound, .. }) => Ok(()),
        other => other,
    };
    caller.ask("maps deleted", delete).await.map(drop)
}

/// Pictures and lists.
async fn looked_at(caller: &Caller, map: &str, random: &mut ChaCha8Rng) -> Result<()> {
    let name = format!("maps/{map}");
    let matrix = async |client: &Client| client.match_matrix(map, None).await;
    let matrix = caller.read("match matrices", matrix).await?;
    let tile =
        v1::GetMatchMatrixTileRequest { map: name.clone(), ..v1::GetMatchMatrixTileRequest::default() };
    let tile = caller.read("tiles", async |client| client.match_matrix_tile(tile.clone()).await).await?;
    ensure!(tile.starts_with(b"\x89PNG") && !matrix.marks.is_empty(), "{map}: a match matrix without marks");
    let frame = format!("{name}/sessions/robot/frames/{}", random.random_range(10..40));
    let picture = async |client: &Client| client.frame_picture(&frame, Some(0)).await;
    caller.read("pictures of frames", picture).await?;
    let explain = async |client: &Client| client.explain_frame(&frame, Some(0), None).await;
    caller.read("frames explained", explain).await?;
    let places = caller.read("places listed", async |client| client.places(map).await).await?;
    ensure!(places.len() as u64 == counts(caller, map).await?[1], "{map}: not all places are listed");
    Ok(())
}

/// The new map into the one before, committed and undone, or discarded; then the other is made smaller.
async fn merged(caller: &Caller, map: &str, other: &str, random: &mut ChaCha8Rng) -> Result<()> {
    let before = counts(caller, other).await?;
    let request = v1::MergeMapsRequest {
        sources: vec![format!("maps/{map}")],
        target: format!("maps/{other}"),
        auto_commit: false,
        min_support: Some(3),
    };
    let lives = caller.stage.lives();
    let begun = caller.ask("merges begun", async |client| client.merge_maps(request.clone()).await).await?;
    let Some(begun) = begun else { return caller.at_rest().await };
    let found = caller.job("merges searched", async |_| Ok(begun.job.clone())).await?;
    let merge = caller.read("merges looked at", async |client| client.merge(&begun.name).await).await?;
    // A proposal is forgotten when the server restarts.
    if !found || lives != caller.stage.lives() {
        caller.stage.count("merges cut off");
        return Ok(());
    }
    ensure!(merge.state() == MergeState::Proposed, "two drives along one way have no overlap: {merge:?}");
    let picture = async |client: &Client| client.merge_picture(&merge.name).await;
    let commit = async |client: &Client| Ok(client.commit_merge(&merge.name).await?.job);
    let committed = async {
        if random.random_range(0..4) == 0 {
            caller.ask("merges discarded", async |client| client.discard_merge(&merge.name).await).await?;
            return Ok(false);
        }
        caller.read("pictures of merges", picture).await?;
        caller.job("merges committed", commit).await
    };
    match committed.await {
        Ok(true) => {
            let undo = async |client: &Client| Ok(client.undo_merge(&merge.name).await?.job);
            if caller.job("merges undone", undo).await? {
                let now = counts(caller, other).await?;
                ensure!(before == now, "{other}: a merge was undone, and {before:?} became {now:?}");
            }
        }
        Ok(false) => {}
        // It restarted before the proposal was decided.
        Err(_) if lives != caller.stage.lives() => caller.stage.count("merges cut off"),
        Err(error) => return Err(error),
    }
    Ok(())
}

/// Who looks after the server: tokens, backups, lists.
pub(super) async fn clerk(caller: &Caller, endpoint: &str, backup: &Backup, home: &str) -> Result<()> {
    let mut random = caller.stage.random(500);
    while let Some(_step) = caller.stage.step().await {
        tokens(caller, endpoint).await?;
        let own = [HOME, WORDS];
        let maps = caller.read("maps listed", async |client| client.maps().await).await?;
        let is_there = |own: &&str| maps.iter().any(|map| map.name == format!("maps/{own}"));
        ensure!(own.iter().all(is_there), "a map is not listed: {maps:?}");
        is_as_it_was(caller, home).await?;
        caller.read("jobs listed", async |client| client.jobs().await).await?;
        caller.read("merges listed", async |client| client.merges().await).await?;
        caller.read("metrics of the hour", async |client| client.metrics_history().await).await?;
        caller.read("streams listed", async |client| client.open_streams(None).await).await?;
        let refusals = caller.read("refusals listed", async |client| client.refusals().await).await?;
        let faults = ["internal", "unknown", "data_loss", "unimplemented"];
        if let Some(fault) = refusals.iter().find(|refusal| faults.contains(&refusal.code.as_str())) {
            bail!("the server failed: {fault:?}");
        }
        if random.random_range(0..4) == 0 {
            backup.made_and_restored().await?;
            caller.stage.count("backups made and restored");
        }
        tokio::time::sleep(std::time::Duration::from_millis(500)).await;
    }
    Ok(())
}

/// A token is made, given another secret, and deleted; what it lets in at each step.
async fn tokens(caller: &Caller, endpoint: &str) -> Result<()> {
    const NAME: &str = "cart";
    let create = async |client: &Client| match client.create_token(NAME, v1::token::Role::Robot).await {
        // Its secret was lost with a connection.
        Err(Error::Status { code: Code::AlreadyExists, .. }) => {
            client.delete_token(NAME).await?;
            client.create_token(NAME, v1::token::Role::Robot).await
        }
        other => other,
    };
    let Some((_, first)) = caller.ask("tokens made", create).await? else { return Ok(()) };
    let rotate = v1::RotateTokenRequest { name: NAME.to_owned(), overlap_s: Some(0), lifetime_s: None };
    let rotate = async |client: &Client| client.rotate_token(rotate.clone()).await;
    let (_, second) = caller.read("tokens rotated", rotate).await?;
    ensure!(!is_let_in(&caller.stage, endpoint, &first).await?, "a secret that was replaced lets in");
    ensure!(is_let_in(&caller.stage, endpoint, &second).await?, "a new secret does not let in");
    caller.ask("tokens deleted", async |client| client.delete_token(NAME).await).await?;
    ensure!(!is_let_in(&caller.stage, endpoint, &second).await?, "a token that was deleted lets in");
    Ok(())
}

async fn is_let_in(stage: &std::sync::Arc<Stage>, endpoint: &str, secret: &str) -> Result<bool> {
    let client = Client::lazy(ClientOptions::new(endpoint).with_token(secret))?;
    let somebody = Caller { client, stage: stage.clone() };
    let asked = async |client: &Client| match client.caller().await {
        Ok(_) => Ok(true),
        Err(Error::Status { code: Code::Unauthenticated, .. }) => Ok(false),
        Err(error) => Err(error),
    };
    somebody.read("callers named", asked).await
}
