//! From a heading error to a command.

use super::settings::SteeringSettings;

/// What a robot is to do, and for how long.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityCommand {
    /// Rises by one with each command; a robot tells with its odometry which one it obeys.
    pub number: u64,
    /// Speed ahead, in m/s; below 0 where a lost robot goes back as it came.
    pub forward_m_s: f64,
    /// Turn to the left, in rad/s.
    pub turn_rad_s: f64,
    /// How long it holds after it has come, in nanoseconds; then the robot is to stop.
    pub valid_ns: i64,
}

/// A PID controller from heading error to turn.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Steering {
    integral_rad_s: f64,
    last_error_rad: Option<f64>,
}

impl Steering {
    /// Speed ahead in m/s and turn to the left in rad/s, for a target that lies `error_rad` to the
    /// left of ahead, `elapsed_s` after the last call. Constant speed, but for what is far off: the
    /// robot slows down, and turns on the spot.
    pub fn steer(&mut self, error_rad: f64, elapsed_s: f64, settings: &SteeringSettings) -> [f64; 2] {
        let most = settings.max_integral_rad_s;
        self.integral_rad_s =
            (self.integral_rad_s + settings.integral * error_rad * elapsed_s).clamp(-most, most);
        let rate_rad_s = match self.last_error_rad {
            Some(last) if elapsed_s > 0.0 => (error_rad - last) / elapsed_s,
            Some(_) | None => 0.0,
        };
        self.last_error_rad = Some(error_rad);
        let turn_rad_s =
            settings.proportional * error_rad + self.integral_rad_s + settings.derivative * rate_rad_s;
        let [slow, stop] = [settings.slow_from_rad, settings.stop_from_rad];
        let off_rad = error_rad.abs();
        let share = if off_rad <= slow {
            1.0
        } else if off_rad >= stop {
            0.0
        } else {
            (stop - off_rad) / (stop - slow)
        };
        let most = settings.max_turn_rad_s;
        [settings.speed_m_s * share, turn_rad_s.clamp(-most, most)]
    }

    /// Forgets what has been: the path is another one.
    pub fn reset(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn commands_keep_their_limits_and_turn_to_the_target(
            errors in proptest::collection::vec((-3.1..3.1f64, 0.0..0.5f64), 1..50),
            (proportional, integral, derivative) in (0.1..9.0f64, 0.0..9.0f64, 0.0..9.0f64),
        ) {
            let settings = SteeringSettings { proportional, integral, derivative, ..SteeringSettings::default() };
            let mut steering = Steering::default();
            for (error_rad, elapsed_s) in errors {
                let [forward, turn] = steering.steer(error_rad, elapsed_s, &settings);
                prop_assert!((0.0..=settings.speed_m_s).contains(&forward) && turn.abs() <= settings.max_turn_rad_s);
                prop_assert!(forward == settings.speed_m_s || error_rad.abs() > settings.slow_from_rad);
                let [_, fresh] = Steering::default().steer(error_rad, elapsed_s, &settings);
                prop_assert!(fresh * error_rad >= 0.0);
            }
        }
    }

    #[test]
    fn the_terms_are_those_of_a_pid() {
        let settings = SteeringSettings {
            proportional: 2.0,
            integral: 0.5,
            derivative: 0.1,
            ..SteeringSettings::default()
        };
        let mut steering = Steering::default();
        let [_, first] = steering.steer(0.1, 0.0, &settings);
        assert!((first - 0.2).abs() < 1e-12);
        let [_, second] = steering.steer(0.2, 0.5, &settings);
        assert!((second - (0.4 + 0.5 * 0.2 * 0.5 + 0.1 * 0.1 / 0.5)).abs() < 1e-12);
    }
}
