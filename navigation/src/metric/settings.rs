//! All numbers of navigation, in one place.

mod ranges;

/// How a robot is led along a map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NavigationSettings {
    /// Where the robot is.
    pub localization: LocalizationSettings,
    /// Which way it takes.
    pub planning: PlanningSettings,
    /// What it steers at.
    pub path: PathSettings,
    /// How it steers.
    pub steering: SteeringSettings,
    /// When it is lost, blocked or there.
    pub supervision: SupervisionSettings,
}

/// How closures and wheels make one position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalizationSettings {
    /// Standard deviation of a place's position against those about it, in metres, above 0: no closure knows better.
    pub map_m: f64,
    /// The same of its heading, in radians, above 0.
    pub map_rad: f64,
    /// Standard deviation of the position along the way that the robot looks, in metres, above 0. This and the next four
    /// are of closures that structure has not measured.
    pub closure_along_m: f64,
    /// How far away is what a camera sees, as a rule, in metres: a view that is larger by ln s was
    /// taken so many times further back. 0 takes the robot to be where the view was taken.
    pub depth_m: f64,
    /// What that adds to the position's standard deviation for each |ln s|, in metres.
    pub along_m_per_ln_scale: f64,
    /// Standard deviation of the position across that, in metres, above 0. It is held to be small, because what is
    /// really an offset shows as a heading that leads back.
    pub closure_across_m: f64,
    /// Standard deviation of the heading, in radians, above 0.
    pub closure_heading_rad: f64,
    /// Standard deviation of the turn that the wheels see, and those that made the map did not, in rad/m; it is learnt.
    pub drift_sigma_rad_per_m: f64,
    /// Standard deviation of the ratio of the wheels' metres to the map's; it is learnt.
    pub scale_sigma: f64,
    /// Standard deviation of the way, in m/√m.
    pub way_noise: f64,
    /// Standard deviation of the heading on the way, in rad/√m.
    pub heading_noise: f64,
    /// Standard deviation of the heading in turns, in rad/√rad.
    pub turn_noise: f64,
    /// Squared deviations, of three numbers, from which a closure contradicts what is believed.
    pub gate_chi_squared: f64,
    /// Contradictions in a row, each in agreement with the one before, that make what is believed wrong; at least 1.
    pub contradictions: u32,
    /// Least evidence of a closure, of its two views alone, in inliers: what the frames before say is no closure.
    pub least_evidence: f64,
    /// Closures in agreement that a robot needs which does not know where it is; at least 1.
    pub confirmations: u32,
    /// Largest standard deviation along the way of a closure that tells a robot where it is which
    /// does not know, in metres: no view from afar.
    pub found_along_m: f64,
    /// Least evidence of such a closure, of its two views alone, in inliers.
    pub found_evidence: f64,
    /// Largest turn from the earlier view to such a closure, in radians.
    pub found_turn_rad: f64,
    /// Least evidence of all that a robot saw while it looked all around for where that puts it, in
    /// inliers: of each heading, in steps of 10 degrees, the most that its views alone have.
    pub search_evidence: f64,
    /// Most that may speak for anywhere else, as a share of that.
    pub search_rival: f64,
    /// How far two closures in agreement may disagree, in metres.
    pub agreement_m: f64,
    /// The same of headings, in radians.
    pub agreement_rad: f64,
}

/// Which way a robot takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanningSettings {
    /// Links the other way round.
    pub against: AgainstTheWay,
    /// What a turn of one radian costs, in metres.
    pub turn_m_per_rad: f64,
    /// How far from the map a robot, or a goal, may be, in metres.
    pub reach_m: f64,
}

/// What a link that was driven one way is worth the other way: the camera looks elsewhere then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AgainstTheWay {
    /// It is not taken.
    Forbidden,
    /// Its length counts so many times, at least once.
    Costs {
        /// How many times.
        factor: f64,
    },
}

/// What a robot steers at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSettings {
    /// From point to point, in metres.
    pub spacing_m: f64,
    /// How far ahead of the nearest point of the global path the local path meets it, in metres.
    pub rejoin_m: f64,
    /// The target is the first point further away than this, in metres.
    pub target_m: f64,
    /// How far along the path, ahead and back, the nearest point is looked for, in metres.
    pub window_m: f64,
    /// The path ends when less than this is left of it, in metres.
    pub arrived_m: f64,
}

/// How a robot steers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SteeringSettings {
    /// Speed ahead, in m/s.
    pub speed_m_s: f64,
    /// Fastest turn, in rad/s.
    pub max_turn_rad_s: f64,
    /// rad/s per radian of error.
    pub proportional: f64,
    /// rad/s per radian of error and second.
    pub integral: f64,
    /// rad/s per rad/s of error.
    pub derivative: f64,
    /// Most that the integral adds, in rad/s.
    pub max_integral_rad_s: f64,
    /// Heading error from which the robot slows down, in radians.
    pub slow_from_rad: f64,
    /// Heading error from which it turns on the spot, in radians.
    pub stop_from_rad: f64,
    /// How long a command holds, in nanoseconds.
    pub valid_ns: i64,
}

/// When a robot is lost, or blocked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupervisionSettings {
    /// Way without a closure from which it is searching, in metres.
    pub searching_m: f64,
    /// Time without a closure from which it is searching, in nanoseconds.
    pub searching_ns: i64,
    /// Deviation of its position at which it is lost, once it has driven on from the last closure, in metres.
    pub lost_sigma_m: f64,
    /// Way without a closure at which it is lost, in metres.
    pub lost_m: f64,
    /// Time without a closure at which it is lost, of that in which its wheels turned, in nanoseconds.
    pub lost_ns: i64,
    /// Time without any frame, while it should drive, from which it stands until one comes, in nanoseconds.
    pub blind_ns: i64,
    /// Frames without a closure that it needs to be lost by time, those that show too little among them; at least 1.
    pub lost_looks: u32,
    /// Frames without a closure at which it is lost that show something, and nothing known, where
    /// it should be known, as it drives on; at least 1.
    pub unknown_looks: u32,
    /// The same while it does not move: somebody stands before it; at least 1.
    pub unknown_looks_standing: u32,
    /// How near to its way a robot recognises it, in metres.
    pub near_m: f64,
    /// How far it may look away from it for that, in radians.
    pub near_rad: f64,
    /// How fast it turns to look around, in rad/s.
    pub spin_rad_s: f64,
    /// How fast while a closure waits to be confirmed, or something speaks for a place, in rad/s.
    pub confirming_rad_s: f64,
    /// Evidence that speaks for a place, in inliers.
    pub promising_evidence: f64,
    /// Turn after which it stands and waits, in radians.
    pub spin_rad: f64,
    /// How far a lost robot drives back to where it last recognised something, at most, in metres: that way was free.
    pub retreat_m: f64,
    /// How long it stands and looks before it turns, in nanoseconds.
    pub look_first_ns: i64,
    /// How long it may be told to move and not do it, in nanoseconds.
    pub blocked_ns: i64,
    /// How long it then waits before it goes back and tries again, in nanoseconds; longer each time at one spot.
    pub blocked_wait_ns: i64,
    /// How far it goes back the way that it came, in metres; 0 to try again from where it stands.
    pub back_off_m: f64,
}

impl Default for LocalizationSettings {
    fn default() -> Self {
        Self {
            map_m: 0.05,
            map_rad: 1_f64.to_radians(),
            closure_along_m: 0.15,
            depth_m: 4.0,
            along_m_per_ln_scale: 1.6,
            closure_across_m: 0.08,
            closure_heading_rad: 2_f64.to_radians(),
            drift_sigma_rad_per_m: 0.05,
            scale_sigma: 0.05,
            way_noise: 0.02,
            heading_noise: 0.02,
            turn_noise: 0.03,
            gate_chi_squared: 25.0,
            contradictions: 4,
            least_evidence: 30.0,
            confirmations: 3,
            found_along_m: 0.6,
            found_evidence: 100.0,
            found_turn_rad: 0.6,
            search_evidence: 100.0,
            search_rival: 0.4,
            agreement_m: 0.8,
            agreement_rad: 0.35,
        }
    }
}

impl Default for PlanningSettings {
    fn default() -> Self {
        Self { against: AgainstTheWay::Forbidden, turn_m_per_rad: 0.3, reach_m: 2.0 }
    }
}

impl Default for PathSettings {
    fn default() -> Self {
        Self { spacing_m: 0.01, rejoin_m: 0.40, target_m: 0.20, window_m: 1.0, arrived_m: 0.05 }
    }
}

impl Default for SteeringSettings {
    fn default() -> Self {
        Self {
            speed_m_s: 0.4,
            max_turn_rad_s: 1.2,
            proportional: 2.5,
            integral: 0.0,
            derivative: 0.0,
            max_integral_rad_s: 0.3,
            slow_from_rad: 0.35,
            stop_from_rad: 1.0,
            valid_ns: 500_000_000,
        }
    }
}

impl Default for SupervisionSettings {
    fn default() -> Self {
        Self {
            searching_m: 1.0,
            searching_ns: 3_000_000_000,
            lost_sigma_m: 0.8,
            lost_m: 6.0,
            lost_ns: 6_000_000_000,
            blind_ns: 6_000_000_000,
            lost_looks: 8,
            unknown_looks: 6,
            unknown_looks_standing: 24,
            near_m: 0.5,
            near_rad: 0.5,
            spin_rad_s: 0.25,
            confirming_rad_s: 0.1,
            promising_evidence: 40.0,
            spin_rad: 3.0 * std::f64::consts::TAU,
            retreat_m: 2.0,
            look_first_ns: 2_000_000_000,
            blocked_ns: 1_500_000_000,
            blocked_wait_ns: 2_000_000_000,
            back_off_m: 0.5,
        }
    }
}

/// A setting that no robot can be led by.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the navigation setting {setting} is {value}; it must lie in {least} to {most}")]
pub struct NavigationSettingsError {
    /// Its name.
    pub setting: &'static str,
    /// As given.
    pub value: f64,
    /// Least that makes sense.
    pub least: f64,
    /// Most that makes sense.
    pub most: f64,
}

impl NavigationSettings {
    /// # Errors
    /// [`NavigationSettingsError`] with the first setting that is out of its range.
    pub fn check(&self) -> Result<(), NavigationSettingsError> {
        let Self { localization, planning, path, steering, supervision } = self;
        let ranges = localization
            .ranges()
            .into_iter()
            .chain(planning.ranges())
            .chain(path.ranges())
            .chain(steering.ranges())
            .chain(supervision.ranges());
        for (setting, value, least, most) in ranges {
            // Also false for NaN.
            if !(least..=most).contains(&value) {
                return Err(NavigationSettingsError { setting, value, least, most });
            }
        }
        Ok(())
    }
}

type Range = (&'static str, f64, f64, f64);

#[cfg(test)]
mod tests;
