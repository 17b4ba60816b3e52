//! What the last frames of a session say for a candidate of this one.

use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;
use fabmap::recognizer::Association;
use nalgebra::{Matrix3, Vector3};
use posegraph::{PlanarPose, Pose};

use super::frame::FrameInHand;
use super::in_step::{Step, evidence_in_step};
use super::state::Mapper;
use crate::evidence::{Candidate, Placement};
use crate::map::{Measured, PlaceFrame, Placed, Sighting};
use crate::metric::{Odometry, PlaceSpacing, RelativePose};

/// Beyond so many squared standard deviations of three degrees of freedom, one in a hundred, wheels
/// do not lead from one measured pose to another.
const SAME_MOTION_CHI_SQUARED: f64 = 11.34;

/// Standard deviation of how two places that are near each other lie, beyond what wheels do not know,
/// as a share of the place spacing.
const BEND: f64 = 0.25;

/// Whether the robot can have gone from where it was seen to a candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Motion {
    /// Wheels lead from where it was measured to where it is.
    Leads,
    /// They may: at one end at least two views alone say where it is.
    MayLead,
    /// They lead elsewhere.
    Misleads,
    /// Places, or the robot's way, are not known in metres.
    Unmeasured,
}

impl FrameInHand<'_> {
    /// What the last frames of the session said for the candidate, in inliers: of each frame the
    /// strongest that is of one motion with it. Without metres frames count that follow an earlier
    /// drive in its order. What is not measured does not outvote words that say that the place is new.
    pub(super) fn support(&self, candidate: &Candidate) -> f64 {
        let Some(seen) = self.mapper.map().locate(candidate.matched.place, candidate.matched.frame) else {
            return 0.0;
        };
        let now = self.session.frames;
        let earliest = now.saturating_sub(self.mapper.settings().verification.consistency_frames);
        let words_say_new = self.input.odometry.is_some() && self.association == Association::New;
        let mut of_frames = BTreeMap::<u64, f64>::new();
        let mut unmeasured: Vec<&Sighting> = Vec::new();
        for sighting in self.session.sightings.iter().filter(|sighting| sighting.number >= earliest) {
            let speaks = match self.motion(sighting, candidate) {
                Motion::Leads => true,
                Motion::MayLead => !words_say_new,
                Motion::Misleads => false,
                Motion::Unmeasured => {
                    if !words_say_new {
                        unmeasured.push(sighting);
                    }
                    false
                }
            };
            if speaks {
                let strongest = of_frames.entry(sighting.number).or_default();
                *strongest = strongest.max(sighting.evidence);
            }
        }
        unmeasured.retain(|sighting| !of_frames.contains_key(&sighting.number));
        let steps: Vec<Step> =
            unmeasured.into_iter().flat_map(|sighting| self.steps(sighting, seen)).collect();
        of_frames.values().sum::<f64>() + evidence_in_step(steps, seen.number)
    }

    /// A sighting by all frames of its place from which the session of `seen` may have come there:
    /// who drives a way once more matches now frames of one drive, now those of another.
    fn steps(&self, sighting: &Sighting, seen: PlaceFrame) -> impl Iterator<Item = Step> {
        let place = self.mapper.map().places().get(sighting.place.index());
        let frames = place.map_or(&[][..], |place| &place.frames);
        let frames_ago = self.session.frames - sighting.number;
        let of_session = frames.iter().filter(move |frame| frame.session == seen.session);
        let evidence = sighting.evidence;
        of_session
            .map(move |frame| Step { frames_ago, number: frame.number, evidence })
            .filter(move |step| step.is_within_reach(seen.number))
    }

    fn motion(&self, sighting: &Sighting, candidate: &Candidate) -> Motion {
        let in_metres = self.input.odometry.is_some() && candidate.seen_from.is_some();
        if in_metres && sighting.placed.is_none() {
            // Structure denied that the robot was there.
            return Motion::Misleads;
        }
        let between = self.mapper.between(sighting.place, candidate.matched.place);
        let expected = sighting.placed.and_then(|then| self.driven_since(&then));
        let now = self.mapper.about(candidate);
        let (Some(between), Some(expected), Some(now)) = (between, expected, now) else {
            return Motion::Unmeasured;
        };
        let now = between.then(&now);
        let off = PlanarPose::error(expected.pose(), &PlanarPose::identity(), now.pose());
        let spread = (expected.covariance() + now.covariance()).try_inverse();
        if spread.is_none_or(|spread| off.dot(&(spread * off)) > SAME_MOTION_CHI_SQUARED) {
            return Motion::Misleads;
        }
        let then_measured = sighting.placed.is_some_and(|then| then.measured == Measured::ByStructure);
        if then_measured && candidate.placed().is_some() { Motion::Leads } else { Motion::MayLead }
    }

    /// Where wheels say that the robot is now, by where it was measured to be.
    fn driven_since(&self, then: &Placed) -> Option<RelativePose> {
        let now = PlanarPose::seen_from_above(self.input.odometry.as_ref()?.pose());
        let driven = self.mapper.settings().odometry_noise.of_motion(&then.wheels.inverse().compose(&now));
        Some(then.at.then(&driven))
    }
}

impl Mapper {
    /// What the session remembers of its frame `number` that was compared with `candidates`.
    pub(super) fn sightings(
        &self,
        number: u64,
        candidates: &[Candidate],
        odometry: Option<&Odometry>,
    ) -> Vec<Sighting> {
        let sighting = |candidate: &Candidate| {
            let evidence = candidate.own_evidence();
            let seen = self.map().locate(candidate.matched.place, candidate.matched.frame)?;
            let total_evidence = candidate.evidence();
            let place = candidate.matched.place;
            let placed = self.about(candidate).zip(odometry).map(|(at, odometry)| Placed {
                at,
                measured: match candidate.placed() {
                    Some(_) => Measured::ByStructure,
                    None => Measured::ByTwoViews,
                },
                wheels: PlanarPose::seen_from_above(odometry.pose()),
            });
            let sighting = Sighting { number, place, seen, evidence, total_evidence, placed };
            (evidence > 0.0).then_some(sighting)
        };
        candidates.iter().filter_map(sighting).collect()
    }

    /// Where in the frame of its place a candidate puts the robot: where structure measures it, or else
    /// about where the place was seen. `None` where structure denies it, or without metres.
    fn about(&self, candidate: &Candidate) -> Option<RelativePose> {
        let PlaceSpacing { distance_m, angle_rad } = self.settings().place_spacing.reach();
        match candidate.view.as_ref()?.placement {
            Placement::At { .. } => candidate.placed(),
            Placement::Nowhere => None,
            Placement::Unknown => {
                let sigmas = Vector3::new(distance_m, distance_m, angle_rad) / 2.0;
                let near = Matrix3::from_diagonal(&sigmas.map(|sigma| sigma * sigma));
                Some(candidate.seen_from?.then(&RelativePose::known(PlanarPose::identity(), near)))
            }
        }
    }

    /// The frame of a place in that of another; `None` if nothing measured leads from one to the
    /// other.
    fn between(&self, from: PlaceId, to: PlaceId) -> Option<RelativePose> {
        if from == to {
            return Some(RelativePose::none());
        }
        let poses = self.poses();
        let same_part = poses.part(from) == poses.part(to);
        let pose = poses.pose(from)?.inverse().compose(poses.pose(to).filter(|_| same_part)?);
        // Maps bend, and more so over longer ways.
        let bend = self.settings().place_spacing.covariance() * BEND.powi(2);
        let known = self.settings().odometry_noise.of_motion(&pose);
        Some(RelativePose::known(pose, known.covariance() + bend))
    }
}
