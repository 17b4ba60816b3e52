//! Odometry in other conventions than it should be in: turned axes, quaternions in another order, headings that are of
//! something else than the way.

use waypost_bags::Pose;

use crate::odometry::StampedPose;

/// Shorter ways have no direction to speak of, in metres.
const LEAST_CHORD_M: f64 = 0.2;

/// Chords that are too few to compare headings with.
const LEAST_CHORDS: usize = 20;

/// Concentration of directions (1: all are the same one, 0: they are all around) above which most agree, and below which they
/// do not.
const AGREE: f64 = 0.7;
const DIFFER: f64 = 0.5;

/// Headings that turn by less, from the one furthest right to the one furthest left, are not measured: 1 degree.
const LEAST_TURN_RAD: f64 = 0.0175;

/// How much of the robot's z axis points up, where it stands on a floor or a hill, and where it lies: 25 and 60 degrees.
const UPRIGHT: f64 = 0.9;
const LYING: f64 = 0.5;

/// What seems to be in another convention, a sentence each: nothing that a robot which drives ahead does looks like that.
pub(crate) fn doubts(poses: &[StampedPose]) -> Vec<String> {
    // Headings of a robot that lies on its side say nothing.
    match lies(poses) {
        Some(doubt) => vec![doubt],
        None => heads_elsewhere(poses).into_iter().collect(),
    }
}

/// Orientations by which the robot does not stand on its wheels.
fn lies(poses: &[StampedPose]) -> Option<String> {
    let up = |pose: &Pose| up([pose.orientation[0], pose.orientation[1]]);
    // Read with w first, the second and third numbers are x and y.
    let up_with_w_first = |pose: &Pose| up_with_w_first(pose.orientation);
    let lying = poses.iter().filter(|stamped| up(&stamped.pose) < LYING).count();
    if lying == 0 {
        return None;
    }
    if poses.iter().all(|stamped| up_with_w_first(&stamped.pose) > UPRIGHT) {
        return Some(
            "by its odometry the robot lies on its back, and with the quaternion's first number taken as its w it stands: write \
             quaternions as qx qy qz qw, with w last"
                .to_owned(),
        );
    }
    (2 * lying > poses.len()).then(|| {
        format!(
            "at {lying} of {} poses the robot lies on its side or back by its odometry's orientations: are they those of a camera, \
             whose z is ahead, and not of the robot, with x forward, y left, z up?",
            poses.len()
        )
    })
}

/// How much of the z axis of what is turned by a quaternion points up.
fn up([x, y]: [f64; 2]) -> f64 {
    1.0 - 2.0 * (x * x + y * y)
}

fn up_with_w_first([_w, x, y, _z]: [f64; 4]) -> f64 {
    up([x, y])
}

/// Headings that say nothing of where the robot drives to, though its way turns.
fn heads_elsewhere(poses: &[StampedPose]) -> Option<String> {
    let chords = chords(poses);
    if chords.len() < LEAST_CHORDS {
        return None;
    }
    let concentrated = |angle_rad: fn(&Chord) -> f64| concentration(chords.iter().map(angle_rad));
    let first_rad = chords[0].heading_rad;
    let turns = chords.iter().map(|chord| wrapped(chord.heading_rad - first_rad));
    let (right_rad, left_rad) =
        turns.fold((0.0_f64, 0.0_f64), |(right, left), turn| (right.min(turn), left.max(turn)));
    if left_rad - right_rad < LEAST_TURN_RAD {
        // Twice an angle is the same ahead and back: a robot on rails does not turn.
        let is_one_line = concentrated(|chord| 2.0 * chord.way_rad) > AGREE;
        return (!is_one_line).then(|| {
            format!(
                "by its odometry the robot drives in all directions and looks in one, {first_rad:.3} rad, all the time: was its \
                 heading left out? If it drives sideways, go on"
            )
        });
    }
    let is_ahead = concentrated(|chord| chord.way_rad - chord.heading_rad) > DIFFER;
    let is_mirrored = concentrated(|chord| chord.way_rad + chord.heading_rad) > AGREE;
    (is_mirrored && !is_ahead).then(|| {
        "by its odometry the robot's way turns to the right wherever its heading turns to the left: were x and y exchanged, or one of \
         the axes turned around? x is forward, y left, and headings grow to the left"
            .to_owned()
    })
}

/// A piece of the way that is long enough to have a direction.
struct Chord {
    way_rad: f64,
    /// Where the robot looked, half way.
    heading_rad: f64,
}

fn chords(poses: &[StampedPose]) -> Vec<Chord> {
    let mut chords = Vec::new();
    let mut from = 0;
    for to in 1..poses.len() {
        let ([x_m, y_m, _], [next_x_m, next_y_m, _]) =
            (poses[from].pose.position_m, poses[to].pose.position_m);
        let (way_x_m, way_y_m) = (next_x_m - x_m, next_y_m - y_m);
        if way_x_m.hypot(way_y_m) >= LEAST_CHORD_M {
            let (before_rad, after_rad) = (heading_rad(&poses[from]), heading_rad(&poses[to]));
            let heading_rad = before_rad + wrapped(after_rad - before_rad) / 2.0;
            chords.push(Chord { way_rad: way_y_m.atan2(way_x_m), heading_rad });
            from = to;
        }
    }
    chords
}

fn heading_rad(stamped: &StampedPose) -> f64 {
    let [x, y, z, w] = stamped.pose.orientation;
    (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
}

/// Within half a turn.
fn wrapped(angle_rad: f64) -> f64 {
    let (sine, cosine) = angle_rad.sin_cos();
    sine.atan2(cosine)
}

/// How alike directions are.
fn concentration(angles_rad: impl Iterator<Item = f64>) -> f64 {
    let (mut count, mut sine_sum, mut cosine_sum) = (0_u32, 0.0, 0.0);
    for angle_rad in angles_rad {
        let (sine, cosine) = angle_rad.sin_cos();
        (count, sine_sum, cosine_sum) = (count + 1, sine_sum + sine, cosine_sum + cosine);
    }
    f64::hypot(sine_sum, cosine_sum) / f64::from(count.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::parse;

    /// A drive along three sides of a court, with a turn on the spot at its corners and a piece back: x, y, heading.
    fn court() -> Vec<[f64; 3]> {
        let mut poses = vec![[0.0, 0.0, 0.0_f64]];
        let mut last = poses[0];
        let mut step = |ahead_m: f64, turn_rad: f64| {
            let [x_m, y_m, heading_rad] = last;
            last = [
                x_m + ahead_m * heading_rad.cos(),
                y_m + ahead_m * heading_rad.sin(),
                heading_rad + turn_rad,
            ];
            poses.push(last);
        };
        for side in 0..3 {
            (0..30).for_each(|_| step(0.3, 0.002 * f64::from(side)));
            (0..8).for_each(|_| step(0.0, std::f64::consts::FRAC_PI_4 / 4.0));
        }
        (0..10).for_each(|_| step(-0.3, 0.0));
        poses
    }

    fn written(poses: &[[f64; 3]], row: impl Fn(f64, f64, f64) -> [f64; 6]) -> Vec<String> {
        let rows = poses.iter().zip(1..).map(|([x_m, y_m, heading_rad], stamp)| {
            let [x, y, first, second, third, fourth] = row(*x_m, *y_m, *heading_rad);
            format!("{stamp} {x} {y} 0 {first} {second} {third} {fourth}")
        });
        doubts(&parse(&rows.collect::<Vec<_>>().join("\n")).unwrap())
    }

    #[test]
    fn what_a_robot_does_raises_no_doubt() {
        let straight: Vec<[f64; 3]> = (0..60).map(|step| [0.3 * f64::from(step), 0.0, 0.0]).collect();
        let standing = vec![[1.0, 2.0, 0.5]; 60];
        let rails: Vec<[f64; 3]> =
            (0..60_i32).map(|step| [0.3 * f64::from((step - 30).abs()), 0.0, 0.0]).collect();
        let sideways = |heading_rad: f64| heading_rad + std::f64::consts::FRAC_PI_2;
        for drive in [court(), straight, standing, rails] {
            let upright = written(&drive, |x, y, heading| {
                [x, y, 0.0, 0.0, (heading / 2.0).sin(), (heading / 2.0).cos()]
            });
            assert_eq!(upright, Vec::<String>::new());
            // A camera that looks to the left, of a robot that drives ahead.
            let beside = written(&drive, |x, y, heading| {
                [x, y, 0.0, 0.0, (sideways(heading) / 2.0).sin(), (sideways(heading) / 2.0).cos()]
            });
            assert_eq!(beside, Vec::<String>::new());
        }
    }

    #[test]
    fn quaternions_with_w_first_are_noticed() {
        let found =
            written(&court(), |x, y, heading| [x, y, (heading / 2.0).cos(), 0.0, 0.0, (heading / 2.0).sin()]);
        assert!(found.len() == 1 && found[0].contains("with w last"), "{found:?}");
    }

    #[test]
    fn orientations_of_a_camera_are_noticed() {
        // z ahead, x to the right: turned by the heading, after (-0.5, 0.5, -0.5, 0.5).
        let found = written(&court(), |x, y, heading| {
            let (sine, cosine) = ((heading / 2.0).sin() / 2.0, (heading / 2.0).cos() / 2.0);
            [x, y, -cosine - sine, cosine - sine, sine - cosine, cosine + sine]
        });
        assert!(found.len() == 1 && found[0].contains("of a camera"), "{found:?}");
    }

    #[test]
    fn a_heading_that_was_left_out_is_noticed() {
        let found = written(&court(), |x, y, _heading| [x, y, 0.0, 0.0, 0.0, 1.0]);
        assert!(found.len() == 1 && found[0].contains("looks in one, 0.000 rad"), "{found:?}");
    }

    #[test]
    fn axes_that_were_exchanged_are_noticed() {
        let quaternion = |heading: f64| [0.0, 0.0, (heading / 2.0).sin(), (heading / 2.0).cos()];
        for [of_x, of_y, exchanged] in [[0.0, 0.0, 1.0], [1.0, -1.0, 0.0], [-1.0, 1.0, 0.0]] {
            let found = written(&court(), |x, y, heading| {
                let [qx, qy, qz, qw] = quaternion(heading);
                [of_x * x + exchanged * y, of_y * y + exchanged * x, qx, qy, qz, qw]
            });
            assert!(found.len() == 1 && found[0].contains("were x and y exchanged"), "{found:?}");
        }
    }
}
