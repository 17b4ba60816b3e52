//! What the bridge tells of itself, once a second.

use std::time::Duration;

use waypost_client::v1;

use crate::plan::Plan;
use crate::settings::{Services, Topics};
use crate::state::{Received, State, Turned};
use waypost_ros_messages::{DiagnosticArray, DiagnosticStatus, Header, KeyValue};

/// A sensor that is silent for longer is missing.
const SENSOR_PATIENCE: Duration = Duration::from_secs(3);
/// A server that leaves frames unanswered for longer is away, or far too slow.
const SERVER_PATIENCE: Duration = Duration::from_secs(3);

/// How well something is, as ROS has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Level {
    Well,
    Warning,
    Error,
}

/// What diagnostics are made of.
pub(crate) struct Report<'a> {
    pub(crate) state: &'a State,
    pub(crate) topics: &'a Topics,
    pub(crate) plan: &'a Plan,
    /// The robot's name; empty for the only one.
    pub(crate) robot: &'a str,
    /// Topics that are published in a way that is not read.
    pub(crate) mismatches: &'a [String],
    /// Frames that wait to be sent.
    pub(crate) waiting: usize,
    /// Frames without an answer.
    pub(crate) unanswered: usize,
}

impl Report<'_> {
    pub(crate) fn message(&self) -> DiagnosticArray {
        let stamp_ns = self.state.robot_now_ns().unwrap_or(0);
        let mut status = vec![self.server(), self.images(), self.camera()];
        if self.topics.odometry.is_some() {
            status.extend([self.odometry(), self.localization()]);
        }
        status.extend(self.state.navigation.as_ref().map(|guidance| self.navigation(guidance)));
        DiagnosticArray { header: Header::new(stamp_ns, ""), status }
    }

    fn status(
        &self,
        name: &str,
        (level, message): (Level, String),
        values: Vec<KeyValue>,
    ) -> DiagnosticStatus {
        let level = match level {
            Level::Well => 0,
            Level::Warning => 1,
            Level::Error => 2,
        };
        let hardware_id = self.robot.to_owned();
        DiagnosticStatus { level, name: format!("waypost: {name}"), message, hardware_id, values }
    }

    fn server(&self) -> DiagnosticStatus {
        let frames = &self.state.frames;
        let silent = frames.last_heard.map(|heard| heard.elapsed());
        let is_late = self.unanswered > 0 && silent.is_none_or(|silent| silent > SERVER_PATIENCE);
        let verdict = match (&self.state.session, &frames.refusal) {
            (None, _) => self.without_session(),
            (Some(_), _) if is_late => (
                Level::Error,
                format!("frames are not answered{}: the server is away, or too slow", for_seconds(silent)),
            ),
            (Some(_), Some(refusal)) if frames.answered == 0 => (Level::Error, refusal.clone()),
            (Some(session), _) => (Level::Well, session.clone()),
        };
        let values = vec![
            value("frames sent", frames.sent),
            value("frames answered", frames.answered),
            value("frames refused", frames.refused),
            value("latest refusal", frames.refusal.as_deref().unwrap_or("none")),
            value("frames dropped", frames.dropped),
            value("frames while no session was wanted", frames.unwanted),
            value("frames waiting", self.waiting),
            value("frames unanswered", self.unanswered),
            value("frames without odometry", frames.without_odometry),
            value("loop closures", frames.closures),
        ];
        self.status("server", verdict, values)
    }

    fn without_session(&self) -> (Level, String) {
        match (&self.plan.map, &self.state.turned) {
            (None, _) => {
                let told = format!("no map is chosen; {}", how_to_choose(&self.topics.services));
                (Level::Warning, told)
            }
            (Some(_), Some(Turned { turn, to: Err(problem) })) if *turn == self.plan.turn => {
                (Level::Error, problem.clone())
            }
            (Some(_), Some(Turned { turn, to: Ok(name) })) if *turn == self.plan.turn => {
                (Level::Well, format!("{name} is finished; {} begins the next", self.topics.services.start))
            }
            (Some(_), _) => (Level::Warning, "no session is open yet".to_owned()),
        }
    }

    fn images(&self) -> DiagnosticStatus {
        let verdict = self.sensor(&self.state.images, &self.topics.image);
        let mut values = counts(&self.state.images);
        values.push(value("left out for the rate", self.state.frames.thinned));
        self.status("images", verdict, values)
    }

    fn odometry(&self) -> DiagnosticStatus {
        let topic = self.topics.odometry.as_deref().unwrap_or_default();
        let verdict = match self.sensor(&self.state.odometry, topic) {
            (Level::Well, _) if self.state.frames.lacks_odometry => {
                let told = format!(
                    "frames go without odometry: {topic} has none within 1 s around the stamps of the images; see that both have \
                     one clock"
                );
                (Level::Warning, told)
            }
            verdict => verdict,
        };
        let mut values = counts(&self.state.odometry);
        if let Some(frames) = &self.state.odometry_frames {
            values.push(value("odometry frame", &frames.odom));
            values.push(value("base frame", &frames.base));
        }
        self.status("odometry", verdict, values)
    }

    /// A sensor by what came of it.
    fn sensor(&self, received: &Received, topic: &str) -> (Level, String) {
        let told = self.mismatches.iter().find(|told| told.starts_with(&format!("{topic} ")));
        match (received.age(), told, &received.problem) {
            (None, Some(told), _) => (Level::Error, told.clone()),
            (None, None, Some(problem)) => (Level::Error, problem.clone()),
            (None, None, None) => (Level::Error, format!("nothing came on {topic}")),
            (Some(age), _, _) if age > SENSOR_PATIENCE => {
                (Level::Error, format!("nothing came on {topic}{}", for_seconds(Some(age))))
            }
            (Some(_), Some(told), _) => (Level::Warning, told.clone()),
            (Some(_), None, Some(problem)) => {
                (Level::Warning, format!("{} messages are left out: {problem}", received.left_out))
            }
            (Some(_), None, None) => (Level::Well, format!("comes on {topic}")),
        }
    }

    fn camera(&self) -> DiagnosticStatus {
        use crate::state::Declared;
        let mismatch = self.mismatches.iter().find(|told| {
            let of = |topic: &str| told.starts_with(&format!("{topic} "));
            self.topics.camera_info.as_deref().is_some_and(of) || of(&self.topics.tf_static)
        });
        let verdict = match (&self.state.declared, &self.state.camera_problem, mismatch) {
            (Declared::Waiting, _, Some(told)) => (Level::Error, told.clone()),
            (Declared::Waiting, Some(problem), None) => (Level::Error, problem.clone()),
            (Declared::Waiting, None, None) => (Level::Warning, "the camera is not known yet".to_owned()),
            (Declared::As(_), Some(problem), _) => (Level::Warning, problem.clone()),
            (Declared::As(Some(_)), None, _) => (Level::Well, "declared".to_owned()),
            (Declared::As(None), None, _) => (Level::Well, "not declared, as asked".to_owned()),
        };
        let mut values = counts(&self.state.camera_infos);
        values.push(value("tf_static messages", self.state.tf_static.count));
        self.status("camera", verdict, values)
    }

    fn localization(&self) -> DiagnosticStatus {
        let Some(placed) = &self.state.placed else {
            let unknown = (Level::Warning, "the map does not have the robot yet".to_owned());
            return self.status("map to odom", unknown, Vec::new());
        };
        let age = placed.at.elapsed();
        let verdict = if age > SERVER_PATIENCE {
            (Level::Warning, format!("the last known, told {:.1} s ago, is published on", age.as_secs_f64()))
        } else {
            (Level::Well, format!("in part {} of the map", placed.part))
        };
        let values =
            vec![value("age s", format!("{:.3}", age.as_secs_f64())), value("part of the map", placed.part)];
        self.status("map to odom", verdict, values)
    }

    fn navigation(&self, guidance: &v1::Guidance) -> DiagnosticStatus {
        use v1::NavigationStatus::{Arrived, Blocked, Following, Idle, Lost, Searching, Unspecified};
        let status = guidance.status();
        let level = match status {
            Idle | Following | Arrived => Level::Well,
            Searching | Lost | Blocked | Unspecified => Level::Warning,
        };
        let verdict = match (&self.state.goal_problem, &guidance.detail) {
            (Some(problem), _) => (Level::Error, problem.clone()),
            (None, Some(detail)) => (level, detail.clone()),
            (None, None) => (level, short(status).to_owned()),
        };
        let mut values = vec![value("status", short(status))];
        values.extend(guidance.remaining_m.map(|metres| value("remaining m", format!("{metres:.2}"))));
        self.status("navigation", verdict, values)
    }
}

/// What a robot does that has no map.
pub(crate) fn how_to_choose(services: &Services) -> String {
    format!("set the parameter `map` by {}", services.set_parameters)
}

/// A status in a word.
fn short(status: v1::NavigationStatus) -> &'static str {
    use v1::NavigationStatus::{Arrived, Blocked, Following, Idle, Lost, Searching, Unspecified};
    match status {
        Unspecified => "unknown",
        Idle => "idle",
        Following => "following",
        Searching => "searching",
        Lost => "lost",
        Arrived => "arrived",
        Blocked => "blocked",
    }
}

fn counts(received: &Received) -> Vec<KeyValue> {
    vec![value("received", received.count), value("left out", received.left_out)]
}

fn value(key: &str, value: impl std::fmt::Display) -> KeyValue {
    KeyValue { key: key.to_owned(), value: value.to_string() }
}

fn for_seconds(time: Option<Duration>) -> String {
    time.map_or_else(String::new, |time| format!(" for {:.1} s", time.as_secs_f64()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    use crate::given::Given;
    use crate::state::Placed;
    use clap::Parser;
    use waypost_ros_messages::Pose;

    fn reported(state: &State, mismatches: &[String], unanswered: usize) -> Vec<(u8, String)> {
        let settings = Given::parse_from(["waypost-ros", "--map", "m"]).settings().unwrap();
        let (topics, plan) = (&settings.topics, &Plan::first(&settings));
        let report = Report { state, topics, plan, robot: "", mismatches, waiting: 0, unanswered };
        report.message().status.into_iter().map(|status| (status.level, status.message)).collect()
    }

    #[test]
    fn what_is_missing_is_an_error_that_names_the_topic() {
        let told = reported(&State::default(), &[], 0);
        assert_eq!(told[1], (2, "nothing came on /camera/image_raw".to_owned()));
        assert_eq!(told[3], (2, "nothing came on /odom".to_owned()));
        let mismatch = "/camera/image_raw is published as std_msgs/String".to_owned();
        assert_eq!(reported(&State::default(), std::slice::from_ref(&mismatch), 0)[1], (2, mismatch));
    }

    #[test]
    fn a_server_that_does_not_answer_is_an_error_with_its_age() {
        let long_ago = Instant::now().checked_sub(Duration::from_secs(9)).unwrap();
        let mut state = State::default();
        state.session = Some("maps/m/sessions/s".to_owned());
        state.frames.last_heard = Some(long_ago);
        let pose = Pose::ORIGIN;
        state.placed = Some(Placed { part: 0, robot: pose, map_to_odom: pose, at: long_ago });
        let told = reported(&state, &[], 1);
        assert!(told[0].0 == 2 && told[0].1.contains("for 9.0 s"), "{told:?}");
        assert!(told[4].0 == 1 && told[4].1.contains("told 9.0 s ago"), "{told:?}");
        // Nothing to answer: the robot has sent nothing.
        assert_eq!(reported(&state, &[], 0)[0].0, 0);
    }
}
