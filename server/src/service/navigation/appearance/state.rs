//! What a robot that is led by looks was told, and what it said last.

use std::fmt;

use waypost_navigation::appearance::navigator::{Body, HeadingSteering};
use waypost_navigation::metric::settings::NavigationSettings;
use waypost_navigation::metric::{Driver, Guidance, Status, VelocityCommand};

use super::journey::Journey;
use crate::service::navigation::asked::AskedGoals;
use crate::service::navigation::{AppearanceView, GoalRefusal, Told};

/// How long a robot is led by one panorama, by its wheels, in nanoseconds of its own clock.
const PANORAMA_HOLDS_NS: i64 = 1_000_000_000;

#[derive(Debug, Default)]
pub(super) struct State {
    pub(super) goals: AskedGoals,
    pub(super) journey: Option<Journey>,
    pub(super) goal_refusal: Option<GoalRefusal>,
    pub(super) heading: Option<Heading>,
    pub(super) last_report: Option<Report>,
    /// Number of the last command.
    pub(super) commands: u64,
    pub(super) told: Option<Told>,
    pub(super) last_frame: Option<(u64, i64)>,
    pub(super) frames: u64,
    pub(super) closures: u64,
}

/// What the last panorama said.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heading {
    pub(super) status: Status,
    pub(super) view: AppearanceView,
    /// Of the odometry at the panorama.
    pub(super) yaw_rad: Option<f64>,
    /// The robot's latest stamp of when it was found: how long that took does not count.
    pub(super) since_ns: i64,
}

/// Why a robot that is led by looks is not on its way, and what it waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Waiting {
    NoGoal,
    /// Its goal is looked up.
    Goal,
    Reflex,
    /// The last panorama is too old to lead it.
    Panorama,
    OutOfSight,
    NothingKnown,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Report {
    pub(super) stamp_ns: i64,
    pub(super) driver: Driver,
}

impl State {
    pub(super) fn body(&self) -> Body {
        match self.last_report.map(|report| report.driver) {
            Some(Driver::Reflex) => Body::Held,
            Some(Driver::Commands) | None => Body::Free,
        }
    }

    /// The next command; `yaw_rad` is that of the odometry at this moment.
    pub(super) fn tell(&mut self, stamp_ns: i64, yaw_rad: Option<f64>, steering: &HeadingSteering) -> Told {
        self.commands += 1;
        let heading = self.heading.filter(|_| self.journey.is_some());
        let mut view = heading.map(|heading| heading.view);
        if let (Some(view), Some(then), Some(now)) =
            (&mut view, heading.and_then(|heading| heading.yaw_rad), yaw_rad)
        {
            view.heading_rad = view.heading_rad.map(|heading| wrapped(heading - (now - then)));
        }
        let status = match (&self.journey, heading) {
            (None, _) if self.goals.is_looking_up() => Status::Searching,
            (None, _) => Status::Idle,
            (Some(_), None) => Status::Searching,
            (Some(_), Some(Heading { status: Status::Following | Status::Searching, .. }))
                if self.body() == Body::Held =>
            {
                Status::Blocked
            }
            (Some(_), Some(heading)) => heading.status,
        };
        let leading = heading.filter(|heading| heading.leads_at(stamp_ns));
        let waits = view.is_some_and(|view| view.unjoined.is_some());
        let [forward_m_s, turn_rad_s] = match status {
            Status::Following | Status::Searching | Status::Lost | Status::Blocked
                if leading.is_some() && !waits =>
            {
                steering.steer(view.and_then(|view| view.heading_rad))
            }
            Status::Following
            | Status::Searching
            | Status::Lost
            | Status::Blocked
            | Status::Idle
            | Status::Arrived => [0.0; 2],
        };
        let valid_ns = NavigationSettings::default().steering.valid_ns;
        let command = VelocityCommand { number: self.commands, forward_m_s, turn_rad_s, valid_ns };
        let guidance = Guidance {
            command,
            status,
            localization: None,
            remaining_m: None,
            heading_to_target_rad: None,
            reason: None,
        };
        let waiting = self.waiting(status, leading);
        let told = Told { stamp_ns, guidance, appearance: view, waiting };
        self.told = Some(told);
        told
    }
}

impl State {
    /// Why a robot that is led by looks is not on its way.
    fn waiting(&self, status: Status, leading: Option<Heading>) -> Option<Waiting> {
        match status {
            Status::Idle => Some(Waiting::NoGoal),
            Status::Arrived => None,
            Status::Searching if self.journey.is_none() => Some(Waiting::Goal),
            Status::Blocked if self.body() == Body::Held => Some(Waiting::Reflex),
            Status::Following | Status::Searching | Status::Lost | Status::Blocked if leading.is_none() => {
                Some(Waiting::Panorama)
            }
            Status::Following | Status::Blocked => None,
            Status::Searching => Some(Waiting::OutOfSight),
            Status::Lost => Some(Waiting::NothingKnown),
        }
    }
}

impl Heading {
    /// Whether it still leads a robot, by the robot's stamps.
    fn leads_at(&self, stamp_ns: i64) -> bool {
        stamp_ns.saturating_sub(self.since_ns) < PANORAMA_HOLDS_NS
    }
}

impl fmt::Display for Waiting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoGoal => "it has no goal: it stands until it is given one",
            Self::Goal => "it stands while its goal is looked up",
            Self::Reflex => {
                "its own reflex drives, and commands are not obeyed: it goes on when the reports say that the reflex is over"
            }
            Self::Panorama => {
                "no panorama was looked at for a second by its stamps: it stands until the next one; send about four a second"
            }
            Self::OutOfSight => "it does not see its subgoal: it keeps its heading for a few panoramas to find it again",
            Self::NothingKnown => {
                "no place with a way to the goal looks like what it sees: it looks around until one does; bring it to where \
                 the map was driven if it stays so"
            }
        })
    }
}

fn wrapped(angle_rad: f64) -> f64 {
    angle_rad.sin().atan2(angle_rad.cos())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot whose time is slow or fast is led as long by what it saw.
    #[test]
    fn a_panorama_leads_for_a_second_of_the_robots_time() {
        let heading = Heading {
            status: Status::Following,
            view: AppearanceView::default(),
            yaw_rad: None,
            since_ns: 5_000_000_000,
        };
        for (stamp_ns, leads) in [(4_900_000_000, true), (5_999_999_999, true), (6_000_000_000, false)] {
            assert_eq!(heading.leads_at(stamp_ns), leads, "{stamp_ns}");
        }
    }

    #[test]
    fn why_it_stands_is_said() {
        let mut state = State::default();
        let told = state.tell(1, None, &HeadingSteering::default());
        assert_eq!((told.guidance.status, told.waiting), (Status::Idle, Some(Waiting::NoGoal)));
        assert!(told.detail().unwrap().contains("it has no goal"));
        let asked = state.goals.ask_in_time();
        let told = state.tell(2, None, &HeadingSteering::default());
        assert_eq!((told.guidance.status, told.waiting), (Status::Searching, Some(Waiting::Goal)));
        assert_eq!([told.guidance.command.forward_m_s, told.guidance.command.turn_rad_s], [0.0; 2]);
        state.goals.refuse(asked);
        let told = state.tell(3, None, &HeadingSteering::default());
        assert_eq!(told.guidance.status, Status::Idle);
    }
}
