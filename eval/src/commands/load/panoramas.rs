//! Panoramas into maps with and without an appearance graph: what the graph costs those who stream, how long it
//! takes to build all of it, and how long to open a map that has one.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::time::{Duration, Instant};

use anyhow::Result;
use clap::Args;
use rayon::prelude::*;
use serde::Serialize;
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval};
use waypost_client::{Client, FrameContent, FrameInput, FrameOutcome, SessionOptions, v1};
use waypost_sim::scene::Scene;
use waypost_sim::worlds::NamedWorld;

use super::positive;
use super::report::LatencyReport;
use super::server::{ServerOptions, ServerUnderLoad, breach};
use crate::commands::appearance::eye::{Acuity, Eye, scattered, still};

/// Between panoramas of the building, in metres.
const SPACING_M: f64 = 0.4;

/// From question to question for the graph.
const ASKING: Duration = Duration::from_secs(1);

/// Panoramas into maps with and without an appearance graph: answers' latencies, and how long the graph takes to be built
/// again.
#[derive(Args)]
pub(super) struct PanoramasOptions {
    /// Panoramas, taken all over a simulated office, 1024 columns wide.
    #[arg(long, value_name = "N", default_value_t = 600)]
    panoramas: usize,
    /// Panoramas a second.
    #[arg(long, value_name = "HZ", default_value_t = 4.0, value_parser = positive)]
    rate_hz: f64,
    /// Of building and poses.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
}

/// How long a robot waited for its answers.
#[derive(Serialize)]
pub(crate) struct PanoramasReport {
    /// Panoramas that each map was sent.
    pub panoramas: usize,
    pub rate_hz: f64,
    /// From sending to the answer, where the map has no graph.
    pub without_graph: LatencyReport,
    /// The same where a graph grows beside the stream.
    pub with_graph: LatencyReport,
    /// The same where it is asked for every second.
    pub with_graph_asked_for: LatencyReport,
    /// From the last answer until the graph had it all, in seconds.
    pub graph_behind_s: f64,
    /// Its places and links.
    pub places: usize,
    pub links: usize,
    /// Until a restarted server gave the graph, in seconds: the map was opened, and links were kept.
    pub opened_s: f64,
    /// Until it gave it again.
    pub given_again_s: f64,
    /// Until the graph of a copy was given, in seconds: of an imported map no links are kept.
    pub built_s: f64,
}

pub(super) async fn run(server: &ServerOptions, options: &PanoramasOptions) -> Result<PanoramasReport> {
    let PanoramasOptions { panoramas, seed, rate_hz: _ } = options;
    let (images, camera) = images((NamedWorld::Office, *seed), Acuity::Fine, (*panoramas, SPACING_M))?;
    let options_of_server = server;
    let server = ServerUnderLoad::start(server).await?;
    let client = Client::connect(&server.endpoint()).await?;
    let model = client.models().await?.pop().ok_or_else(|| breach("the model is gone"))?.name;
    for (map, strategy) in [
        ("without", v1::map_settings::NavigationStrategy::TopoMetric),
        ("with", v1::map_settings::NavigationStrategy::Appearance),
        ("asked", v1::map_settings::NavigationStrategy::Appearance),
    ] {
        let settings = v1::MapSettings { navigation_strategy: strategy.into(), ..v1::MapSettings::default() };
        let request =
            v1::CreateMapRequest { map_id: map.to_owned(), model: model.clone(), settings: Some(settings) };
        client.create_map(request).await?;
    }
    let drive = |map| stream(&client, map, (&images, &camera), options.rate_hz);
    let without_graph = drive("without").await?;
    let with_graph = drive("with").await?;
    let began = Instant::now();
    let graph = client.appearance_graph("with").await?;
    let graph_behind_s = began.elapsed().as_secs_f64();
    let with_graph_asked_for = tokio::select! {
        latencies = drive("asked") => latencies?,
        error = ask(&client, "asked") => return Err(error),
    };
    drop(client);
    let server = server.restart(options_of_server)?;
    let client = Client::connect(&server.endpoint()).await?;
    let [opened_s, given_again_s] =
        [time(&client, "with", &graph).await?, time(&client, "with", &graph).await?];
    copy(&client, "with", "copy").await?;
    let built_s = time(&client, "copy", &graph).await?;
    server.stop()?;
    Ok(PanoramasReport {
        panoramas: images.len(),
        rate_hz: options.rate_hz,
        without_graph,
        with_graph,
        with_graph_asked_for,
        graph_behind_s,
        places: graph.nodes.len(),
        links: graph.links.len(),
        opened_s,
        given_again_s,
        built_s,
    })
}

/// So many panoramas all over a building, so many metres apart, and the camera that took them.
pub(in crate::commands) fn images(
    (world, seed): (NamedWorld, u64),
    acuity: Acuity,
    (panoramas, spacing_m): (usize, f64),
) -> Result<(Vec<Vec<u8>>, v1::Camera)> {
    let eye = Eye::new(acuity)?;
    let plan = world.plan(seed);
    let poses = scattered(&plan, spacing_m, seed);
    let scene = Scene::new(plan);
    let shots: Vec<_> = (0..).zip(poses).take(panoramas).map(|(number, pose)| still(pose, number)).collect();
    let jpeg = |shot| Ok(scene.render(&eye.rig, shot).to_jpeg()?);
    let images: Result<Vec<Vec<u8>>> = shots.par_iter().map(jpeg).collect();
    let (image_width_px, image_height_px) = acuity.size_px();
    let half = std::f64::consts::PI * f64::from(image_height_px) / f64::from(image_width_px);
    let projection = v1::panorama::Projection::Cylindrical.into();
    let panorama = v1::Panorama { projection, vertical_rad: Some(2.0 * half.atan()) };
    let model = Some(v1::camera::Model::Panorama(panorama));
    Ok((
        images?,
        v1::Camera {
            model,
            image_width_px: Some(image_width_px),
            image_height_px: Some(image_height_px),
            base_to_camera: None,
        },
    ))
}

/// Streams at a rate, and waits for all answers; how long each took.
async fn stream(
    client: &Client,
    map: &str,
    (images, camera): (&[Vec<u8>], &v1::Camera),
    rate_hz: f64,
) -> Result<LatencyReport> {
    let options = SessionOptions { camera: Some(camera.clone()), ..SessionOptions::new(map) };
    let (mut sender, mut outcomes) = client.open_session(options).await?.split();
    let (sent, mut sendings) = mpsc::unbounded_channel();
    let sending = async move {
        let mut pace = interval(Duration::from_secs_f64(1.0 / rate_hz));
        pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
        for (sequence, image) in (1..).zip(images) {
            pace.tick().await;
            // The receiver lives as long as this sender.
            let _ = sent.send((sequence, Instant::now()));
            let stamp_ns = 1_000_000_000 * sequence as i64;
            let content = FrameContent::Image(image.clone());
            sender
                .send(FrameInput { sequence, stamp_ns, content, odometry: None, note: String::new() })
                .await?;
        }
        Ok::<(), anyhow::Error>(())
    };
    let receiving = async move {
        let mut under_way = BTreeMap::new();
        let mut latencies = Vec::new();
        while let Some(outcome) = outcomes.next().await? {
            while let Ok((sequence, at)) = sendings.try_recv() {
                under_way.insert(sequence, at);
            }
            match outcome {
                FrameOutcome::Answer(answer) => {
                    let at: Option<Instant> = under_way.remove(&answer.sequence);
                    latencies.extend(at.map(|at| at.elapsed()));
                }
                FrameOutcome::Refusal(_) => return Err(breach("a panorama was refused")),
            }
        }
        Ok(latencies)
    };
    let (sent, latencies) = tokio::join!(sending, receiving);
    let latencies = latencies?;
    sent?;
    Ok(LatencyReport::of(latencies))
}

/// Asks for the graph for as long as it is answered.
async fn ask(client: &Client, map: &str) -> anyhow::Error {
    let mut asking = interval(ASKING);
    asking.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        asking.tick().await;
        if let Err(error) = client.appearance_graph(map).await {
            return error.into();
        }
    }
}

/// Seconds until the graph of a map is given, which is one that was given before.
async fn time(client: &Client, map: &str, before: &v1::AppearanceGraph) -> Result<f64> {
    let began = Instant::now();
    let graph = client.appearance_graph(map).await?;
    let seconds = began.elapsed().as_secs_f64();
    if (&graph.nodes, &graph.links) == (&before.nodes, &before.links) {
        Ok(seconds)
    } else {
        Err(breach("the graph is another one when it is given again"))
    }
}

/// Copies a map by a snapshot.
async fn copy(client: &Client, map: &str, to: &str) -> Result<()> {
    let mut file = Vec::new();
    client.export_map(map, &mut file).await?;
    let mut job = client.import_map(to, Cursor::new(file)).await?;
    let mut progress = client.watch_job(&job.name).await?;
    while let Some(now) = progress.next().await? {
        job = now;
    }
    if job.state() == v1::job::State::Succeeded {
        Ok(())
    } else {
        Err(breach("a map that was exported could not be imported"))
    }
}
