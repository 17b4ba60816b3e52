//! `waypost navigate`: send a robot somewhere, and watch it go.

use std::path::PathBuf;
use std::time::Duration;

use indicatif::ProgressBar;
use serde::Serialize;
use waypost_client::v1::{self, NavigationStatus};
use waypost_client::{Client, ClientOptions};

use crate::failure::{EXIT_CODES, Failure};
use crate::output::{Output, table};
use crate::progress;

/// How often the live view asks.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// Send a robot that is being led to a place, and watch it go; or list who is being led
///
/// The robot itself keeps the stream that it is led by: see NavigationService in the contract, or the client library.
#[derive(clap::Args)]
#[command(after_help = EXIT_CODES)]
pub(crate) struct Arguments {
    /// Name of the map
    map: String,
    /// Name of the robot; without it, the robots are listed
    robot: Option<String>,
    /// Place to go to
    #[arg(long, value_name = "PLACE", requires = "robot", conflicts_with_all = ["to_position", "to_label", "to_image", "cancel"])]
    to: Option<u32>,
    /// Label of the place to go to; of several, as of a room, the middle of the nearest ones
    #[arg(long, value_name = "LABEL", requires = "robot", conflicts_with_all = ["to_position", "to_image", "cancel"])]
    to_label: Option<String>,
    /// Panorama of where to go, a JPEG or PNG; the map must be navigated by appearance
    #[arg(long, value_name = "FILE", requires = "robot", conflicts_with_all = ["to_position", "cancel"])]
    to_image: Option<PathBuf>,
    /// Position to go to, in metres on the map: the place nearest to it
    #[arg(long, value_name = "X,Y", value_parser = position, requires = "robot", conflicts_with = "cancel")]
    to_position: Option<[f64; 2]>,
    /// Where to the robot is to look there, in radians on the map
    #[arg(long, value_name = "RAD", requires = "to_position", allow_negative_numbers = true)]
    facing: Option<f64>,
    /// Take its goal away: it stops
    #[arg(long, requires = "robot")]
    cancel: bool,
}

fn position(text: &str) -> Result<[f64; 2], String> {
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    let parts = text.split_once(',').and_then(|(x, y)| Some([number(x)?, number(y)?]));
    parts.ok_or_else(|| "write two numbers of metres, as in 3.5,-2".to_owned())
}

/// A robot as `--json` has it.
#[derive(Serialize)]
struct Led {
    name: String,
    connected: bool,
    status: &'static str,
    goal_place: Option<u32>,
    goal_label: Option<String>,
    subgoal_place: Option<u32>,
    heading_rad: Option<f64>,
    similarity: Option<f64>,
    left_m: Option<f64>,
    detail: String,
    place: Option<u32>,
    x_m: Option<f64>,
    y_m: Option<f64>,
    position_sigma_m: Option<f64>,
    confidence: Option<f64>,
    since_closure_m: Option<f64>,
    frames: u64,
    closures: u64,
    goal_refusal: String,
}

pub(crate) async fn run(arguments: Arguments, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let Arguments { map, robot, to, to_label, to_image, to_position, facing, cancel } = arguments;
    let client = Client::connect(server).await?;
    let Some(robot) = robot else { return list(&client, &map, output).await };
    let map = map.strip_prefix("maps/").unwrap_or(&map);
    let name = format!("maps/{map}/navigations/{robot}");
    if cancel {
        return show(&client.cancel_goal(&name).await?, output);
    }
    if let Some(file) = to_image {
        let image = std::fs::read(&file).map_err(Failure::file("read", &file))?;
        client.set_image_goal(&name, image).await?;
    }
    let position = to_position.map(|[x_m, y_m]| v1::PositionGoal { part: 0, x_m, y_m, heading_rad: facing });
    let target = to
        .map(v1::goal::Target::Place)
        .or(position.map(v1::goal::Target::Position))
        .or(to_label.map(v1::goal::Target::Label));
    if let Some(target) = target {
        client.set_goal(&name, v1::Goal { target: Some(target) }).await?;
    }
    show(&watch(&client, &name, output).await?, output)
}

/// Follows the robot until it has arrived, or has nowhere to go.
async fn watch(client: &Client, name: &str, output: Output) -> Result<v1::Navigation, Failure> {
    let view = progress::spinner(output, "");
    let mut before = None;
    loop {
        let navigation = client.navigation(name).await?;
        if !navigation.goal_refusal.is_empty() {
            return Err(Failure::Unfit(navigation.goal_refusal));
        }
        let status = status(&navigation);
        view.set_message(live(&navigation));
        if before.replace(status) != Some(status) {
            tell(&view, output, &navigation)?;
        }
        if let Some(why) = nowhere_to_go(&navigation) {
            return Err(Failure::Unfit(why));
        }
        if status == NavigationStatus::Arrived || navigation.goal.is_none() {
            view.finish_and_clear();
            return Ok(navigation);
        }
        tokio::time::sleep(POLL_INTERVAL).await;
    }
}

/// Why the robot will not move, whatever it sees.
fn nowhere_to_go(navigation: &v1::Navigation) -> Option<String> {
    let guidance =
        navigation.guidance.as_ref().filter(|guidance| guidance.status() == NavigationStatus::Blocked)?;
    (!guidance.detail.is_empty()).then(|| guidance.detail.clone())
}

/// A line for each change, which stays.
fn tell(view: &ProgressBar, output: Output, navigation: &v1::Navigation) -> Result<(), Failure> {
    view.suspend(|| output.line(live(navigation)))
}

fn live(navigation: &v1::Navigation) -> String {
    let mut line = status_name(status(navigation)).to_owned();
    let guidance = navigation.guidance.as_ref();
    if let Some(left_m) = guidance.and_then(|guidance| guidance.left_m) {
        line += &format!(", {left_m:.1} m to go");
    }
    if let Some(at) = guidance.and_then(|guidance| guidance.localization.as_ref()) {
        let position = at.pose.as_ref().and_then(|pose| pose.position_m).unwrap_or_default();
        line += &format!(
            ", at ({:.2}, {:.2}) ± {:.2} m near place {}, recognised {:.1} m ago",
            position.x, position.y, at.position_sigma_m, at.place, at.since_closure_m
        );
    }
    if let Some(by_looks) = guidance.and_then(|guidance| guidance.appearance.as_ref()) {
        line += &live_by_looks(by_looks);
    }
    if let Some(why) = nowhere_to_go(navigation) {
        line += &format!(", {why}");
    }
    if !navigation.connected {
        line += ", not connected";
    }
    line
}

fn live_by_looks(guidance: &v1::AppearanceGuidance) -> String {
    let v1::AppearanceGuidance { heading_rad, subgoal_place, goal_place, similarity, left: _ } = guidance;
    let mut line = String::new();
    if let Some(goal) = goal_place {
        line += &format!(", to place {goal}");
    }
    if let Some(subgoal) = subgoal_place {
        line += &format!(" by place {subgoal}");
    }
    if let Some(similarity) = similarity {
        line += &format!(" ({:.0} % alike)", similarity * 100.0);
    }
    if let Some(heading_rad) = heading_rad {
        line += &format!(", heading {:.0}°", heading_rad.to_degrees());
    }
    line
}

async fn list(client: &Client, map: &str, output: Output) -> Result<(), Failure> {
    let robots: Vec<Led> = client.navigations(map).await?.iter().map(Led::from).collect();
    output.result(&serde_json::json!({ "navigations": robots }), |out| {
        let metres = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.2}"));
        let rows = robots.iter().map(|led| {
            [
                led.name.rsplit('/').next().unwrap_or_default().to_owned(),
                led.status.to_owned(),
                if led.connected { "yes" } else { "no" }.to_owned(),
                metres(led.left_m),
                metres(led.x_m),
                metres(led.y_m),
                format!("{} of {}", led.closures, led.frames),
            ]
        });
        table(out, ["ROBOT", "STATUS", "CONNECTED", "LEFT M", "X M", "Y M", "RECOGNISED"], rows)
    })
}

fn show(navigation: &v1::Navigation, output: Output) -> Result<(), Failure> {
    let led = Led::from(navigation);
    output.result(&led, |out| {
        writeln!(out, "{} {}", led.name, live(navigation))?;
        writeln!(out, "  {} of {} frames were recognised", led.closures, led.frames)
    })
}

impl From<&v1::Navigation> for Led {
    fn from(navigation: &v1::Navigation) -> Self {
        let v1::Navigation { name, connected, guidance, goal, route, goal_refusal, frames, closures } =
            navigation;
        let localization = guidance.as_ref().and_then(|guidance| guidance.localization.as_ref());
        let position = localization.and_then(|at| at.pose.as_ref()?.position_m);
        let asked = goal.as_ref().and_then(|goal| match &goal.target {
            Some(v1::goal::Target::Place(place)) => Some(*place),
            Some(v1::goal::Target::Position(_) | v1::goal::Target::Label(_)) | None => None,
        });
        let goal_label = goal.as_ref().and_then(|goal| match &goal.target {
            Some(v1::goal::Target::Label(label)) => Some(label.clone()),
            Some(v1::goal::Target::Place(_) | v1::goal::Target::Position(_)) | None => None,
        });
        let by_looks = guidance.as_ref().and_then(|guidance| guidance.appearance.as_ref());
        let reached = route.as_ref().and_then(|route| route.waypoints.last()).map(|last| last.place);
        Self {
            name: name.clone(),
            connected: *connected,
            status: status_name(status(navigation)),
            goal_place: asked.or(reached).or(by_looks.and_then(|looks| looks.goal_place)),
            goal_label,
            subgoal_place: by_looks.and_then(|looks| looks.subgoal_place),
            heading_rad: by_looks.and_then(|looks| looks.heading_rad),
            similarity: by_looks.and_then(|looks| looks.similarity),
            left_m: guidance.as_ref().and_then(|guidance| guidance.left_m),
            detail: guidance.as_ref().map_or_else(String::new, |guidance| guidance.detail.clone()),
            place: localization.map(|at| at.place),
            x_m: position.map(|position| position.x),
            y_m: position.map(|position| position.y),
            position_sigma_m: localization.map(|at| at.position_sigma_m),
            confidence: localization.map(|at| at.confidence),
            since_closure_m: localization.map(|at| at.since_closure_m),
            frames: *frames,
            closures: *closures,
            goal_refusal: goal_refusal.clone(),
        }
    }
}

fn status(navigation: &v1::Navigation) -> NavigationStatus {
    navigation.guidance.as_ref().map_or(NavigationStatus::Unspecified, v1::Guidance::status)
}

pub(crate) fn status_name(status: NavigationStatus) -> &'static str {
    match status {
        NavigationStatus::Unspecified => "waiting",
        NavigationStatus::Idle => "idle",
        NavigationStatus::Following => "following",
        NavigationStatus::Searching => "searching",
        NavigationStatus::Lost => "lost",
        NavigationStatus::Arrived => "arrived",
        NavigationStatus::Blocked => "blocked",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_two_numbers() {
        assert_eq!(position("3.5, -2"), Ok([3.5, -2.0]));
        for text in ["", "1", "1,2,3", "a,b", "nan,1", "1,inf"] {
            assert!(position(text).unwrap_err().contains("two numbers"), "{text}");
        }
    }
}
