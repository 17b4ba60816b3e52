//! Odometry in other units or axes than it should have: nothing that a robot does looks like that.

use crate::odometry::StampedPose;

/// Faster than robots and most cars drive, in m/s: 72 km/h.
const DOUBTFUL_SPEED_M_S: f64 = 20.0;

/// Further apart than a robot's poses are, in seconds, where it drives slower than a snail: stamps in milliseconds.
const DOUBTFUL_PAUSE_S: f64 = 20.0;
const SNAIL_M_S: f64 = 0.01;

/// Faster than robots turn: once around in a second.
const DOUBTFUL_TURN_RAD_S: f64 = std::f64::consts::TAU;

/// Turns as fast as that before anything is said: one alone may be a jump.
const DOUBTFUL_TURNS: usize = 3;

/// Headings that spread less are no degrees, or of a robot that hardly turned: three turns, if they are radians.
const LEAST_SPAN_OF_DEGREES: f64 = 20.0;

/// Headings that jump by so much between two poses go around in degrees: radians jump by a whole turn, which is 6.3.
const JUMP_OF_DEGREES: std::ops::RangeInclusive<f64> = 330.0..=360.0;

/// Headings that are all whole multiples of this were written by people, in degrees.
const ROUND_DEGREES: f64 = 15.0;

/// Steps that are too few to compare headings with.
const LEAST_STEPS: usize = 20;

/// Median sines of the angle between heading and way: below the first they agree, above the second they do not.
const ALONG: f64 = 0.2;
const ACROSS: f64 = 0.4;

/// A robot that rises or falls for a larger share of its way drives up walls: steps go up by less than 45 degrees.
const DOUBTFUL_RISE: f64 = 0.5;

/// Ways that are too short to tell how they rise.
const LEAST_WAY_M: f64 = 2.0;

/// What seems to be in other units or axes, a sentence each.
pub(crate) fn doubts(poses: &[StampedPose]) -> Vec<String> {
    [centimetres(poses), milliseconds(poses), degrees(poses), optical_axes(poses)]
        .into_iter()
        .flatten()
        .collect()
}

/// Axes of a camera, where z is ahead and not up.
fn optical_axes(poses: &[StampedPose]) -> Option<String> {
    let (mut way_m, mut risen_m) = (0.0, 0.0);
    for pair in poses.windows(2) {
        let [x_m, y_m, z_m] =
            [0, 1, 2].map(|axis| pair[1].pose.position_m[axis] - pair[0].pose.position_m[axis]);
        way_m += x_m.hypot(y_m).hypot(z_m);
        risen_m += z_m.abs();
    }
    (way_m > LEAST_WAY_M && risen_m > DOUBTFUL_RISE * way_m).then(|| {
        format!(
            "by its odometry the robot rises and falls for {risen_m:.1} m of a way of {way_m:.1} m: are its axes those of a \
             camera, with z ahead, and not x forward, y left, z up?"
        )
    })
}

/// Seconds between a pose and the next.
fn steps(poses: &[StampedPose]) -> impl Iterator<Item = (&StampedPose, &StampedPose, f64)> {
    poses.windows(2).map(|pair| (&pair[0], &pair[1], (pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9))
}

/// Of the steps in which the robot moved: speeds in m/s.
fn median_speed(poses: &[StampedPose]) -> Option<f64> {
    let speed = |(one, other, seconds): (&StampedPose, &StampedPose, f64)| way_m(one, other) / seconds;
    median(steps(poses).map(speed).filter(|speed| *speed > 0.0).collect())
}

fn way_m(one: &StampedPose, other: &StampedPose) -> f64 {
    let squares = one
        .pose
        .position_m
        .iter()
        .zip(other.pose.position_m)
        .map(|(one, other)| (other - one) * (other - one));
    squares.sum::<f64>().sqrt()
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn milliseconds(poses: &[StampedPose]) -> Option<String> {
    let way_m: f64 = poses.windows(2).map(|pair| way_m(&pair[0], &pair[1])).sum();
    let pause_s = median(steps(poses).map(|(_, _, seconds)| seconds).collect())?;
    let speed = median_speed(poses)?;
    (way_m > LEAST_WAY_M && pause_s > DOUBTFUL_PAUSE_S && speed < SNAIL_M_S).then(|| {
        format!(
            "by its odometry the robot drives {:.1} mm/s, and its poses are {pause_s:.0} s apart: are stamps in milliseconds or \
             microseconds, and not in their unit?",
            1e3 * speed
        )
    })
}

fn centimetres(poses: &[StampedPose]) -> Option<String> {
    let median = median_speed(poses)?;
    (median > DOUBTFUL_SPEED_M_S).then(|| {
        format!(
            "by its odometry the robot drives {median:.0} m/s, {:.0} km/h: are positions in centimetres or millimetres, and \
             not in metres, or stamps not in their unit?",
            median * 3.6
        )
    })
}

/// Degrees, by how fast the robot would turn, or by where it drives.
fn degrees(poses: &[StampedPose]) -> Option<String> {
    turns_too_fast(poses)
        .or_else(|| goes_around_in_degrees(poses))
        .or_else(|| drives_by_degrees(poses))
        .or_else(|| looks_along_axes(poses))
}

/// A robot that turns by 90 at a time is written down in degrees.
fn looks_along_axes(poses: &[StampedPose]) -> Option<String> {
    let yaws = || poses.iter().filter_map(|pose| pose.yaw_rad);
    let first = yaws().find(|yaw| *yaw != 0.0)?;
    yaws().all(|yaw| yaw % ROUND_DEGREES == 0.0).then(|| {
        format!("the odometry's headings are whole multiples of {ROUND_DEGREES}, as {first} is: is yaw_rad in degrees?")
    })
}

/// Also of a robot that turns slowly, and on the spot: from 180 to -180, or from 360 to 0.
fn goes_around_in_degrees(poses: &[StampedPose]) -> Option<String> {
    let is_within_a_turn = poses.iter().filter_map(|pose| pose.yaw_rad).all(|yaw| yaw.abs() <= 360.0);
    let jump = poses.windows(2).find_map(|pair| {
        let (before, after) = (pair[0].yaw_rad?, pair[1].yaw_rad?);
        JUMP_OF_DEGREES.contains(&(after - before).abs()).then_some((before, after))
    });
    let (before, after) = jump.filter(|_| is_within_a_turn)?;
    Some(format!(
        "by its odometry the robot turns from {before:.1} to {after:.1} at once: is yaw_rad in degrees?"
    ))
}

/// A robot drives to where it looks, or back from there. Headings over some turns that fit that in degrees, and do
/// not in radians, are degrees.
fn drives_by_degrees(poses: &[StampedPose]) -> Option<String> {
    let yaws = || poses.iter().filter_map(|pose| pose.yaw_rad);
    let span = yaws().fold(f64::NEG_INFINITY, f64::max) - yaws().fold(f64::INFINITY, f64::min);
    // Radians that are wrapped do not reach that far.
    if span <= LEAST_SPAN_OF_DEGREES {
        return None;
    }
    let off_rad = |as_radians: f64| {
        let off = poses.windows(2).filter_map(|pair| {
            let ([x_m, y_m, _], [next_x_m, next_y_m, _]) = (pair[0].pose.position_m, pair[1].pose.position_m);
            let (way_x_m, way_y_m) = (next_x_m - x_m, next_y_m - y_m);
            let off_rad = way_y_m.atan2(way_x_m) - pair[0].yaw_rad? * as_radians;
            (way_x_m.hypot(way_y_m) > 0.0).then(|| off_rad.sin().abs())
        });
        let mut off: Vec<f64> = off.collect();
        off.sort_by(f64::total_cmp);
        off.get(off.len() / 2).filter(|_| off.len() >= LEAST_STEPS).copied()
    };
    let (in_radians, in_degrees) = (off_rad(1.0)?, off_rad(1.0_f64.to_radians())?);
    (in_degrees < ALONG && in_radians > ACROSS).then(|| {
        "taken as degrees, headings of the odometry point to where the robot drives, and taken as radians they do not: \
         is yaw_rad in degrees?"
            .to_owned()
    })
}

fn turns_too_fast(poses: &[StampedPose]) -> Option<String> {
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

    #[test]
    fn stamps_in_milliseconds_are_noticed() {
        let slower = |times: i64| {
            let slower = |pose: StampedPose| StampedPose { stamp_ns: pose.stamp_ns * times, ..pose };
            curve(1.0, 1.0).into_iter().map(slower).collect::<Vec<_>>()
        };
        let in_milliseconds = doubts(&slower(1000));
        assert!(in_milliseconds.len() == 1 && in_milliseconds[0].contains("0.5 mm/s"), "{in_milliseconds:?}");
        // An image in three seconds.
        assert_eq!(doubts(&slower(30)), Vec::<String>::new());
    }

    /// A round of 30 m by axes that are given from ahead and to the left.
    fn round(axes: impl Fn(f64, f64) -> [f64; 3]) -> Vec<StampedPose> {
        let row = |step: i64| {
            let (sine, cosine) = (step as f64 * 0.1).sin_cos();
            let [x_m, y_m, z_m] = axes(5.0 * sine, 5.0 * (1.0 - cosine));
            format!("{} {x_m} {y_m} {z_m} 0 0 0 1", step + 1)
        };
        parse(&(0..63).map(row).collect::<Vec<_>>().join("\n")).unwrap()
    }

    #[test]
    fn axes_of_a_camera_are_noticed() {
        let optical = doubts(&round(|ahead_m, left_m| [-left_m, 0.0, ahead_m]));
        assert!(optical.len() == 1 && optical[0].contains("with z ahead"), "{optical:?}");
        // Level, up a hill and down again, and on a bumpy way.
        for poses in [
            round(|ahead_m, left_m| [ahead_m, left_m, 0.0]),
            round(|ahead_m, left_m| [ahead_m, left_m, 0.4 * ahead_m]),
            round(|ahead_m, left_m| [ahead_m, left_m, 0.1 * (40.0 * ahead_m).sin()]),
        ] {
            assert_eq!(doubts(&poses), Vec::<String>::new());
        }
    }

    /// A circle that takes so many seconds, a pose a second, with headings times `radians`.
    fn circle(seconds: f64, radians: f64) -> Vec<StampedPose> {
        let row = |second: i64| {
            let heading = second as f64 * std::f64::consts::TAU / seconds;
            let (sine, cosine) = heading.sin_cos();
            format!("{},{sine},{},{}", (second + 1) * 1_000_000_000, -cosine, heading * radians)
        };
        let rows: Vec<String> = (0..120).map(row).collect();
        parse(&format!("stamp_ns,x_m,y_m,yaw_rad\n{}\n", rows.join("\n"))).unwrap()
    }

    #[test]
    fn degrees_of_a_robot_that_turns_slowly_are_noticed() {
        // 5 degrees a second: in radians that would be no doubtful rate.
        let doubted = doubts(&circle(72.0, 57.2958));
        assert!(doubted.len() == 1 && doubted[0].contains("point to where the robot drives"), "{doubted:?}");
        for seconds in [8.0, 30.0, 72.0, 500.0] {
            assert_eq!(doubts(&circle(seconds, 1.0)), Vec::<String>::new(), "{seconds}");
        }
    }

    #[test]
    fn degrees_of_a_robot_that_turns_by_quarters_are_noticed() {
        let headed = |yaws: &[f64]| {
            let row = |(second, yaw): (usize, &f64)| format!("{},0,0,{yaw}", (second + 1) * 1_000_000_000);
            let rows: Vec<String> = yaws.iter().enumerate().map(row).collect();
            doubts(&parse(&format!("stamp_ns,x_m,y_m,yaw_rad\n{}\n", rows.join("\n"))).unwrap())
        };
        for yaws in [&[0.0, 0.0, 90.0, 90.0][..], &[0.0, 90.0, 180.0], &[-45.0, -45.0], &[30.0, 15.0, 0.0]] {
            let doubted = headed(yaws);
            assert!(
                doubted.len() == 1 && doubted[0].contains("is yaw_rad in degrees"),
                "{yaws:?}: {doubted:?}"
            );
        }
        for yaws in [&[0.0, 0.0][..], &[0.0, 1.5], &[0.0, 90.0_f64.to_radians(), 3.0], &[15.0, 16.5]] {
            assert_eq!(headed(yaws), Vec::<String>::new(), "{yaws:?}");
        }
    }

    #[test]
    fn degrees_of_a_robot_that_turns_on_the_spot_are_noticed() {
        // Five degrees a second, once around, wrapped as atan2 does it.
        let spin = |as_degrees: bool| {
            let row = |second: i64| {
                let degrees = (second * 5 + 180).rem_euclid(360) - 180;
                let yaw = if as_degrees { degrees as f64 } else { (degrees as f64).to_radians() };
                format!("{},0,0,{yaw}", (second + 1) * 1_000_000_000)
            };
            let rows: Vec<String> = (0..72).map(row).collect();
            parse(&format!("stamp_ns,x_m,y_m,yaw_rad\n{}\n", rows.join("\n"))).unwrap()
        };
        let doubted = doubts(&spin(true));
        assert!(doubted.len() == 1 && doubted[0].contains("is yaw_rad in degrees"), "{doubted:?}");
        assert_eq!(doubts(&spin(false)), Vec::<String>::new());
    }
}
