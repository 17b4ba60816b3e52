//! What a robot that is led by looks was told, and what it said last.

use std::time::{Duration, Instant};

use waypost_navigation::appearance::navigator::{Body, HeadingSteering};
use waypost_navigation::metric::settings::NavigationSettings;
use waypost_navigation::metric::{Driver, Guidance, Status, VelocityCommand};

use super::journey::Journey;
use crate::service::navigation::{AppearanceView, GoalRefusal, Told};

/// How long a robot is led by one panorama, by its wheels.
const PANORAMA_HOLDS: Duration = Duration::from_secs(1);

#[derive(Debug, Default)]
pub(super) struct State {
    /// Counts goals that were asked for or taken away: the way to an earlier one is found too late.
    pub(super) asked: u64,
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
    pub(super) since: Instant,
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
            (None, _) => Status::Idle,
            (Some(_), None) => Status::Searching,
            (Some(_), Some(Heading { status: Status::Following | Status::Searching, .. }))
                if self.body() == Body::Held =>
            {
                Status::Blocked
            }
            (Some(_), Some(heading)) => heading.status,
        };
        let is_led = heading.is_some_and(|heading| heading.since.elapsed() < PANORAMA_HOLDS);
        let waits = view.is_some_and(|view| view.unjoined.is_some());
        let [forward_m_s, turn_rad_s] = match status {
            Status::Following | Status::Searching | Status::Lost | Status::Blocked if is_led && !waits => {
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
        let guidance =
            Guidance { command, status, localization: None, remaining_m: None, heading_to_target_rad: None };
        let told = Told { stamp_ns, guidance, appearance: view };
        self.told = Some(told);
        told
    }
}

fn wrapped(angle_rad: f64) -> f64 {
    angle_rad.sin().atan2(angle_rad.cos())
}
