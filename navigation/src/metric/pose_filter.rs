//! Where the robot is: what it recognises corrects where its wheels put it.

use fabmap::appearance::PlaceId;
use nalgebra::{Matrix2, Matrix3, Matrix3x5, Matrix5, Vector2, Vector3, Vector5};

use super::localization::{Closure, Glimpses};
use super::planning::MapPosition;
use super::search::Search;
use super::settings::LocalizationSettings;
use posegraph::{PlanarPose, Pose};

/// Fuses closures and wheels: a Kalman filter over the pose and over what is wrong with the wheels,
/// against the map's.
///
/// What is believed is kept as it was at the last closure, beside the odometry of that moment. So
/// an answer that comes late corrects the moment that it is about, and wheels lead on from there.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PoseFilter {
    fix: Option<Fix>,
    wheels: Wheels,
    unconfirmed: Option<Unconfirmed>,
    search: Search,
}

/// What was believed at a closure.
#[derive(Clone, Debug, PartialEq)]
struct Fix {
    part: PlaceId,
    node: PlaceId,
    probability: f64,
    stamp_ns: i64,
    odometry: PlanarPose,
    pose: PlanarPose,
    /// Of the pose along its own axes, the drift and the scale.
    covariance: Matrix5<f64>,
}

/// What the wheels measure that is not so on the map.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Wheels {
    /// Turn to the left, in rad/m.
    drift_rad_per_m: f64,
    /// Their metres are (1 + scale) of the map's.
    scale: f64,
    covariance: Matrix2<f64>,
}

/// Closures that agree with each other, and with nothing that is believed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Unconfirmed {
    closure: Closure,
    odometry: PlanarPose,
    count: u32,
    /// Those of them that may tell a lost robot where it is.
    telling: u32,
}

/// What came of a closure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// It corrects what is believed.
    Corrected,
    /// It says where a robot is that did not know, or was mistaken.
    Found,
    /// It is not believed, yet.
    Unconfirmed,
    /// One of many that agree with each other and not with what was believed, which is forgotten.
    Kidnapped,
    /// It counts no more: it is older than the last one, or of before the robot was lost.
    Stale,
    /// There was none.
    Nothing,
}

/// Where the robot is at some odometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Estimate {
    pub(super) part: PlaceId,
    pub(super) node: PlaceId,
    pub(super) probability: f64,
    /// Of the last closure, by the robot's clock.
    pub(super) closed_ns: i64,
    pub(super) pose: PlanarPose,
    pub(super) covariance: Matrix3<f64>,
}

impl Estimate {
    /// Standard deviation of the position in the direction in which it is largest, in metres.
    pub(super) fn position_sigma_m(&self) -> f64 {
        let position = self.covariance.fixed_view::<2, 2>(0, 0).into_owned();
        position.symmetric_eigenvalues().max().max(0.0).sqrt()
    }

    pub(super) fn heading_sigma_rad(&self) -> f64 {
        self.covariance[(2, 2)].max(0.0).sqrt()
    }
}

impl PoseFilter {
    /// Of a robot that may be anywhere.
    pub(super) fn new(settings: &LocalizationSettings) -> Self {
        let sigmas = Vector2::new(settings.drift_sigma_rad_per_m, settings.scale_sigma);
        let covariance = Matrix2::from_diagonal(&sigmas.map(|sigma| sigma * sigma));
        let wheels = Wheels { drift_rad_per_m: 0.0, scale: 0.0, covariance };
        Self { fix: None, wheels, unconfirmed: None, search: Search::default() }
    }

    /// The robot may be anywhere; its wheels are still the same.
    pub(super) fn forget(&mut self) {
        if let Some(fix) = self.fix.take() {
            self.wheels.covariance = fix.covariance.fixed_view::<2, 2>(3, 3).into_owned();
        }
        self.unconfirmed = None;
        self.search = Search::default();
    }

    /// Whether the last frame showed clearly where it was taken, and waits for others that agree.
    pub(super) fn is_confirming(&self) -> bool {
        self.search.is_promising()
    }

    /// Where the robot is when its wheels say `odometry`.
    pub(super) fn at(&self, odometry: &PlanarPose, settings: &LocalizationSettings) -> Option<Estimate> {
        let fix = self.fix.as_ref()?;
        let (pose, covariance) = fix.driven(odometry, &self.wheels, settings);
        let covariance = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let Fix { part, node, probability, stamp_ns: closed_ns, .. } = *fix;
        Some(Estimate { part, node, probability, closed_ns, pose, covariance })
    }

    /// Takes in what a frame showed.
    pub(super) fn see(
        &mut self,
        (closure, glimpses): (Option<&Closure>, &Glimpses),
        (stamp_ns, odometry): (i64, &PlanarPose),
        settings: &LocalizationSettings,
    ) -> Seen {
        let Some(fix) = &self.fix else {
            return match self.search.see(odometry, closure, glimpses, settings) {
                Some(found) => {
                    self.forget();
                    self.fix = Some(Fix::of(&found, (stamp_ns, odometry), &self.wheels));
                    Seen::Found
                }
                None if closure.is_some() => Seen::Unconfirmed,
                None => Seen::Nothing,
            };
        };
        let Some(closure) = closure else { return Seen::Nothing };
        if stamp_ns <= fix.stamp_ns {
            return Seen::Stale;
        }
        if let Some(corrected) = fix.corrected(closure, (stamp_ns, odometry), &mut self.wheels, settings) {
            self.fix = Some(corrected);
            self.unconfirmed = None;
            return Seen::Corrected;
        }
        let count = self.confirm(closure, odometry, settings);
        let telling = self.unconfirmed.map_or(0, |unconfirmed| unconfirmed.telling);
        if closure.tells_where(settings) && telling >= settings.confirmations {
            // It has been carried off, and there is no need to look around.
            self.forget();
            self.fix = Some(Fix::of(closure, (stamp_ns, odometry), &self.wheels));
            return Seen::Found;
        }
        if count < settings.contradictions {
            return Seen::Unconfirmed;
        }
        self.forget();
        Seen::Kidnapped
    }

    /// How many closures in a row agree with this one, and itself.
    fn confirm(&mut self, closure: &Closure, odometry: &PlanarPose, settings: &LocalizationSettings) -> u32 {
        let (before, telling_before) = match &self.unconfirmed {
            Some(before) if before.agrees(closure, odometry, settings) => (before.count, before.telling),
            Some(_) | None => (0, 0),
        };
        let count = before + 1;
        let telling = telling_before + u32::from(closure.tells_where(settings));
        self.unconfirmed = Some(Unconfirmed { closure: *closure, odometry: *odometry, count, telling });
        count
    }
}

impl Unconfirmed {
    fn agrees(&self, closure: &Closure, odometry: &PlanarPose, settings: &LocalizationSettings) -> bool {
        let driven = self.odometry.inverse().compose(odometry);
        let expected = self.closure.at.pose.compose(&driven);
        let missed = expected.inverse().compose(&closure.at.pose);
        let slack_m = 2.0 * settings.scale_sigma * way_m(&driven);
        self.closure.at.part == closure.at.part
            && missed.x_m().hypot(missed.y_m()) <= settings.agreement_m + slack_m
            && missed.heading_rad().abs() <= settings.agreement_rad
    }
}

impl Fix {
    fn of(closure: &Closure, (stamp_ns, odometry): (i64, &PlanarPose), wheels: &Wheels) -> Self {
        let mut covariance = Matrix5::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&closure.covariance);
        covariance.fixed_view_mut::<2, 2>(3, 3).copy_from(&wheels.covariance);
        let (MapPosition { part, pose }, node) = (closure.at, closure.place);
        let odometry = *odometry;
        let probability = closure.probability;
        Self { part, node, probability, stamp_ns, odometry, pose, covariance }
    }

    /// Pose and covariance when the wheels say `odometry`.
    fn driven(
        &self,
        odometry: &PlanarPose,
        wheels: &Wheels,
        settings: &LocalizationSettings,
    ) -> (PlanarPose, Matrix5<f64>) {
        let measured = self.odometry.inverse().compose(odometry);
        let way_m = way_m(&measured);
        let half_turn = PlanarPose::new(0.0, 0.0, -wheels.drift_rad_per_m * way_m / 2.0);
        let shrunk = 1.0 - wheels.scale;
        let scaled =
            PlanarPose::new(shrunk * measured.x_m(), shrunk * measured.y_m(), measured.heading_rad());
        let motion = half_turn.compose(&scaled).compose(&half_turn);

        let carried = motion.inverse().adjoint();
        let turned = Vector3::new(0.0, 0.0, -way_m / 2.0);
        let by_drift = carried * turned + turned;
        let ahead = half_turn.compose(&PlanarPose::new(-measured.x_m(), -measured.y_m(), 0.0));
        let by_scale = carried * Vector3::new(ahead.x_m(), ahead.y_m(), 0.0);
        let mut change = Matrix5::identity();
        change.fixed_view_mut::<3, 3>(0, 0).copy_from(&carried);
        change.fixed_view_mut::<3, 1>(0, 3).copy_from(&by_drift);
        change.fixed_view_mut::<3, 1>(0, 4).copy_from(&by_scale);

        let heading = settings.heading_noise.powi(2) * way_m
            + settings.turn_noise.powi(2) * measured.heading_rad().abs();
        let along = settings.way_noise.powi(2) * way_m;
        let across = along + heading * way_m * way_m / 3.0;
        let noise = Matrix5::from_diagonal(&Vector5::new(along, across, heading, 0.0, 0.0));
        (self.pose.compose(&motion), change * self.covariance * change.transpose() + noise)
    }

    /// What is believed after a closure; `None` if it contradicts what was.
    fn corrected(
        &self,
        closure: &Closure,
        (stamp_ns, odometry): (i64, &PlanarPose),
        wheels: &mut Wheels,
        settings: &LocalizationSettings,
    ) -> Option<Self> {
        if closure.at.part != self.part {
            return None;
        }
        let (pose, covariance) = self.driven(odometry, wheels, settings);
        let apart = closure.at.pose.inverse().compose(&pose);
        let missed = Vector3::new(apart.x_m(), apart.y_m(), apart.heading_rad());
        // A step of the pose is along its own axes, what was missed along the closure's.
        let (sin, cos) = apart.heading_rad().sin_cos();
        let mut by_state = Matrix3x5::zeros();
        by_state
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0));
        let innovation = by_state * covariance * by_state.transpose() + closure.covariance;
        let inverse = innovation.try_inverse()?;
        if (missed.transpose() * inverse * missed)[0] > settings.gate_chi_squared {
            return None;
        }
        let gain = covariance * by_state.transpose() * inverse;
        let step = -(gain * missed);
        let left = Matrix5::identity() - gain * by_state;
        let covariance = left * covariance * left.transpose() + gain * closure.covariance * gain.transpose();
        wheels.drift_rad_per_m += step[3];
        wheels.scale += step[4];
        Some(Self {
            part: self.part,
            node: closure.place,
            probability: closure.probability,
            stamp_ns,
            odometry: *odometry,
            pose: pose.retract(&step.fixed_rows::<3>(0).into_owned()),
            covariance: (covariance + covariance.transpose()) * 0.5,
        })
    }
}

/// Metres driven from one pose to another, along an arc.
fn way_m(motion: &PlanarPose) -> f64 {
    let half_rad = motion.heading_rad().abs() / 2.0;
    let longer = if half_rad < 1e-3 { 1.0 } else { half_rad / half_rad.sin() };
    motion.x_m().hypot(motion.y_m()) * longer
}

#[cfg(test)]
mod tests;
