//! Whether a robot's odometry goes with its images and with what was driven before, over the last frames of its session.

use topomap::ids::SessionId;
use topomap::log::FrameEvent;
use topomap::metric::{Agreement, AgreementVerdict, Odometry, OdometryNoise, RelativePose};

use crate::ingest::{RobotCamera, Tracker};
use crate::open_map::SeenFeatures;

/// Frames that are looked back on.
pub(super) const MOST_FRAMES: usize = Tracker::MAX_FRAMES + 1;

/// Ways shorter than this, in metres, say little of a scale: their ends are measured to centimetres.
const LEAST_WAY_M: f64 = 1.0;

/// What is said of images that hardly change.
const HARDLY_MOVES: &str = "over ways of metres by its odometry images hardly change, as if most of what it sees were more \
                            than 150 m away: are its positions in centimetres or millimetres, and not in metres?";

/// A frame that was seen to be near an earlier one.
pub(super) struct SeenAgain {
    /// Session of the earlier frame, and its odometry.
    pub(super) session: SessionId,
    pub(super) then: Odometry,
    /// The frame's own odometry.
    pub(super) now: Odometry,
    /// Where the robot was now, seen from where it was then.
    pub(super) pose: RelativePose,
}

/// How odometry goes with the rest, as far as that is known.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct OdometryAgreement {
    /// Turns by images, beside those by odometry.
    pub(crate) turns: Option<Agreement>,
    /// Ways by what odometry said when they were driven before, beside those by odometry now.
    pub(crate) ways: Option<Agreement>,
    /// What is wrong and how to mend it; empty if nothing seems to be.
    pub(crate) finding: String,
}

impl OdometryAgreement {
    /// Over a session's last frames, oldest first: what each showed, and those that were seen again. `None`
    /// if nothing can be said.
    pub(super) fn of(
        noise: OdometryNoise,
        frames: &[FrameEvent],
        seen: &[Option<SeenFeatures>],
        seen_again: &[SeenAgain],
    ) -> Option<Self> {
        let tracker = tracked(noise, frames, seen);
        let turns = tracker.turning();
        let ways = Agreement::of(ways(noise, seen_again));
        let camera = seen.last().and_then(Option::as_ref).and_then(SeenFeatures::field_of_view_rad);
        let findings = [
            turns.as_ref().and_then(|turns| turns_finding(turns, camera)),
            ways.as_ref().and_then(ways_finding),
            tracker.hardly_moves().then(|| HARDLY_MOVES.to_owned()),
        ];
        let finding = findings.into_iter().flatten().collect::<Vec<_>>().join("; ");
        (turns.is_some() || ways.is_some() || !finding.is_empty()).then_some(Self { turns, ways, finding })
    }
}

fn tracked(noise: OdometryNoise, frames: &[FrameEvent], seen: &[Option<SeenFeatures>]) -> Tracker {
    let mut tracker = Tracker::new(noise);
    for (frame, seen) in frames.iter().zip(seen) {
        // Of a frame that showed nothing no features are kept, and a robot's own tracker passes over it.
        let Some(seen) = seen else { continue };
        let camera: Option<&RobotCamera> = seen.camera.as_ref();
        tracker.track(seen.features.clone(), camera, frame.odometry.as_ref());
    }
    tracker
}

/// From each frame to the next one that is far enough: how many times as long the way was by the odometry of
/// the session that drove there before. (By depths it would be less clear: those of this session
/// have its own scale.)
fn ways(noise: OdometryNoise, seen_again: &[SeenAgain]) -> impl Iterator<Item = f64> {
    (0..seen_again.len()).filter_map(move |index| {
        let from = &seen_again[index];
        seen_again[index + 1..].iter().filter(|to| to.session == from.session).find_map(|to| {
            let now_m = length_m(&noise.between(&from.now, &to.now));
            let then = noise.between(&from.then, &to.then);
            let then_m = length_m(&from.pose.back().then(&then).then(&to.pose));
            (now_m >= LEAST_WAY_M).then_some(then_m / now_m)
        })
    })
}

fn length_m(motion: &RelativePose) -> f64 {
    motion.pose().x_m().hypot(motion.pose().y_m())
}

fn turns_finding(turns: &Agreement, field_of_view_rad: Option<f64>) -> Option<String> {
    let Agreement { compared, ratio, .. } = turns;
    match turns.verdict() {
        AgreementVerdict::Alike => None,
        AgreementVerdict::OfAnotherScale if *ratio <= 0.0 => Some(format!(
            "at the last {compared} turns images turned the other way than odometry: headings grow to the left, \
             seen from above, and images must not be mirrored"
        )),
        AgreementVerdict::OfAnotherScale => {
            let declared = field_of_view_rad.map(|declared_rad| {
                let agreeing_rad = 2.0 * ((declared_rad / 2.0).tan() / ratio).atan();
                format!(
                    ", declared as {:.0} degrees ({:.0} would agree)",
                    declared_rad.to_degrees(),
                    agreeing_rad.to_degrees()
                )
            });
            Some(format!(
                "at the last {compared} turns images turned {ratio:.2} times as far as odometry: check the camera's \
                 horizontal field of view{}, or the odometry's turns",
                declared.unwrap_or_default()
            ))
        }
        AgreementVerdict::OutOfStep => Some(format!(
            "at the last {compared} turns images turned now further than odometry and now less far: send with \
             each image the odometry of the moment at which it was taken, and headings in radians; or the declared field of \
             view is far off"
        )),
    }
}

fn ways_finding(ways: &Agreement) -> Option<String> {
    let Agreement { compared, ratio, .. } = ways;
    match ways.verdict() {
        AgreementVerdict::Alike => None,
        AgreementVerdict::OfAnotherScale => Some(format!(
            "the last {compared} ways had been driven before, and odometry made them {ratio:.2} times as long then as \
             now: check the odometry's scale, in this session and in the one that mapped these places"
        )),
        AgreementVerdict::OutOfStep => Some(format!(
            "the last {compared} ways had been driven before, and odometry made some longer then and others \
             shorter: wheels slip, or images and odometry are not of the same moments"
        )),
    }
}
