//! What counts as another visit, and which earlier frames speak for one: by the way that wheels say
//! the robot drove, however many images it took on it.

use nalgebra::Matrix3;
use posegraph::{PlanarPose, Pose};
use topomap::evidence::{Candidate, Placement, ProbabilityWeights, TwoView, VerificationSettings};
use topomap::ids::FrameId;
use topomap::in_memory::{self, Views};
use topomap::log::{FrameEvent, MapEvent, Reason};
use topomap::metric::{PlaceSpacing, RelativePose};
use topomap::settings::{GuardMeasure, MapperSettings};

use crate::rounds::{Camera, CameraModel, Robot};

/// Of a robot that drives 6 m straight on: the frames that show what is not within the guard, and those that close
/// a loop.
fn seen_again(settings: MapperSettings, step_m: f64) -> [usize; 2] {
    let mut robot = Robot::new(settings, [0.0; 2]);
    let mut frames = [0; 2];
    for _ in 0..(6.0 / step_m) as usize {
        let FrameEvent { decision, candidates, .. } = robot.see();
        let shows_any = candidates.iter().any(|candidate| candidate.own_evidence() > 0.0);
        frames[0] += usize::from(shows_any);
        frames[1] += usize::from(decision.reason == Reason::LoopClosure);
        robot.go(step_m, 0.0);
    }
    frames
}

#[test]
fn images_every_few_centimetres_close_no_loop_on_the_way() {
    let place_spacing = PlaceSpacing { distance_m: 0.3, ..PlaceSpacing::default() };
    // As if look-alikes were known to show next to nothing: the guard alone stands against closures.
    let weights = ProbabilityWeights { per_look_alike_nats: 20.0, ..ProbabilityWeights::default() };
    let verification = VerificationSettings { weights, ..VerificationSettings::default() };
    let settings =
        MapperSettings { guard_frames: 4, place_spacing, verification, ..MapperSettings::default() };
    let by_frames = MapperSettings { guard_measure: GuardMeasure::Frames, ..settings };
    assert!(seen_again(by_frames, 0.05)[0] > 10, "four frames are 20 cm: the robot sees where it just was");
    assert_eq!(seen_again(settings, 0.05), [0, 0]);
    // Where frames are as far apart as places, they are what is counted.
    assert_eq!(seen_again(settings, 0.3), seen_again(by_frames, 0.3));
}

/// What the robot takes an earlier frame to show.
#[derive(Clone, Copy)]
enum Measures {
    /// Where it is.
    Truth,
    /// That it stands where it was when it set out.
    Standing(PlanarPose),
    Nothing,
}

struct Measuring<'a> {
    robot: &'a Robot,
    measures: Measures,
}

impl Views for Measuring<'_> {
    fn compare(&self, earlier: FrameId) -> Option<TwoView> {
        let view = Camera { robot: self.robot, model: CameraModel::Known }.compare(earlier)?;
        let placed = |robot: &PlanarPose| {
            let pose = self.robot.truth[earlier as usize].inverse().compose(robot);
            let pose = RelativePose::new(pose, Matrix3::from_diagonal_element(1e-4)).unwrap();
            Placement::At { pose, inliers: 40 }
        };
        let placement = match &self.measures {
            Measures::Truth => placed(&self.robot.pose),
            Measures::Standing(pose) => placed(pose),
            Measures::Nothing => Placement::Unknown,
        };
        Some(TwoView { inliers: 100, distinct_inliers: 100, placement, ..view })
    }

    fn focal_length_widths(&self) -> Option<f64> {
        Some(0.8)
    }
}

/// What the frames before say for the last of some frames, at most, of a robot that drives a known way once
/// more. `measures` says what the robot measures, by where it sets out.
fn support(measures: fn(PlanarPose) -> Measures) -> f64 {
    let mut robot = Robot::new(MapperSettings::default(), [0.0; 2]);
    for _ in 0..12 {
        robot.see();
        robot.go(0.4, 0.0);
    }
    robot.pose = PlanarPose::new(1.6, 0.0, 0.0);
    robot.begin();
    let measures = measures(robot.pose);
    let frames: Vec<FrameEvent> = (0..5).map(|_| sees(&mut robot, measures)).collect();
    let last = frames.last().unwrap().candidates.iter();
    last.filter(|candidate| candidate.own_evidence() > 0.0)
        .map(|Candidate { support, .. }| *support)
        .fold(0.0, f64::max)
}

fn sees(robot: &mut Robot, measures: Measures) -> FrameEvent {
    let input = robot.input();
    let views = Measuring { robot, measures };
    let event = in_memory::decide(&robot.mapper, &robot.log, input, &views, &mut ()).unwrap().event;
    let logged = MapEvent::Frame(Box::new(event.clone()));
    assert_eq!(MapEvent::from_bytes(&logged.to_bytes(), crate::words::WORDS as usize).unwrap(), logged);
    robot.mapper.apply(&logged).unwrap();
    robot.log.push(logged);
    robot.truth.push(robot.pose);
    robot.go(0.3, 0.0);
    event
}

#[test]
fn earlier_frames_speak_for_where_wheels_lead() {
    let along_the_way = support(|_| Measures::Truth);
    assert!(along_the_way > 300.0, "four frames of some 90 inliers: {along_the_way}");
    // Each says that the robot stands, and wheels that it drives: the last one is too near to tell.
    let standing = support(Measures::Standing);
    assert!(standing < 150.0, "{standing}");
    let unmeasured = support(|_| Measures::Nothing);
    assert!(unmeasured > 300.0, "the robot may be there, and words say so: {unmeasured}");
}
