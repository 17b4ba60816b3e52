//! Robots that drive straight on, and see what is ahead of them for as long as it takes to get there.

use crate::words::{WORDS, model_of};
use fabmap::observation::Observation;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use topomap::evidence::{Placement, Similarity, TwoView, ViewMotion};
use topomap::ids::FrameId;
use topomap::in_memory::{self, Views};
use topomap::log::{FrameEvent, MapEvent, Reason};
use topomap::mapper::{FrameInput, Mapper};
use topomap::metric::Odometry;
use topomap::settings::MapperSettings;

/// How far ahead things are seen, and how far a robot drives from frame to frame.
const SIGHT_M: f64 = 45.0;
const STEP_M: f64 = 1.2;

/// What is seen from so far along the street: six words of each metre ahead.
fn seen_from(metres: f64, noise: &mut ChaCha8Rng) -> Observation {
    let mut words = Vec::new();
    for metre in 0..SIGHT_M as u64 {
        let mut own = ChaCha8Rng::seed_from_u64(metres as u64 + metre);
        words.extend((0..6).map(|_| own.random_range(0..WORDS)));
    }
    words.retain(|_| noise.random_bool(0.7));
    words.extend((0..6).map(|_| noise.random_range(0..WORDS)));
    Observation::from_words(words, WORDS as usize).unwrap()
}

/// A robot on a street, and where its frames were taken along it.
struct Drive {
    mapper: Mapper,
    log: Vec<MapEvent>,
    /// By event.
    metres: Vec<f64>,
}

/// What the next frame shows of earlier ones.
struct View<'a> {
    earlier_m: &'a [f64],
    now_m: f64,
}

impl Views for View<'_> {
    /// The further behind, the larger things are by now, and the fewer of them are recognised.
    fn compare(&self, earlier: FrameId) -> Option<TwoView> {
        let driven_m = self.now_m - self.earlier_m[earlier as usize];
        let share = 1.0 - driven_m.abs() / SIGHT_M;
        let inliers = if share > 0.0 { 3 + (120.0 * share) as u32 } else { 3 };
        let motion =
            Similarity { rotation_rad: 0.0, ln_scale: driven_m / SIGHT_M, translation_widths: [0.0, 0.0] };
        let motion = (share > 0.0).then_some(ViewMotion::Similarity(motion));
        let placement = Placement::Unknown;
        Some(TwoView { matches: 300, inliers, distinct_inliers: inliers, motion, placement })
    }

    fn focal_length_widths(&self) -> Option<f64> {
        None
    }
}

impl Drive {
    fn new() -> Self {
        let noise = |place: u64| ChaCha8Rng::seed_from_u64(1_000_000 + place);
        let elsewhere = (0..200).map(|place| seen_from(10_000.0 + 60.0 * place as f64, &mut noise(place)));
        let mut mapper =
            Mapper::new(&model_of(elsewhere.collect(), WORDS), MapperSettings::default()).unwrap();
        let opened = MapEvent::SessionOpened { session: 0 };
        mapper.apply(&opened).unwrap();
        Self { mapper, log: vec![opened], metres: vec![f64::NEG_INFINITY] }
    }

    /// A frame from so far along the street, of which wheels say that it is `odometry_m` along the robot's way.
    fn see(&mut self, now_m: f64, odometry_m: Option<f64>) -> FrameEvent {
        let sequence = self.log.len() as u64;
        let on_the_way = |x| Odometry::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], None).unwrap();
        let input = FrameInput {
            session: 0,
            sequence,
            stamp_ns: sequence as i64 * 100_000_000,
            odometry: odometry_m.map(on_the_way),
            observation: seen_from(now_m, &mut ChaCha8Rng::seed_from_u64(sequence)),
        };
        let view = View { earlier_m: &self.metres, now_m };
        let event = in_memory::decide(&self.mapper, &self.log, input, &view, &mut ()).unwrap().event;
        let logged = MapEvent::Frame(Box::new(event.clone()));
        self.mapper.apply(&logged).unwrap();
        self.log.push(logged);
        self.metres.push(now_m);
        event
    }
}

/// Of a frame by its number: where wheels put it, in steps.
type Heard = fn(u32) -> Option<u32>;

const HEARD: [(&str, Heard); 6] = [
    ("all along", Some),
    ("never", |_| None),
    ("first", |frame| (frame < 20).then_some(frame)),
    ("at last", |frame| (frame >= 20).then_some(frame)),
    ("but for ten frames", |frame| (!(20..30).contains(&frame)).then_some(frame)),
    ("as if the robot stood", |frame| Some(frame.min(20))),
];

#[test]
fn what_a_robot_has_in_sight_all_along_closes_no_loop() {
    for (heard, odometry) in HEARD {
        let mut drive = Drive::new();
        for frame in 0..50 {
            let metres = |frame| STEP_M * f64::from(frame);
            let decision = drive.see(metres(frame), odometry(frame).map(metres)).decision;
            assert_ne!(
                decision.reason,
                Reason::LoopClosure,
                "wheels heard {heard}: frame {frame}, {decision:?}"
            );
        }
    }
}

#[test]
fn what_it_had_lost_sight_of_does() {
    for (heard, odometry) in HEARD {
        let mut drive = Drive::new();
        let metres = |frame| STEP_M * f64::from(frame);
        // Up the street, and once more from its begin. Wheels fall silent at last.
        let (mut closures, mut recognised) = (0, 0);
        for frame in 0..160 {
            let along_m = if frame < 80 { metres(frame) } else { metres(frame - 80) };
            let odometry = odometry(frame).map(metres).filter(|_| frame < 50);
            let before = drive.mapper.map().places().len();
            let decision = drive.see(along_m, odometry).decision;
            let known = decision.place.is_some_and(|place| place.index() < before);
            recognised += u32::from(frame >= 80 && known);
            let Some(closure) = decision.closure.filter(|_| decision.reason == Reason::LoopClosure) else {
                continue;
            };
            let apart_m = drive.metres[closure.frame as usize] - along_m;
            assert!(
                frame >= 80 && apart_m.abs() < SIGHT_M / 3.0,
                "wheels heard {heard}: frame {frame}, {apart_m} m"
            );
            closures += 1;
        }
        assert!(closures > 0 && recognised > 60, "wheels heard {heard}: {closures}, {recognised} of 80");
    }
}
