//! From a heading to speeds.

/// How a robot drives to where it is to look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadingSteering {
    /// Speed where the way is straight ahead, in m/s, above 0.
    pub speed_m_s: f64,
    /// Fastest turn, in rad/s, above 0.
    pub max_turn_rad_s: f64,
    /// Turn per heading, in 1/s, above 0.
    pub turn_per_s: f64,
    /// Heading from which the robot turns on the spot, in radians, above 0.
    pub stop_from_rad: f64,
    /// Turn of a robot that looks around, in rad/s.
    pub look_around_rad_s: f64,
}

impl Default for HeadingSteering {
    fn default() -> Self {
        Self {
            speed_m_s: 0.4,
            max_turn_rad_s: 1.2,
            turn_per_s: 1.8,
            stop_from_rad: 0.8,
            look_around_rad_s: 0.5,
        }
    }
}

impl HeadingSteering {
    /// Speed ahead in m/s and turn to the left in rad/s: the faster the less there is to turn. A
    /// robot that does not know where to drive looks around on the spot.
    #[must_use]
    pub fn steer(&self, heading_rad: Option<f64>) -> [f64; 2] {
        let Some(heading_rad) = heading_rad else { return [0.0, self.look_around_rad_s] };
        let share = (1.0 - heading_rad.abs() / self.stop_from_rad).max(0.0);
        let turn_rad_s = self.turn_per_s * heading_rad;
        [self.speed_m_s * share, turn_rad_s.clamp(-self.max_turn_rad_s, self.max_turn_rad_s)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_robot_turns_to_its_heading_within_its_limits(heading_rad in -3.2..3.2f64) {
            let steering = HeadingSteering::default();
            let [forward, turn] = steering.steer(Some(heading_rad));
            prop_assert!((0.0..=steering.speed_m_s).contains(&forward));
            prop_assert!(turn.abs() <= steering.max_turn_rad_s && turn * heading_rad >= 0.0);
            prop_assert_eq!(forward == 0.0, heading_rad.abs() >= steering.stop_from_rad);
        }
    }

    #[test]
    fn without_a_heading_it_looks_around() {
        assert_eq!(HeadingSteering::default().steer(None), [0.0, 0.5]);
        assert_eq!(HeadingSteering::default().steer(Some(0.0)), [0.4, 0.0]);
    }
}
