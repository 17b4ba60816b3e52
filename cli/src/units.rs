//! Odometry in other units than it should have: nothing that a robot does looks like that.

use crate::odometry::StampedPose;

/// Faster than robots and most cars drive, in m/s: 72 km/h.
const DOUBTFUL_SPEED_M_S: f64 = 20.0;

/// Faster than robots turn: once around in a second.
const DOUBTFUL_TURN_RAD_S: f64 = std::f64::consts::TAU;

/// Turns as fast as that before anything is said: one alone may be a jump.
const DOUBTFUL_TURNS: usize = 3;

/// What seems to be in other units, a sentence each.
pub(crate) fn doubts(poses: &[StampedPose]) -> Vec<String> {
    [centimetres(poses), degrees(poses)].into_iter().flatten().collect()
}

/// Seconds between a pose and the next.
fn steps(poses: &[StampedPose]) -> impl Iterator<Item = (&StampedPose, &StampedPose, f64)> {
    poses.windows(2).map(|pair| (&pair[0], &pair[1], (pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9))
}

fn centimetres(poses: &[StampedPose]) -> Option<String> {
    let speed = |(one, other, seconds): (&StampedPose, &StampedPose, f64)| {
        let squares: f64 = one
            .pose
            .position_m
            .iter()
            .zip(other.pose.position_m)
            .map(|(one, other)| (other - one) * (other - one))
            .sum();
        squares.sqrt() / seconds
    };
    let mut speeds: Vec<f64> = steps(poses).map(speed).filter(|speed| *speed > 0.0).collect();
    speeds.sort_by(f64::total_cmp);
    let median = *speeds.get(speeds.len() / 2)?;
    (median > DOUBTFUL_SPEED_M_S).then(|| {
        format!(
            "by its odometry the robot drives {median:.0} m/s, {:.0} km/h: are positions in centimetres or millimetres, and \
             not in metres, or stamps not in their unit?",
            median * 3.6
        )
    })
}

fn degrees(poses: &[StampedPose]) -> Option<String> {
    // Radians that go on over a whole turn do not jump back, those that jump back stay within one.
    let is_wide = poses.iter().filter_map(|pose| pose.yaw_rad).any(|yaw| yaw.abs() > std::f64::consts::TAU);
    let fast = steps(poses).filter_map(|(one, other, seconds)| {
        let turn = (other.yaw_rad? - one.yaw_rad?).abs();
        Some(turn / seconds).filter(|rate| *rate > DOUBTFUL_TURN_RAD_S)
    });
    let rates: Vec<f64> = fast.collect();
    let fastest = rates.iter().copied().fold(0.0, f64::max);
    (is_wide && rates.len() >= DOUBTFUL_TURNS).then(|| {
        format!(
            "by its odometry the robot turns by up to {fastest:.0} rad/s, {:.0} times around in a second: is yaw_rad in \
             degrees, and not in radians?",
            fastest / std::f64::consts::TAU
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::parse;

    /// Ten poses a second: a curve with a yaw and a distance between two that are multiplied.
    fn curve(metres: f64, radians: f64) -> Vec<StampedPose> {
        let row = |index: i64| {
            let step = index as f64;
            format!("{},{},0,{}", (index + 1) * 100_000_000, 0.05 * metres * step, 0.04 * radians * step)
        };
        let rows: Vec<String> = (0..100).map(row).collect();
        parse(&format!("stamp_ns,x_m,y_m,yaw_rad\n{}\n", rows.join("\n"))).unwrap()
    }

    #[test]
    fn what_a_robot_does_raises_no_doubt() {
        // 4 radians in all, then once more with a whole turn.
        for poses in [curve(1.0, 1.0), curve(1.0, 3.0), curve(30.0, 1.0), curve(0.0, 0.0)] {
            assert_eq!(doubts(&poses), Vec::<String>::new());
        }
        // From pi to -pi, as atan2 goes.
        let wrapped = "stamp_ns,x_m,y_m,yaw_rad\n1,0,0,3.1\n2,0,0,-3.1\n3,0,0,3.1\n4,0,0,-3.1\n5,0,0,3.1\n";
        assert_eq!(doubts(&parse(wrapped).unwrap()), Vec::<String>::new());
    }

    #[test]
    fn degrees_and_centimetres_are_noticed() {
        let in_degrees = doubts(&curve(1.0, 57.3));
        assert!(in_degrees.len() == 1 && in_degrees[0].contains("degrees"), "{in_degrees:?}");
        let in_centimetres = doubts(&curve(100.0, 1.0));
        assert!(in_centimetres.len() == 1 && in_centimetres[0].contains("180 km/h"), "{in_centimetres:?}");
        assert_eq!(doubts(&curve(1000.0, 57.3)).len(), 2);
    }
}
