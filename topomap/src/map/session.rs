//! One run of one robot, as far as it has come: what its next frame starts from.

use std::collections::VecDeque;

use fabmap::appearance::PlaceId;
use fabmap::place_filter::Belief;
use posegraph::{PlanarPose, Pose};

use super::PlaceFrame;
use super::milestones::Milestones;
use crate::evidence::{Compared, LookAlikesSeen};
use crate::log::{FrameEvent, Resumed, Stood};
use crate::metric::{Odometry, RelativePose};
use crate::settings::{GuardMeasure, MAX_PAST_FRAMES, MapperSettings};

/// One run of one robot, as far as it has come.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// Frames so far.
    pub frames: u64,
    /// Sequence number of the last frame.
    pub last_sequence: Option<u64>,
    /// Stamp of the last frame.
    pub last_stamp_ns: Option<i64>,
    /// The last odometry, with its frame's stamp.
    pub last_odometry: Option<(i64, Odometry)>,
    /// Where the session is.
    pub stay: Option<Stay>,
    /// Places left a short while ago.
    pub left: VecDeque<LeftPlace>,
    /// What the next frame starts from.
    pub belief: Belief,
    /// What geometry found for the last frames, oldest first; empty where nothing is verified.
    pub sightings: VecDeque<Sighting>,
    /// The last frames with odometry, latest first; empty where none is measured.
    pub past: VecDeque<Past>,
    /// Where wheels go on from: the last frame that was surely somewhere.
    pub anchor: Option<Anchor>,
    /// How far it has come; empty where the guard counts frames.
    pub milestones: Milestones,
    /// What look-alikes show where it drives.
    pub look_alikes: LookAlikesSeen,
}

/// A frame whose place was not only recognised: where in it the robot was is known to within a
/// place spacing.
#[derive(Clone, Debug, PartialEq)]
pub struct Anchor {
    /// The place.
    pub place: PlaceId,
    /// Odometry of the frame.
    pub odometry: Odometry,
    /// Where in the place's frame the robot was.
    pub at: RelativePose,
}

/// What a session believed at an earlier frame, and where its wheels put it then.
#[derive(Clone, Debug, PartialEq)]
pub struct Past {
    /// Odometry of the frame.
    pub odometry: Odometry,
    /// What it carried on.
    pub belief: Belief,
}

/// An earlier frame that one of a session's last frames has evidence for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Number of the session's frame that saw it, from 0.
    pub number: u64,
    /// The place that was seen.
    pub place: PlaceId,
    /// The frame of it.
    pub seen: PlaceFrame,
    /// What the two frames say by themselves.
    pub evidence: f64,
    /// What they say with the frames before.
    pub total_evidence: f64,
    /// Where that put the robot; `None` without odometry, or where the map has no metres.
    pub placed: Option<Placed>,
}

/// Where a robot was seen to be, and where its wheels put it then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// In the frame of the place that was seen.
    pub at: RelativePose,
    /// Who says so.
    pub measured: Measured,
    /// In the session's odom frame, seen from above.
    pub wheels: PlanarPose,
}

/// How well it is known where a robot was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measured {
    /// Features of known depth say so.
    ByStructure,
    /// Two views are of one scene: it was about there.
    ByTwoViews,
}

/// Consecutive frames at one place.
#[derive(Clone, Debug, PartialEq)]
pub struct Stay {
    /// The place.
    pub place: PlaceId,
    /// Looks that the place has learnt from this stay.
    pub looks: u32,
    /// Odometry of the stay's last frame.
    pub odometry: Option<Odometry>,
    /// Where in the place's frame the robot was then, if that was measured.
    pub at: Option<RelativePose>,
}

/// A place that a session has just left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LeftPlace {
    /// The place.
    pub place: PlaceId,
    /// The number of the session's first frame elsewhere.
    pub number: u64,
    /// Looks learnt there; coming back soon continues the stay.
    pub looks: u32,
}

impl Sighting {
    fn compared(&self) -> Compared {
        let Self { seen, evidence, total_evidence, .. } = *self;
        Compared { seen: (seen.session, seen.number), evidence, total_evidence }
    }
}

impl Session {
    /// A session without a frame.
    pub(crate) fn new() -> Self {
        Self {
            frames: 0,
            last_sequence: None,
            last_stamp_ns: None,
            last_odometry: None,
            stay: None,
            left: VecDeque::new(),
            belief: Belief::unknown(),
            sightings: VecDeque::new(),
            past: VecDeque::new(),
            anchor: None,
            milestones: Milestones::default(),
            look_alikes: LookAlikesSeen::default(),
        }
    }

    /// Whether the session is at the place, or has left it within the guard.
    #[must_use]
    pub fn is_near(&self, place: PlaceId, settings: &MapperSettings) -> bool {
        self.since(place, settings).is_some()
    }

    /// Whether one of its frames is within the guard.
    #[must_use]
    pub fn is_guarded(&self, frame: u64, settings: &MapperSettings) -> bool {
        self.since_frame(frame, settings).is_some()
    }

    /// Looks that `place` has learnt from the stay there that is going on or was just interrupted.
    #[must_use]
    pub fn looks_of_stay(&self, place: PlaceId, settings: &MapperSettings) -> u32 {
        match &self.stay {
            Some(stay) if stay.place == place => stay.looks,
            Some(_) | None => {
                self.left_lately(settings).find(|left| left.place == place).map_or(0, |left| left.looks)
            }
        }
    }

    /// How far the session has gone since it was at `place`, as the guard measures it, if it is there
    /// or left it within the guard.
    #[must_use]
    pub fn since(&self, place: PlaceId, settings: &MapperSettings) -> Option<f64> {
        match &self.stay {
            Some(stay) if stay.place == place => Some(0.0),
            Some(_) | None => {
                let left = self.left.iter().find(|left| left.place == place)?;
                self.since_frame(left.number, settings)
            }
        }
    }

    /// How far the session has gone altogether, as the guard measures it.
    #[must_use]
    pub fn gone(&self, settings: &MapperSettings) -> f64 {
        match settings.guard_measure {
            GuardMeasure::Frames => self.frames as f64,
            GuardMeasure::Way => self.milestones.way_spacings,
        }
    }

    /// How far the session has gone since the frame before this one, if that is within the guard:
    /// the way to the frame that is looked at is not known yet.
    fn since_frame(&self, frame: u64, settings: &MapperSettings) -> Option<f64> {
        let gone = match settings.guard_measure {
            GuardMeasure::Frames => (self.frames - frame) as f64,
            GuardMeasure::Way => match frame.checked_sub(1) {
                Some(before) => self.milestones.since(before)?,
                None => self.milestones.way_spacings,
            },
        };
        (gone < settings.guard_frames as f64).then_some(gone)
    }

    /// Folds a frame of this session in.
    pub(crate) fn follow(&mut self, event: &FrameEvent, settings: &MapperSettings, sightings: Vec<Sighting>) {
        if let Some(place) = event.decision.place {
            self.arrive(place, event, settings);
            if let (Some(odometry), Some(at)) = (&event.odometry, event.at)
                && at.position_sigma_m() <= settings.place_spacing.distance_m
            {
                self.anchor = Some(Anchor { place, odometry: odometry.clone(), at });
            }
        }
        if let Some(expected_inliers) = event.look_alike_inliers {
            let compared: Vec<Compared> = sightings.iter().map(Sighting::compared).collect();
            self.look_alikes.follow(expected_inliers, event.observation.len(), &compared);
        }
        let earliest = (self.frames + 1).saturating_sub(settings.verification.consistency_frames.max(1));
        self.sightings.retain(|sighting| sighting.number >= earliest);
        self.sightings.extend(sightings);
        self.pass_milestone(event.odometry.as_ref(), settings);
        self.frames += 1;
        self.last_sequence = Some(event.sequence);
        self.last_stamp_ns = Some(event.stamp_ns);
        if let Some(odometry) = &event.odometry {
            self.last_odometry = Some((event.stamp_ns, odometry.clone()));
        }
        self.belief = event.belief.clone();
        if let (Some(odometry), Some(_)) = (&event.odometry, &event.at) {
            self.past.push_front(Past { odometry: odometry.clone(), belief: event.belief.clone() });
            self.past.truncate(MAX_PAST_FRAMES);
        }
    }

    /// Says better where the session's last frame was taken, within the place that it is at.
    pub(super) fn go_on_from(&mut self, place: PlaceId, odometry: &Odometry, at: RelativePose) {
        if let Some(stay) = &mut self.stay {
            stay.odometry = Some(odometry.clone());
            stay.at = Some(at);
        }
        self.anchor = Some(Anchor { place, odometry: odometry.clone(), at });
    }

    /// Goes back to where the session was before it came to a place that it was not at. What it
    /// believed since then rests on that, too.
    pub(super) fn resume(&mut self, not_at: PlaceId, resumed: &Resumed, settings: &MapperSettings) {
        let Resumed { stay, anchor } = resumed;
        self.stay = stay.clone().map(|Stood { place, odometry, at }| {
            let looks = self.looks_of_stay(place, settings);
            Stay { place, looks, odometry, at }
        });
        let stay = self.stay.as_ref().map(|stay| stay.place);
        self.left.retain(|left| Some(left.place) != stay && left.place != not_at);
        self.anchor = anchor
            .clone()
            .and_then(|Stood { place, odometry, at }| Some(Anchor { place, odometry: odometry?, at: at? }));
        self.belief = Belief::unknown();
        self.past.clear();
        self.sightings.retain(|sighting| sighting.place != not_at);
    }

    fn left_lately(&self, settings: &MapperSettings) -> impl Iterator<Item = &LeftPlace> {
        self.left.iter().filter(|left| self.is_guarded(left.number, settings))
    }

    fn pass_milestone(&mut self, odometry: Option<&Odometry>, settings: &MapperSettings) {
        if settings.guard_measure == GuardMeasure::Frames {
            return;
        }
        let step = match (&self.last_odometry, odometry) {
            (Some((_, before)), Some(now)) => {
                let [before, now] =
                    [before, now].map(|odometry| PlanarPose::seen_from_above(odometry.pose()));
                settings.place_spacing.way(&before.inverse().compose(&now)).min(1.0)
            }
            (None, _) | (Some(_), None) => 1.0,
        };
        self.milestones.pass(self.frames, step, settings.guard_frames as f64);
    }

    fn arrive(&mut self, place: PlaceId, event: &FrameEvent, settings: &MapperSettings) {
        let number = self.frames;
        let looks = self.looks_of_stay(place, settings) + u32::from(event.learnt);
        let odometry = event.odometry.clone();
        let at = event.at;
        let before = self.stay.replace(Stay { place, looks, odometry, at });
        if let Some(before) = before.filter(|before| before.place != place) {
            let kept = |left: &LeftPlace| left.place != place && self.is_guarded(left.number, settings);
            self.left = self.left.iter().copied().filter(kept).collect();
            self.left.push_back(LeftPlace { place: before.place, number, looks: before.looks });
        }
    }
}
