//! A simulated robot maps a building by camera and wheels.

use std::io::{self, Write};

use serde::Serialize;
use waypost_client::launch::ServerProcess;
use waypost_client::{Client, v1};
use waypost_sim::drawing::plan_svg;
use waypost_sim::drive::{Building, SPEED_M_S, WHEN_MOVED};
use waypost_sim::pose::Pose;
use waypost_sim::simulation::Recording;
use waypost_sim::worlds::NamedWorld;

use super::{Demo, Kept};
use crate::failure::Failure;
use crate::output::Output;
use crate::simulated::mapping::{Mapped, SeenAgain, error_m, layers, map_along};
use crate::simulated::{building, new_map, robot, unfit};

const MAP: &str = "building";
const SESSION: &str = "drive";

/// What `--json` prints. Errors are root mean squares over the frames, with the first pose laid to the true one.
#[derive(Serialize)]
struct Report {
    world: String,
    route: &'static str,
    seed: u64,
    driven_m: f64,
    collisions: u64,
    frames: usize,
    wheels_error_m: f64,
    map_error_m: f64,
    map: v1::Map,
    picture: String,
    closures: Vec<SeenAgain>,
}

pub(super) async fn run(
    demo: &Demo,
    world: NamedWorld,
    route: Option<&str>,
    seed: u64,
    output: Output,
) -> Result<(), Failure> {
    let (building, route_name) = building(world, route, seed)?;
    let recording =
        robot(&building, seed, 0, WHEN_MOVED)?.drive_along(&building.route, SPEED_M_S).map_err(unfit)?;
    let (mapped, kept) = demo
        .with_server(output, async |server, _| map(server, demo, &building, &recording, output).await)
        .await?;
    let picture = kept.data_dir.join("building.svg");
    let svg = plan_svg(building.scene.plan(), &layers(&building, &recording, &mapped));
    std::fs::write(&picture, svg).map_err(Failure::file("write", &picture))?;
    let by_wheels: Vec<Pose> = recording.frames().map(|frame| frame.odometry.pose).collect();
    let report = Report {
        world: world.name().to_owned(),
        route: route_name,
        seed,
        driven_m: recording.length_m(),
        collisions: recording.collisions,
        frames: recording.frames().count(),
        wheels_error_m: error_m(&recording, &by_wheels),
        map_error_m: error_m(&recording, &mapped.poses),
        map: mapped.map,
        picture: picture.to_string_lossy().into_owned(),
        closures: mapped.closures,
    };
    output.result(&report, |out| write_report(&report, &kept, out))
}

async fn map(
    server: &ServerProcess,
    demo: &Demo,
    building: &Building,
    recording: &Recording,
    output: Output,
) -> Result<Mapped, Failure> {
    let client = Client::connect(&server.endpoint()).await?;
    let model = demo.model(&client, output).await?;
    client.create_map(new_map(MAP, &model.name)).await?;
    map_along(&client, MAP, SESSION, building, recording, output).await
}

fn write_report(report: &Report, kept: &Kept, out: &mut dyn Write) -> io::Result<()> {
    let Report { driven_m, frames, wheels_error_m, map_error_m, map, picture, closures, collisions, .. } =
        report;
    let farthest_m = closures.iter().map(|closure| closure.apart_m).fold(0.0, f64::max);
    writeln!(out)?;
    writeln!(out, "driven                          {driven_m:8.2} m, {collisions} collisions")?;
    writeln!(out, "frames                          {frames:5}")?;
    writeln!(out, "loop closures                   {:5}, at most {farthest_m:.2} m off", closures.len())?;
    writeln!(out, "places in the map               {:5}", map.places)?;
    writeln!(out, "links in the map                {:5}", map.links)?;
    writeln!(out, "error by wheels alone           {wheels_error_m:8.2} m")?;
    writeln!(out, "error of the map                {map_error_m:8.2} m")?;
    writeln!(out)?;
    writeln!(out, "Truth, wheels and map are drawn in {picture}")?;
    kept.tell(out, MAP)
}
