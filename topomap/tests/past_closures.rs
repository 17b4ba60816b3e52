//! A closure that is wrong does not take with it what is driven after it.

use std::f64::consts::FRAC_PI_2;

use fabmap::PlaceId;
use nalgebra::Matrix3;
use posegraph::{PlanarPose, Pose};

use topomap::log::{Link, LinkKind};
use topomap::map::PlacePoses;
use topomap::metric::{OdometryNoise, RelativePose};

/// A drive that makes places a metre apart, and what it links.
struct Drive {
    truth: Vec<PlanarPose>,
    links: Vec<Link>,
    /// Where it goes on from: the place, and the robot in the frame of that.
    anchor: (usize, PlanarPose),
    robot: PlanarPose,
}

impl Drive {
    fn begin() -> Self {
        let origin = PlanarPose::identity();
        Self { truth: vec![origin], links: Vec::new(), anchor: (0, origin), robot: origin }
    }

    /// A metre ahead after a turn. Wheels measure well what they measure.
    fn go(&mut self, turn_rad: f64) {
        let step = PlanarPose::new(1.0, 0.0, turn_rad);
        self.robot = self.robot.compose(&step);
        self.anchor.1 = self.anchor.1.compose(&step);
    }

    fn make_place(&mut self) {
        let (from, measured) = self.anchor;
        let to = self.truth.len();
        let measured = OdometryNoise::default().of_motion(&measured);
        self.links.push(link(from, to, LinkKind::Driven(measured)));
        self.truth.push(self.robot);
        self.anchor = (to, PlanarPose::identity());
    }

    /// It is said to stand there in a place.
    fn close(&mut self, to: usize, at: PlanarPose) {
        let (from, measured) = self.anchor;
        let at = RelativePose::new(at, Matrix3::from_diagonal_element(1e-3)).unwrap();
        let measured = OdometryNoise::default().of_motion(&measured).then(&at.back());
        self.links.push(link(from, to, LinkKind::Closed(measured)));
        self.anchor = (to, *at.pose());
    }

    /// Where it is in truth in a place.
    fn at(&self, place: usize) -> PlanarPose {
        self.truth[place].inverse().compose(&self.robot)
    }

    fn poses(&self) -> PlacePoses {
        PlacePoses::new(vec![0; self.truth.len()], &self.links, &OdometryNoise::default())
    }

    /// How far a place is from where it is in truth.
    fn error_m(&self, poses: &PlacePoses, place: usize) -> f64 {
        let found = poses.pose(PlaceId::from_index(place)).unwrap();
        let truth = &self.truth[place];
        (found.x_m() - truth.x_m()).hypot(found.y_m() - truth.y_m())
    }
}

fn link(from: usize, to: usize, kind: LinkKind) -> Link {
    Link { from: PlaceId::from_index(from), to: PlaceId::from_index(to), kind }
}

/// Once around a square of 8 m, and then across it from one side to the other: two loops. After place
/// 10 come frames that are taken for places where it began, one after the other: only the first of
/// them is linked, as those are linked with each other.
fn square(taken_for: &[usize]) -> Drive {
    let mut drive = Drive::begin();
    for step in 1..32_usize {
        drive.go(if step % 8 == 0 { FRAC_PI_2 } else { 0.0 });
        let wrong = step.checked_sub(11).and_then(|frame| taken_for.get(frame));
        match wrong {
            Some(&place) if step == 11 => drive.close(place, PlanarPose::identity()),
            Some(&place) => drive.anchor = (place, PlanarPose::identity()),
            None => drive.make_place(),
        }
    }
    drive.go(FRAC_PI_2);
    drive.close(0, drive.at(0));
    for _ in 0..3 {
        drive.go(0.0);
    }
    drive.go(FRAC_PI_2);
    drive.anchor = (4, drive.at(4));
    for _ in 0..7 {
        drive.go(0.0);
        drive.make_place();
    }
    drive.go(FRAC_PI_2);
    let across = 20 - taken_for.len();
    drive.close(across, drive.at(across));
    drive
}

#[test]
fn what_is_driven_after_a_wrong_closure_stays_where_wheels_put_it() {
    for taken_for in [&[2][..], &[2, 3], &[2, 3, 4], &[2, 3, 4, 5]] {
        let drive = square(taken_for);
        let poses = drive.poses();
        let errors = (0..drive.truth.len()).map(|place| drive.error_m(&poses, place));
        let most_m = errors.fold(0.0, f64::max);
        assert!(most_m < 0.05, "{taken_for:?}: {most_m} m");
        // The closure, and the way from where it put the robot.
        let is_wrong = |link: &Link| {
            (link.from, link.to) == (PlaceId::new(10), PlaceId::from_index(taken_for[0]))
                || link.to == PlaceId::new(11)
        };
        let wrong: Vec<usize> =
            (0..).zip(&drive.links).filter(|(_, link)| is_wrong(link)).map(|(n, _)| n).collect();
        let contradicted: Vec<usize> = poses.contradicted().collect();
        assert_eq!(contradicted, wrong, "{taken_for:?}");
        let past: Vec<_> = poses.past_contradicted().collect();
        assert_eq!(past, [(PlaceId::new(10), PlaceId::new(11))], "{taken_for:?}");
        assert!(poses.measured_links().eq(drive.links.iter().copied()), "links are told as they were");
    }
}

#[test]
fn closures_that_hold_lose_nothing() {
    let drive = square(&[]);
    let poses = drive.poses();
    let errors = (0..drive.truth.len()).map(|place| drive.error_m(&poses, place));
    assert!(errors.fold(0.0, f64::max) < 1e-6);
    assert_eq!(poses.contradicted().count() + poses.past_contradicted().count(), 0);
}
