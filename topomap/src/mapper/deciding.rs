//! The last step of a frame: what it is, decided from values alone.

use fabmap::appearance::PlaceId;
use fabmap::recognizer::{Association, Recognition};

use super::FrameError;
use super::candidates::{HALF_AS_GOOD, is_without_keypoints, lacks_probability_alone, most_likely};
use super::frame::{FrameInHand, FrameInput, Growth};
use super::localizer::Queried;
use super::poses::Located;
use super::proposing::{Comparisons, EarlierMatch, Proposed};
use crate::evidence::{Candidate, Check, Match, TurnedView, TwoView, over_frames, unknown_over_frames};
use crate::log::{Decision, FrameEvent, Link, LinkKind, Reason};
use crate::settings::MapperSettings;

/// What was decided of a frame, with what is not logged of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Decided {
    /// What is to be logged.
    pub event: FrameEvent,
    /// Likelihoods, prior and posterior behind it.
    pub recognition: Recognition,
}

impl Proposed<'_> {
    /// Decides what a frame is: the story, from what was compared to the event that the log keeps.
    /// Changes nothing.
    ///
    /// # Errors
    /// [`FrameError::OdometryStandsStill`] if wheels say that the robot stands, and the view that
    /// it does not.
    pub fn decide(self, comparisons: &Comparisons) -> Result<Decided, FrameError> {
        let candidates = self.candidates(comparisons);
        let proposal = self.proposal(&candidates);
        let decision = if self.frame.makes_each_frame_a_place() {
            self.place_of_its_own(comparisons)
        } else {
            self.associate(&candidates, comparisons)
        };
        self.frame.check_that_wheels_turn(&decision, comparisons)?;
        let located = self.locate(&decision, &candidates, comparisons);
        let FrameInHand { mapper, session, growth, input, recognition, look_alike_inliers, .. } = self.frame;
        let (learnt, link) = match growth {
            Growth::Grows => (
                mapper.learns(&session, &decision),
                mapper.link(&session, &decision, input.odometry.as_ref(), located),
            ),
            Growth::ReadOnly => (false, None),
        };
        let places = mapper.recognizer().places();
        let belief = decision.belief_after(&session.belief, &recognition.posterior, places);
        let new_place_posterior = decision.new_place_posterior(&session.belief, &recognition.posterior);
        let FrameInput { session, sequence, stamp_ns, odometry, observation } = input;
        let event = FrameEvent {
            frame: mapper.map().events(),
            session,
            sequence,
            stamp_ns,
            odometry,
            observation,
            decision,
            new_place_posterior,
            proposal,
            candidates,
            learnt,
            link,
            at: located.map(|located| located.at()),
            belief,
            look_alike_inliers,
        };
        Ok(Decided { event, recognition })
    }

    /// Where one observation was made, for what [`super::Mapper::query`] began.
    #[must_use]
    pub fn answer(self, comparisons: &Comparisons) -> Queried {
        let candidates = self.candidates(comparisons);
        let mapper = self.frame.mapper;
        let settings = self.settings(comparisons);
        let verified = mapper.verified(&settings, &self.frame, &candidates);
        let candidate = verified.or_else(|| most_likely(&candidates)).map(|candidate| candidate.matched);
        let best = self.frame.recognition.posterior.best_place();
        let matched = candidate.or_else(|| best.and_then(|(place, _)| self.match_at(place)));
        let by_words = |matched: Match| {
            self.frame.association == Association::Seen(matched.place)
                && matched.posterior >= mapper.settings().closure_threshold
                && (!mapper.verifies() || is_without_keypoints(&candidates, matched.place))
        };
        let accepted = verified.is_some() || matched.is_some_and(by_words);
        Queried { recognition: self.frame.recognition, candidates, matched, accepted }
    }

    /// What views have to show for this frame, by its wheels and its camera.
    fn settings(&self, comparisons: &Comparisons) -> MapperSettings {
        let FrameInHand { mapper, input, .. } = &self.frame;
        mapper.settings().for_frame(input.odometry.as_ref(), comparisons.focal_length_widths)
    }

    /// The compared places, with what speaks for them.
    fn candidates(&self, comparisons: &Comparisons) -> Vec<Candidate> {
        let settings = self.frame.mapper.settings().verification;
        let frames = self.frame.session.frames.min(settings.consistency_frames);
        let of_frame = self.frame.look_alike_inliers;
        let look_alikes = of_frame.map_or_else(unknown_over_frames, |inliers| over_frames(inliers, frames));
        let candidate = |&EarlierMatch { matched, at }: &EarlierMatch| {
            let view = comparisons.views.get(&matched.frame).copied();
            let in_sight = self.in_sight(matched.place, view.as_ref(), comparisons) * (1.0 + frames as f64);
            let alone = Candidate::new(matched, view, at, look_alikes.max(in_sight));
            alone.judged(self.frame.support(&alone), &settings.weights)
        };
        self.compared.iter().map(candidate).collect()
    }

    /// What the frame shows, in inliers, of what lies between a candidate of its own session and now,
    /// if it has that in sight still: half as much of it as of the candidate, or more. Each of the
    /// last frames may have shown as much, as they speak for the candidate.
    fn in_sight(&self, from: PlaceId, view: Option<&TwoView>, comparisons: &Comparisons) -> f64 {
        let between = self.wanted.between.get(&from).and_then(|frame| comparisons.views.get(frame));
        let [seen, between] = [view, between].map(|view| view.map_or(0.0, TwoView::evidence));
        if between >= HALF_AS_GOOD * seen { between } else { 0.0 }
    }

    /// With geometry the candidate that it has most evidence for, or else the frame that matches
    /// best of the most probable place known from before the guard.
    fn proposal(&self, candidates: &[Candidate]) -> Option<Match> {
        let candidate = most_likely(candidates).map(|candidate| candidate.matched);
        candidate.or_else(|| self.most_probable_match())
    }

    /// Data association: what geometry verified, or else the most probable of all places and
    /// "somewhere new", unless geometry could have verified it.
    fn associate(&self, candidates: &[Candidate], comparisons: &Comparisons) -> Decision {
        let frame = &self.frame;
        if frame.shows_too_little() {
            return frame.too_few_words();
        }
        let settings = self.settings(comparisons);
        if let Some(decision) = self.by_views_alone(&settings, candidates) {
            return decision;
        }
        let place_to_stay_at = frame.place_to_stay_at().filter(|_| self.may_have_stayed(comparisons));
        if let Some(place) = place_to_stay_at {
            return frame.same_place(place);
        }
        let verified = frame.mapper.verified(&settings, frame, candidates);
        if let Some(Candidate { matched, .. }) = verified {
            return closure_with(matched);
        }
        if let Some(stay) = frame.session.stay.as_ref().filter(|_| frame.is_at_its_stay()) {
            return frame.same_place(stay.place);
        }
        if self.has_driven_on(&settings, candidates) {
            return frame.new_place(Reason::NewPlace, None);
        }
        let Association::Seen(place) = frame.association else {
            return frame.new_place(Reason::NewPlace, None);
        };
        if frame.pose_of_robot().is_some() && frame.was_just_at(place) {
            return frame.new_place(Reason::NewPlace, None);
        }
        let probability = frame.recognition.posterior.places[place.index()];
        let closure = self.match_at(place);
        if frame.mapper.out_of_reach(&frame.input, place).is_some() {
            return frame.new_place(Reason::NewPlace, closure);
        }
        if probability < frame.mapper.settings().closure_threshold {
            return frame.new_place(Reason::BelowThreshold, closure);
        }
        if frame.mapper.verifies() && !is_without_keypoints(candidates, place) {
            let is_improbable = lacks_probability_alone(&settings, candidates, place);
            let reason = if is_improbable { Reason::BelowThreshold } else { Reason::GeometryRefused };
            return frame.new_place(reason, closure);
        }
        Decision { reason: Reason::LoopClosure, place: Some(place), posterior: probability, closure }
    }

    /// Where no wheels say how far a place reaches: what geometry verified, be it where the session
    /// is. Words are much the same all along a way, so they would keep a robot that comes back at
    /// the first place that it knows again.
    fn by_views_alone(&self, settings: &MapperSettings, candidates: &[Candidate]) -> Option<Decision> {
        let frame = &self.frame;
        if frame.pose_of_robot().is_some() {
            return None;
        }
        let Candidate { matched, .. } = frame.mapper.verified_anywhere(settings, candidates)?;
        let is_there = frame.was_just_at(matched.place);
        Some(if is_there { frame.same_place(matched.place) } else { closure_with(matched) })
    }

    /// Whether what geometry holds for the same place is where the session has just been: it is beside that, as far as
    /// its wheels say.
    fn has_driven_on(&self, settings: &MapperSettings, candidates: &[Candidate]) -> bool {
        let frame = &self.frame;
        let there = frame.mapper.verified_anywhere(settings, candidates);
        there.is_some_and(|candidate| frame.session.is_near(candidate.matched.place, settings))
    }

    /// Whether what the session saw last of the place where it is may be the scene that it sees
    /// now. Without keypoints there is nothing against it.
    fn may_have_stayed(&self, comparisons: &Comparisons) -> bool {
        let view = self.wanted.stayed.and_then(|frame| comparisons.views.get(&frame));
        let MapperSettings { verification, place_spacing, .. } = self.frame.mapper.settings();
        view.is_none_or(|view| verification.of_one_place(view, place_spacing).iter().all(Check::passed))
    }

    /// A new place whatever is recognised, unless the robot is at its last one still.
    fn place_of_its_own(&self, comparisons: &Comparisons) -> Decision {
        let frame = &self.frame;
        if frame.shows_too_little() {
            return frame.too_few_words();
        }
        let stands = frame.is_at_its_stay() || comparisons.show_the_same_spot();
        match frame.session.stay.as_ref().filter(|_| stands) {
            Some(stay) => frame.same_place(stay.place),
            None => frame.new_place(Reason::NewPlace, None),
        }
    }

    /// Where in the frame of the place that was decided the robot is: by the closure if that
    /// measured it, or else by its wheels. A place that is created is where the robot is.
    fn locate(
        &self,
        decision: &Decision,
        candidates: &[Candidate],
        comparisons: &Comparisons,
    ) -> Option<Located> {
        let place = decision.place.filter(|_| self.frame.input.odometry.is_some())?;
        if place.index() == self.frame.mapper.recognizer().places() {
            return Some(Located::AtOrigin);
        }
        if decision.reason != Reason::LoopClosure {
            return self.frame.located_by_wheels(place);
        }
        let frame = decision.closure.map(|closure| closure.frame);
        let candidate = candidates.iter().find(|candidate| Some(candidate.matched.frame) == frame);
        let view = candidate.and_then(|candidate| candidate.view.as_ref());
        let compared = self.compared.iter().find(|best| Some(best.matched.frame) == frame);
        let at = compared.and_then(|best| best.at);
        Some(self.frame.located_by_closure(view, at, comparisons.focal_length_widths))
    }
}

fn closure_with(matched: &Match) -> Decision {
    let Match { place, posterior, .. } = *matched;
    Decision { reason: Reason::LoopClosure, place: Some(place), posterior, closure: Some(*matched) }
}

impl Comparisons {
    /// Whether nearly all is seen from the same spot.
    fn show_the_same_spot(&self) -> bool {
        self.turned.as_ref().is_some_and(TurnedView::is_from_the_same_spot)
    }
}

impl FrameInHand<'_> {
    fn too_few_words(&self) -> Decision {
        let posterior = self.session.belief.new_place;
        Decision { reason: Reason::TooFewWords, place: None, posterior, closure: None }
    }

    fn same_place(&self, place: PlaceId) -> Decision {
        let posterior = self.recognition.posterior.places[place.index()];
        Decision { reason: Reason::SamePlace, place: Some(place), posterior, closure: None }
    }

    /// A place that is created; none where nothing grows.
    fn new_place(&self, reason: Reason, closure: Option<Match>) -> Decision {
        let next = PlaceId::from_index(self.mapper.recognizer().places());
        let place = (self.growth == Growth::Grows).then_some(next);
        Decision { reason, place, posterior: self.recognition.posterior.new_place, closure }
    }

    /// Wheels that do not turn would keep a robot that drives at one place for ever.
    fn check_that_wheels_turn(
        &self,
        decision: &Decision,
        comparisons: &Comparisons,
    ) -> Result<(), FrameError> {
        let stays_at = decision.place.filter(|_| decision.reason == Reason::SamePlace);
        let stand = stays_at.is_some_and(|place| self.wheels_seem_to_stand_at(place));
        if stand && !comparisons.show_the_same_spot() {
            return Err(FrameError::OdometryStandsStill { frames: self.frames_since_it_came() });
        }
        Ok(())
    }
}

impl super::Mapper {
    /// Whether the place learns this look. A new place always does, or it would have no appearance.
    fn learns(&self, session: &crate::map::Session, decision: &Decision) -> bool {
        decision.place.is_some_and(|place| {
            session.looks_of_stay(place, self.settings()) < self.settings().looks_per_stay
        })
    }

    /// The way here from the place the session was at, or surely at if it is measured, unless the
    /// two are linked already.
    fn link(
        &self,
        session: &crate::map::Session,
        decision: &Decision,
        odometry: Option<&crate::metric::Odometry>,
        located: Option<Located>,
    ) -> Option<Link> {
        let stay = session.stay.as_ref()?;
        let to = decision.place?;
        let (from, kind) = match (self.driven_from_anchor(session, odometry), located) {
            (Some((from, driven)), Some(Located::AtOrigin)) => (from, LinkKind::Driven(driven)),
            (Some((from, driven)), Some(Located::ByClosure(at))) => {
                (from, LinkKind::Closed(driven.then(&at.back())))
            }
            (Some(_) | None, Some(_) | None) => (stay.place, LinkKind::Session),
        };
        let linked = from == to || self.map().linked(from).binary_search(&to).is_ok();
        (!linked).then_some(Link { from, to, kind })
    }
}
