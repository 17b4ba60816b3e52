//! The second step of a frame: of each place in question the best matching frame, and the views
//! that are to be compared.

use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;
use fabmap::recognizer::Association;

use super::frame::{FrameInHand, Growth};
use super::recognizing::{EarlierFrames, Recognized};
use crate::evidence::{Match, TurnedView, TwoView};
use crate::ids::FrameId;
use crate::metric::RelativePose;
use crate::settings::{MAX_PAST_FRAMES, PlaceRule};

/// Frames at one place without a turn of the wheels that say nothing against them.
const STANDING_FRAMES: u64 = 30;

/// A frame whose best matches are known: it waits for the comparison of views.
#[derive(Clone, Debug)]
pub struct Proposed<'a> {
    pub(super) frame: FrameInHand<'a>,
    /// Of the places that views are compared with, the frames to compare.
    pub(super) compared: Vec<EarlierMatch>,
    /// Of all places in question.
    matches: BTreeMap<PlaceId, EarlierMatch>,
    pub(super) wanted: WantedViews,
}

/// An earlier frame that matches, and where in its place's frame the robot was then, if that was
/// measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct EarlierMatch {
    pub(super) matched: Match,
    pub(super) at: Option<RelativePose>,
}

/// The comparisons with earlier views that a decision needs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WantedViews {
    /// Frames that the current view is to be compared with, each once.
    pub compared: Vec<FrameId>,
    /// The frame of which it is wanted whether the robot has at most turned on the spot since.
    pub turned: Option<FrameId>,
    /// Of `compared`, the last frame of the place where the robot may have stayed.
    pub(super) stayed: Option<FrameId>,
    /// Of `compared`, by place, what the session took between there and now.
    pub(super) between: BTreeMap<PlaceId, FrameId>,
}

/// What the comparisons found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Comparisons {
    /// By earlier frame; frames that have no keypoints, and all if the current one has none, are
    /// left out.
    pub views: BTreeMap<FrameId, TwoView>,
    /// Of [`WantedViews::turned`]; `None` if one of the two does not show all around.
    pub turned: Option<TurnedView>,
    /// Focal length of the current frame's camera along x, in image widths; `None` if its model is
    /// not known.
    pub focal_length_widths: Option<f64>,
}

impl<'a> Recognized<'a> {
    /// Takes what the wanted frames showed, and finds of each place in question the frame that
    /// matches best.
    #[must_use]
    pub fn propose(self, earlier: &EarlierFrames) -> Proposed<'a> {
        let Recognized { frame, compared, wanted } = self;
        let best = |(place, frames): (PlaceId, Vec<FrameId>)| {
            frame.best_match(place, &frames, earlier).map(|best| (place, best))
        };
        let matches: BTreeMap<PlaceId, EarlierMatch> = wanted.into_iter().filter_map(best).collect();
        let compared: Vec<EarlierMatch> =
            compared.iter().filter_map(|place| matches.get(place)).copied().collect();
        let wanted = frame.wanted_views(&compared);
        Proposed { frame, compared, matches, wanted }
    }
}

impl Proposed<'_> {
    /// The comparisons that are wanted to go on.
    #[must_use]
    pub fn wanted_views(&self) -> &WantedViews {
        &self.wanted
    }

    /// The best matching frame of a place that is known from before the guard.
    pub(super) fn match_at(&self, place: PlaceId) -> Option<Match> {
        self.matches.get(&place).map(|best| best.matched)
    }

    /// The best matching frame of the most probable place known from before the guard; of equal
    /// ones the first.
    pub(super) fn most_probable_match(&self) -> Option<Match> {
        let by_posterior =
            |best: Match, next: Match| if next.posterior > best.posterior { next } else { best };
        self.matches.values().map(|best| best.matched).reduce(by_posterior)
    }
}

impl FrameInHand<'_> {
    /// Of a place's frames the one that matches best.
    fn best_match(
        &self,
        place: PlaceId,
        frames: &[FrameId],
        earlier: &EarlierFrames,
    ) -> Option<EarlierMatch> {
        let model = self.mapper.recognizer().index().model();
        let single_looks = model.single_looks(&self.input.observation);
        let mut best: Option<(f64, FrameId, Option<RelativePose>)> = None;
        for &frame in frames {
            let Some(seen) = earlier.get(&frame) else { continue };
            let log_likelihood = single_looks.log_likelihood(&seen.observation);
            if best.is_none_or(|(best, ..)| log_likelihood > best) {
                best = Some((log_likelihood, frame, seen.at));
            }
        }
        let posterior = &self.recognition.posterior;
        best.map(|(_, frame, at)| EarlierMatch {
            matched: Match {
                place,
                posterior: posterior.places[place.index()],
                log_odds: posterior.log_odds(place),
                frame,
            },
            at,
        })
    }

    fn wanted_views(&self, compared: &[EarlierMatch]) -> WantedViews {
        let stayed = self.frame_to_have_stayed_at();
        let mut frames: Vec<FrameId> = compared.iter().map(|best| best.matched.frame).collect();
        let between = self.frames_between(compared);
        for frame in stayed.into_iter().chain(between.values().copied()) {
            if !frames.contains(&frame) {
                frames.push(frame);
            }
        }
        WantedViews { compared: frames, turned: self.frame_to_have_turned_at(), stayed, between }
    }

    /// The place that is the most probable of all, where the session is or has just been and the
    /// robot still is as far as wheels tell.
    pub(super) fn place_to_stay_at(&self) -> Option<PlaceId> {
        let Association::Seen(place) = self.association else { return None };
        let stays = !self.shows_too_little()
            && self.was_just_at(place)
            && self.pose_of_robot().is_none_or(|robot| self.mapper.is_at(&robot, place));
        stays.then_some(place)
    }

    /// What the session saw last of the place where it may have stayed; `None` also where nothing
    /// is verified.
    fn frame_to_have_stayed_at(&self) -> Option<FrameId> {
        let asks = self.mapper.verifies() && !self.makes_each_frame_a_place();
        let frames = self.frames_of(self.place_to_stay_at().filter(|_| asks)?);
        let last = frames.iter().rev().find(|frame| frame.session == self.input.session)?;
        Some(last.frame)
    }

    /// The first of the session's frames at the place where it is, if the view has to say whether
    /// the robot is still there: not the last one, or a robot that creeps would never leave.
    fn frame_to_have_turned_at(&self) -> Option<FrameId> {
        let stay = self.session.stay.as_ref()?;
        let views_tell =
            self.makes_each_frame_a_place() && !self.shows_too_little() && !self.is_at_its_stay();
        if !views_tell && !self.wheels_seem_to_stand_at(stay.place) {
            return None;
        }
        let first = self.frames_of(stay.place).iter().find(|frame| frame.session == self.input.session)?;
        Some(first.frame)
    }

    /// Whether the frame is to make a place whatever is recognised.
    pub(super) fn makes_each_frame_a_place(&self) -> bool {
        self.growth == Growth::Grows && self.mapper.settings().place_rule == PlaceRule::EachFrame
    }

    /// Whether wheels say that the robot is where the session was at its last frame.
    pub(super) fn is_at_its_stay(&self) -> bool {
        let (Some(robot), Some(stay)) = (self.pose_of_robot(), &self.session.stay) else { return false };
        self.mapper.is_at(&robot, stay.place)
    }

    /// Frames since the robot came to where it is, this one included.
    pub(super) fn frames_since_it_came(&self) -> u64 {
        self.session.frames + 1 - self.session.left.back().map_or(0, |left| left.number)
    }

    /// Whether wheels have not turned for long, while the frame looks like somewhere else than
    /// `place`.
    pub(super) fn wheels_seem_to_stand_at(&self, place: PlaceId) -> bool {
        let Some(now) = self.input.odometry.as_ref().filter(|_| self.growth == Growth::Grows) else {
            return false;
        };
        let looks_like_here = match self.association {
            Association::Seen(seen) => {
                self.was_just_at(seen) || self.mapper.map().linked(place).contains(&seen)
            }
            Association::New => false,
        };
        let past = &self.session.past;
        let stands =
            past.len() == MAX_PAST_FRAMES && past.iter().all(|past| past.odometry.pose() == now.pose());
        stands && self.frames_since_it_came() > STANDING_FRAMES && !looks_like_here
    }
}
