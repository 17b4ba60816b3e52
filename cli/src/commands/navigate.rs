//! `waypost navigate`: sends a robot to a goal and follows it.

use std::path::PathBuf;
use std::time::Duration;

use indicatif::ProgressBar;
use waypost_client::v1::{self, NavigationStatus};
use waypost_client::{Client, ClientOptions};

use crate::failure::{EXIT_CODES, Failure};
use crate::output::{Output, rounded, table};
use crate::progress;
use crate::shrinking::fitting;

/// How often the live view polls the server.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// Send a navigating robot to a goal and follow it, or list the navigating robots
///
/// The robot itself must have a navigation stream open: see NavigationService in the contract, or
/// the client library.
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
    /// Label to go to; of several places with it, the middle of the nearest group
    #[arg(long, value_name = "LABEL", requires = "robot", conflicts_with_all = ["to_position", "to_image", "cancel"])]
    to_label: Option<String>,
    /// Panorama of the goal, a JPEG or PNG, on a map that is navigated by appearance
    #[arg(long, value_name = "FILE", requires = "robot", conflicts_with_all = ["to_position", "cancel"])]
    to_image: Option<PathBuf>,
    /// Position on the map in metres; the goal is the place nearest to it
    #[arg(long, value_name = "X,Y", value_parser = position, allow_hyphen_values = true, requires = "robot", conflicts_with = "cancel")]
    to_position: Option<[f64; 2]>,
    /// Heading of the robot there, in radians on the map
    #[arg(long, value_name = "RAD", requires = "to_position", allow_negative_numbers = true)]
    facing: Option<f64>,
    /// Cancel its goal: the robot stops
    #[arg(long, requires = "robot")]
    cancel: bool,
}

fn position(text: &str) -> Result<[f64; 2], String> {
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    let parts = text.split_once(',').and_then(|(x, y)| Some([number(x)?, number(y)?]));
    parts.ok_or_else(|| "write two numbers of metres, as in 3.5,-2".to_owned())
}

pub(crate) async fn run(arguments: Arguments, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let Arguments { map, robot, to, to_label, to_image, to_position, facing, cancel } = arguments;
    let image = to_image.map(|file| std::fs::read(&file).map(fitting).map_err(Failure::file("read", &file)));
    let image = image.transpose()?;
    let client = Client::connect(server).await?;
    let Some(robot) = robot else { return list(&client, &map, output).await };
    let map = map.strip_prefix("maps/").unwrap_or(&map);
    let name = format!("maps/{map}/navigations/{robot}");
    if cancel {
        return show(&client.cancel_goal(&name).await?, output);
    }
    let position = to_position.map(|[x_m, y_m]| v1::PositionGoal {
        part: 0,
        x_m: Some(x_m),
        y_m: Some(y_m),
        heading_rad: facing,
    });
    let target = to
        .map(v1::goal::Target::PlaceNumber)
        .or(position.map(v1::goal::Target::Position))
        .or(to_label.map(v1::goal::Target::Label))
        .or(image.map(v1::goal::Target::Image));
    if let Some(target) = target {
        client.set_goal(&name, v1::Goal { target: Some(target) }).await?;
    }
    show(&watch(&client, &name, output).await?, output)
}

/// Follows the robot until it has arrived or has no goal.
async fn watch(client: &Client, name: &str, output: Output) -> Result<v1::Navigation, Failure> {
    let view = progress::spinner(output, "");
    let mut before = None;
    let mut place_before = None;
    loop {
        let navigation = client.navigation(name).await?;
        if let Some(refusal) = navigation.goal_refusal {
            return Err(Failure::GoalRefused(refusal.status.unwrap_or_default().message));
        }
        let status = status(&navigation);
        view.set_message(live(&navigation));
        if before.replace(status) != Some(status) {
            tell(&view, output, &navigation)?;
        }
        if let Some(place) =
            place_of_position(&navigation).filter(|place| place_before.as_ref() != Some(place))
        {
            view.suspend(|| output.line(&place))?;
            place_before = Some(place);
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

/// Which place stands for a position, and how far that is from it, once a way there is planned.
fn place_of_position(navigation: &v1::Navigation) -> Option<String> {
    let v1::goal::Target::Position(goal) = navigation.goal.as_ref()?.target.as_ref()? else { return None };
    let v1::Waypoint { place_number, pose, reverse: _ } = navigation.route.as_ref()?.waypoints.last()?;
    let at = pose.as_ref()?.position_m?;
    let apart_m = (at.x - goal.x_m?).hypot(at.y - goal.y_m?);
    Some(format!("it goes to place {place_number}, {apart_m:.2} m from the position"))
}

/// Why no way leads to the goal, if that is so: the robot stands until people do something.
fn nowhere_to_go(navigation: &v1::Navigation) -> Option<String> {
    let guidance = navigation.guidance.as_ref()?;
    let by_looks = guidance.appearance.as_ref()?;
    let stands = guidance.status() == NavigationStatus::Blocked && by_looks.subgoal_place_number.is_none();
    stands.then(|| guidance.detail.clone()).flatten()
}

/// Prints a line when the status changes.
fn tell(view: &ProgressBar, output: Output, navigation: &v1::Navigation) -> Result<(), Failure> {
    view.suspend(|| output.line(live(navigation)))
}

fn live(navigation: &v1::Navigation) -> String {
    let mut line = status_name(status(navigation)).to_owned();
    let guidance = navigation.guidance.as_ref();
    if let Some(remaining_m) = guidance.and_then(|guidance| guidance.remaining_m) {
        line += &format!(", {remaining_m:.1} m to go");
    }
    if let Some(at) = guidance.and_then(|guidance| guidance.localization.as_ref()) {
        let position = at.pose.as_ref().and_then(|pose| pose.position_m).unwrap_or_default();
        line += &format!(
            ", at ({}, {}) ± {:.2} m near place {}, recognised {:.1} m ago",
            rounded(position.x, 2),
            rounded(position.y, 2),
            at.position_sigma_m,
            at.place_number,
            at.since_recognition_m
        );
    }
    if let Some(by_looks) = guidance.and_then(|guidance| guidance.appearance.as_ref()) {
        line += &live_by_looks(by_looks);
    }
    if let Some(why) = guidance.and_then(|guidance| guidance.detail.as_ref()) {
        line += &format!(", {why}");
    }
    if !navigation.connected {
        line += ", not connected";
    }
    line
}

fn live_by_looks(guidance: &v1::AppearanceGuidance) -> String {
    let v1::AppearanceGuidance {
        heading_rad,
        subgoal_place_number,
        goal_place_number,
        similarity,
        remaining_cost: _,
    } = guidance;
    let mut line = String::new();
    if let Some(goal) = goal_place_number {
        line += &format!(", to place {goal}");
    }
    if let Some(subgoal) = subgoal_place_number {
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
    let robots = client.navigations(map).await?;
    output.result(&serde_json::json!({ "navigations": robots }), |out| {
        let metres = |value: Option<f64>| value.map_or_else(String::new, |value| rounded(value, 2));
        let rows = robots.iter().map(|robot| {
            let guidance = robot.guidance.as_ref();
            let localization = guidance.and_then(|guidance| guidance.localization.as_ref());
            let position = localization.and_then(|at| at.pose.as_ref()?.position_m);
            [
                robot.name.rsplit('/').next().unwrap_or_default().to_owned(),
                status_name(status(robot)).to_owned(),
                if robot.connected { "yes" } else { "no" }.to_owned(),
                metres(guidance.and_then(|guidance| guidance.remaining_m)),
                metres(position.map(|position| position.x)),
                metres(position.map(|position| position.y)),
                format!("{} of {}", robot.recognitions, robot.frames),
            ]
        });
        table(out, ["ROBOT", "STATUS", "CONNECTED", "REMAINING M", "X M", "Y M", "RECOGNISED"], rows)
    })
}

fn show(navigation: &v1::Navigation, output: Output) -> Result<(), Failure> {
    output.result(navigation, |out| {
        writeln!(out, "{} {}", navigation.name, live(navigation))?;
        writeln!(out, "  {} of {} frames were recognised", navigation.recognitions, navigation.frames)
    })
}

fn status(navigation: &v1::Navigation) -> NavigationStatus {
    navigation.guidance.as_ref().map_or(NavigationStatus::Unspecified, v1::Guidance::status)
}

pub(crate) fn status_name(status: NavigationStatus) -> &'static str {
    match status {
        NavigationStatus::Unspecified => "waiting",
        known => known.json_name(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_says_which_place_stands_for_it() {
        let position = v1::PositionGoal { part: 0, x_m: Some(3.0), y_m: Some(4.0), heading_rad: None };
        let at = v1::Pose { position_m: Some(v1::Vector3 { x: 3.3, y: 4.4, z: 0.0 }), orientation: None };
        let last = v1::Waypoint { place_number: 7, pose: Some(at), reverse: false };
        let led = |target| v1::Navigation {
            goal: Some(v1::Goal { target: Some(target) }),
            route: Some(v1::Route { waypoints: vec![v1::Waypoint::default(), last], ..v1::Route::default() }),
            ..v1::Navigation::default()
        };
        let told = place_of_position(&led(v1::goal::Target::Position(position)));
        assert_eq!(told.as_deref(), Some("it goes to place 7, 0.50 m from the position"));
        assert_eq!(place_of_position(&led(v1::goal::Target::PlaceNumber(7))), None);
    }

    #[test]
    fn a_position_may_begin_with_a_minus() {
        #[derive(clap::Parser)]
        struct Given {
            #[command(flatten)]
            arguments: Arguments,
        }
        let given = ["navigate", "hall", "robot", "--to-position", "-3.5,-2", "--facing", "-1.5"];
        let Given { arguments } = clap::Parser::parse_from(given);
        assert_eq!((arguments.to_position, arguments.facing), (Some([-3.5, -2.0]), Some(-1.5)));
    }

    #[test]
    fn positions_are_two_numbers() {
        assert_eq!(position("3.5, -2"), Ok([3.5, -2.0]));
        for text in ["", "1", "1,2,3", "a,b", "nan,1", "1,inf"] {
            assert!(position(text).unwrap_err().contains("two numbers"), "{text}");
        }
    }
}
