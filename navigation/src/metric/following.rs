//! Whether a robot does what it is told to, and what it does if it does not. Time is the robot's.

use std::collections::VecDeque;

use posegraph::{PlanarPose, Pose};

use super::guidance::Obstacle;
use super::localization::{Closure, Look, Sight};
use super::planning::MapPosition;
use super::settings::{LocalizationSettings, SupervisionSettings};

/// Whether the robot moves when it is told to all along.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct MotionWatch {
    ahead: Told,
    turning: Told,
    /// When it was last judged, and at which odometry: after a pause in which commands lapsed it starts again.
    judged: Option<(i64, PlanarPose)>,
    /// Sum of all turns of the wheels, in radians.
    turned_rad: f64,
    recovery: Option<Recovery>,
    /// Where it came from, by its wheels, oldest first.
    trail: VecDeque<PlanarPose>,
    /// How often in a row it was held, and where first.
    tries: u32,
    held_at: Option<PlanarPose>,
}

/// What it has been told to do without a break, along one axis.
#[derive(Clone, Debug, Default, PartialEq)]
struct Told {
    samples: VecDeque<Sample>,
    /// In metres or radians, with the sign.
    total: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Sample {
    stamp_ns: i64,
    total: f64,
    done: Done,
}

/// What the wheels have done until then.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Done {
    odometry: PlanarPose,
    /// Sum of all turns, in radians: more than a circle is possible.
    turned_rad: f64,
}

/// A robot that was held waits, and then goes back a little the way that it came.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Recovery {
    obstacle: Obstacle,
    wait_until_ns: i64,
    /// Where it goes back to then, by its wheels, and how long at most.
    back_to: Option<PlanarPose>,
    back_until_ns: i64,
}

/// What a robot may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Motion {
    /// What it was to do.
    Free,
    /// Nothing for a while.
    Waiting(Obstacle),
    /// It goes back to there, by its wheels.
    BackingOff(Obstacle, PlanarPose),
}

/// Wheels that do less than this share of what they are told to do not follow.
const FOLLOWED_SHARE: f64 = 0.2;

/// Less than this that it was told to do says nothing, in metres and radians.
const LEAST_AHEAD_M: f64 = 0.05;
const LEAST_TURN_RAD: f64 = 0.1;

/// A slow robot is watched for so many times as long, at most.
const LONGEST_WATCH: i64 = 10;

/// Of the trail, in metres.
const TRAIL_STEP_M: f64 = 0.05;

/// How long it backs off at most.
const BACKING_NS: i64 = 6_000_000_000;

/// Waiting times double with each time that it is held at one spot, so often at most.
const MOST_DOUBLINGS: u32 = 4;

/// It is another spot so far away, in metres.
const ELSEWHERE_M: f64 = 1.0;

impl Told {
    fn forget(&mut self) {
        *self = Self::default();
    }

    /// It has been told to do `amount` more until now. Then how much that makes, and from where on, once that says
    /// something.
    fn add(
        &mut self,
        amount: f64,
        (stamp_ns, done): (i64, Done),
        least: f64,
        watched_ns: i64,
    ) -> Option<(f64, Done)> {
        if self.total * amount < 0.0 {
            self.forget();
        }
        self.total += amount;
        let total = self.total;
        let age_ns = |sample: &Sample| stamp_ns.saturating_sub(sample.stamp_ns);
        while let Some(next) = self.samples.get(1) {
            let enough = age_ns(next) >= watched_ns && (total - next.total).abs() >= least;
            if !enough && age_ns(next) < LONGEST_WATCH * watched_ns {
                break;
            }
            self.samples.pop_front();
        }
        self.samples.push_back(Sample { stamp_ns, total, done });
        let first = self.samples.front()?;
        let told = total - first.total;
        (age_ns(first) >= watched_ns && told.abs() >= least).then_some((told, first.done))
    }
}

impl MotionWatch {
    /// `obeyed` is what the robot was doing by command since the report before, `wanted` what it would be told next.
    pub(super) fn judge(
        &mut self,
        (obeyed, wanted): ([f64; 2], [f64; 2]),
        (stamp_ns, odometry): (i64, &PlanarPose),
        settings: &SupervisionSettings,
        pause_ns: i64,
    ) -> Motion {
        let (before_ns, before) = self.judged.replace((stamp_ns, *odometry)).unwrap_or((stamp_ns, *odometry));
        let elapsed_ns = stamp_ns.saturating_sub(before_ns);
        self.turned_rad += before.inverse().compose(odometry).heading_rad();
        let done = Done { odometry: *odometry, turned_rad: self.turned_rad };
        self.follow_trail(odometry, settings.back_off_m);
        if !is_motion(wanted) || elapsed_ns > pause_ns {
            self.forget_told();
            self.recovery = None;
            return Motion::Free;
        }
        if let Some(motion) = self.recovering(stamp_ns, odometry) {
            let backing = matches!(motion, Motion::BackingOff(..));
            if backing && self.is_held(obeyed, (stamp_ns, done), elapsed_ns, settings.blocked_ns) {
                // Something is behind it as well.
                self.recovery = None;
                self.forget_told();
            } else {
                return motion;
            }
        }
        if !self.is_held(obeyed, (stamp_ns, done), elapsed_ns, settings.blocked_ns) {
            return Motion::Free;
        }
        self.hold(Obstacle::WheelsStand, (stamp_ns, odometry), settings);
        Motion::Waiting(Obstacle::WheelsStand)
    }

    /// Something holds it from now on.
    pub(super) fn hold(
        &mut self,
        obstacle: Obstacle,
        (stamp_ns, odometry): (i64, &PlanarPose),
        settings: &SupervisionSettings,
    ) {
        let same = self.held_at.is_some_and(|held_at| apart_m(&held_at, odometry) < ELSEWHERE_M);
        self.tries = if same { (self.tries + 1).min(MOST_DOUBLINGS) } else { 0 };
        if !same {
            self.held_at = Some(*odometry);
        }
        let wait_ns = settings.blocked_wait_ns.saturating_mul(1 << self.tries);
        let wait_until_ns = stamp_ns.saturating_add(wait_ns);
        let far = |point: &&PlanarPose| apart_m(point, odometry) >= settings.back_off_m;
        let back_to = self.trail.iter().rev().find(far).or(self.trail.front()).copied();
        let back_until_ns = wait_until_ns.saturating_add(BACKING_NS);
        self.recovery = Some(Recovery { obstacle, wait_until_ns, back_to, back_until_ns });
        self.forget_told();
    }

    /// Whether something held it just now, and it waits or goes back.
    pub(super) fn is_recovering(&self) -> bool {
        self.recovery.is_some()
    }

    /// Where it goes back to is reached.
    pub(super) fn is_back(&mut self) {
        self.recovery = None;
        self.forget_told();
    }

    fn recovering(&mut self, stamp_ns: i64, odometry: &PlanarPose) -> Option<Motion> {
        let Recovery { obstacle, wait_until_ns, back_to, back_until_ns } = self.recovery?;
        if stamp_ns < wait_until_ns {
            self.forget_told();
            return Some(Motion::Waiting(obstacle));
        }
        match back_to {
            Some(back_to) if stamp_ns < back_until_ns && apart_m(&back_to, odometry) > TRAIL_STEP_M => {
                Some(Motion::BackingOff(obstacle, back_to))
            }
            Some(_) | None => {
                self.is_back();
                None
            }
        }
    }

    fn is_held(
        &mut self,
        [forward_m_s, turn_rad_s]: [f64; 2],
        now: (i64, Done),
        elapsed_ns: i64,
        watched_ns: i64,
    ) -> bool {
        let seconds = elapsed_ns as f64 * 1e-9;
        let (_, done) = now;
        if is_ahead(forward_m_s) {
            self.turning.forget();
            let told = self.ahead.add(forward_m_s * seconds, now, LEAST_AHEAD_M, watched_ns);
            return told.is_some_and(|(told_m, then)| {
                apart_m(&then.odometry, &done.odometry) < FOLLOWED_SHARE * told_m.abs()
            });
        }
        self.ahead.forget();
        if !is_turn(turn_rad_s) {
            self.turning.forget();
            return false;
        }
        let told = self.turning.add(turn_rad_s * seconds, now, LEAST_TURN_RAD, watched_ns);
        told.is_some_and(|(told_rad, then)| {
            (done.turned_rad - then.turned_rad) * told_rad.signum() < FOLLOWED_SHARE * told_rad.abs()
        })
    }

    fn follow_trail(&mut self, odometry: &PlanarPose, back_off_m: f64) {
        if self.trail.back().is_some_and(|last| apart_m(last, odometry) < TRAIL_STEP_M) {
            return;
        }
        // Going back, it takes in what it laid out.
        let near = |point: &PlanarPose| apart_m(point, odometry) < TRAIL_STEP_M;
        if let Some(known) = self.trail.iter().position(near) {
            self.trail.truncate(known + 1);
            return;
        }
        self.trail.push_back(*odometry);
        let longest = (2.0 * back_off_m / TRAIL_STEP_M) as usize + 2;
        while self.trail.len() > longest {
            self.trail.pop_front();
        }
    }

    fn forget_told(&mut self) {
        self.ahead.forget();
        self.turning.forget();
    }
}

fn is_ahead(forward_m_s: f64) -> bool {
    forward_m_s.abs() > 1e-3
}

fn is_turn(turn_rad_s: f64) -> bool {
    turn_rad_s.abs() > 1e-2
}

/// Whether that is more than standing.
pub(super) fn is_motion([forward_m_s, turn_rad_s]: [f64; 2]) -> bool {
    is_ahead(forward_m_s) || is_turn(turn_rad_s)
}

fn along_m(closure: &Closure) -> f64 {
    closure.covariance[(0, 0)].max(0.0).sqrt()
}

fn apart_m(from: &PlanarPose, to: &PlanarPose) -> f64 {
    (to.x_m() - from.x_m()).hypot(to.y_m() - from.y_m())
}

/// Whether what is recognised goes by as the wheels say: wheels that slip turn, and what is before the camera stays.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct SlipWatch {
    /// Oldest first.
    seen: VecDeque<SeenAt>,
}

/// Where a closure put the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
struct SeenAt {
    odometry: PlanarPose,
    at: MapPosition,
    /// Standard deviation along the way that it looks, in metres.
    along_m: f64,
}

/// Closures that it takes to say so.
const SLIP_CLOSURES: usize = 4;
/// How far wheels turn for that, in standard deviations of the closures: of a view that structure has not measured only
/// its size tells, and a far wall grows little.
const SLIP_SIGMAS: f64 = 10.0;
/// At least and at most, in metres.
const SLIP_M: [f64; 2] = [0.8, 1.6];
/// A robot that has come no further than this share of that slips.
const SLIP_SHARE: f64 = 0.25;
/// Share of the closures that has to say so: one may be wrong.
const SLIP_AGREEING: f64 = 0.75;

impl SlipWatch {
    pub(super) fn forget(&mut self) {
        self.seen.clear();
    }

    /// Of what a frame shows, where it puts the robot whatever the wheels say: what structure has measured, or else what was
    /// recognised, or else what looks like one place by itself. Once wheels have slipped by more than places are apart,
    /// what is before the camera is no longer taken for the place that it is, since wheels speak against it; that it stays
    /// in view is what tells.
    pub(super) fn sighting<'a>(look: &'a Look, settings: &LocalizationSettings) -> Option<&'a Closure> {
        let closure = match &look.sight {
            Sight::Closure(closure) => Some(closure),
            Sight::Unknown | Sight::TooLittle => None,
        };
        let is_measured = |seen: &&Closure| along_m(seen) <= SLIP_M[0] / SLIP_SIGMAS;
        let telling = || look.glimpses.iter().flatten().filter(|seen| seen.tells_where(settings));
        let by_evidence = |one: &&Closure, other: &&Closure| {
            one.evidence.unwrap_or(0.0).total_cmp(&other.evidence.unwrap_or(0.0))
        };
        let measured = || telling().filter(is_measured).max_by(by_evidence);
        let likely = || telling().max_by(by_evidence);
        closure.filter(is_measured).or_else(measured).or(closure).or_else(likely)
    }

    /// A sighting says where the robot was at `odometry`; whether its wheels have slipped.
    pub(super) fn slips(&mut self, odometry: &PlanarPose, closure: &Closure) -> bool {
        self.seen.push_back(SeenAt { odometry: *odometry, at: closure.at, along_m: along_m(closure) });
        let unsure_m = self.seen.iter().map(|seen| seen.along_m).fold(0.0, f64::max);
        let [least_m, most_m] = SLIP_M;
        let wanted_m = (SLIP_SIGMAS * unsure_m).clamp(least_m, most_m);
        let turned_m = |then: &SeenAt| apart_m(&then.odometry, odometry);
        while self.seen.get(1).is_some_and(|then| turned_m(then) >= wanted_m) {
            self.seen.pop_front();
        }
        let Some(first) = self.seen.front() else { return false };
        let turned_m = turned_m(first);
        let stays = |seen: &SeenAt| {
            first.at.part == seen.at.part && apart_m(&first.at.pose, &seen.at.pose) < SLIP_SHARE * turned_m
        };
        let count = self.seen.len();
        let agreeing = self.seen.iter().filter(|seen| stays(seen)).count();
        count >= SLIP_CLOSURES
            && turned_m >= wanted_m
            && agreeing as f64 >= SLIP_AGREEING * count as f64
            && self.seen.back().is_some_and(stays)
    }
}
