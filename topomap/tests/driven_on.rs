//! Robots with wheels that have driven on from a place, and still see it best.

use topomap::evidence::{Placement, Similarity, TwoView, VerificationSettings, ViewMotion};
use topomap::ids::FrameId;
use topomap::in_memory::{self, Views};
use topomap::log::{FrameEvent, MapEvent, Reason};
use topomap::mapper::AS_GOOD;
use topomap::settings::MapperSettings;

use posegraph::Pose;

use crate::rounds::{FOCAL_LENGTH_WIDTHS, Robot, view};

/// A camera that sees much from near, and less with each centimetre.
struct Near<'a>(&'a Robot);

impl Views for Near<'_> {
    fn compare(&self, earlier: FrameId) -> Option<TwoView> {
        let apart = self.0.truth[earlier as usize].inverse().compose(&self.0.pose);
        let inliers = (450.0 * (1.0 - apart.x_m().abs() / 0.9)).max(3.0) as u32;
        let motion = Similarity { rotation_rad: 0.0, ln_scale: 0.0, translation_widths: [0.0; 2] };
        let motion = (inliers > 3).then_some(ViewMotion::Similarity(motion));
        let placement = Placement::Unknown;
        Some(TwoView { matches: 500, inliers, distinct_inliers: inliers, motion, placement })
    }

    fn focal_length_widths(&self) -> Option<f64> {
        Some(FOCAL_LENGTH_WIDTHS)
    }
}

/// The robot takes a frame here, whose words are those of `metres` along the way.
fn see(robot: &mut Robot, metres: f64) -> FrameEvent {
    let mut input = robot.input();
    let there = posegraph::PlanarPose::new(metres, 0.0, 0.0);
    input.observation = view(&there, robot.sequence);
    let event = in_memory::decide(&robot.mapper, &robot.log, input, &Near(robot), &mut ()).unwrap().event;
    let logged = MapEvent::Frame(Box::new(event.clone()));
    robot.mapper.apply(&logged).unwrap();
    robot.log.push(logged);
    robot.truth.push(robot.pose);
    event
}

/// Places are 1.2 m apart. Halfway on from one, words say the next, and images show the last best: it is somewhere new, and
/// neither below the threshold nor another scene.
#[test]
fn a_frame_that_shows_best_where_the_robot_has_just_been_is_a_new_place() {
    // What the frames before have seen is the same for both.
    let verification = VerificationSettings { consistency_frames: 0, ..VerificationSettings::default() };
    let mut robot = Robot::new(MapperSettings { verification, ..MapperSettings::default() }, [0.0; 2]);
    for step in 0..6 {
        see(&mut robot, 1.2 * f64::from(step));
        robot.go(1.2, 0.0);
    }
    robot.pose = posegraph::PlanarPose::identity();
    robot.begin();
    for step in 0..3 {
        let event = see(&mut robot, 1.2 * f64::from(step));
        assert_eq!(event.decision.reason, Reason::LoopClosure, "step {step}");
        robot.go(if step == 2 { 0.55 } else { 1.2 }, 0.0);
    }
    let [last, next] = [2, 3].map(|place| robot.mapper.map().places()[place].frames[0].frame);
    let event = see(&mut robot, 3.6);
    let of = |frame| event.candidates.iter().find(|candidate| candidate.matched.frame == frame).unwrap();
    assert!(robot.mapper.verdict(of(next)).is_accepted(), "{:?}", of(next));
    assert!(of(next).evidence() < AS_GOOD * of(last).evidence());
    assert_eq!((event.decision.reason, event.decision.closure), (Reason::NewPlace, None));
    // That it is outdone is told.
    let outdone = robot.mapper.outdone_by(of(next), &event.candidates).unwrap();
    assert_eq!(outdone.matched.frame, last);
    assert_eq!(robot.mapper.outdone_by(of(last), &event.candidates), None);
}
