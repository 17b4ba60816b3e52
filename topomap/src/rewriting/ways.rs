//! Ways between the places that are left.

use std::collections::BTreeSet;

use fabmap::appearance::PlaceId;

use crate::ids::SessionId;
use crate::log::{FrameEvent, Link, LinkKind, MovedPlace, Reason};
use crate::metric::{Odometry, RelativePose};
use crate::settings::MapperSettings;

/// A session that stays, as far as it is rewritten.
#[derive(Clone, Debug)]
pub(super) struct Run {
    /// Its number in the new log.
    pub(super) number: SessionId,
    /// The last frame at a place.
    pub(super) stay: Option<Stood>,
    /// The last that was surely somewhere there.
    pub(super) anchor: Option<Stood>,
    /// Whether the session has been at a place since that is left out.
    past_dropped: bool,
}

/// Where a frame was taken.
#[derive(Clone, Debug)]
pub(super) struct Stood {
    /// The place, in the old log.
    was: PlaceId,
    /// And in the new.
    pub(super) place: PlaceId,
    odometry: Option<Odometry>,
    at: Option<RelativePose>,
}

/// How a frame comes to its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Arrival {
    /// It makes the place.
    Makes,
    /// A closure measured where in it the robot is.
    Closes,
    /// Wheels say that it is there, or words alone.
    Returns,
}

/// A link of the old log, and what its ends have become.
type Kept = (MovedPlace, MovedPlace, Link);

/// Which places are linked, and how others would be.
pub(super) struct Ways<'a> {
    settings: &'a MapperSettings,
    /// In the old log so far, both ways.
    linked_before: BTreeSet<(PlaceId, PlaceId)>,
    /// In the new.
    linked: BTreeSet<(PlaceId, PlaceId)>,
}

impl Stood {
    pub(super) fn new(
        was: PlaceId,
        place: PlaceId,
        odometry: Option<Odometry>,
        at: Option<RelativePose>,
    ) -> Self {
        Self { was, place, odometry, at }
    }
}

impl Run {
    pub(super) fn new(number: SessionId) -> Self {
        Self { number, stay: None, anchor: None, past_dropped: false }
    }

    /// As the fold follows a session.
    pub(super) fn follow(&mut self, was: Option<PlaceId>, told: &FrameEvent, ways: &Ways<'_>) {
        let Some((was, place)) = was.zip(told.decision.place) else {
            self.past_dropped |= was.is_some();
            return;
        };
        let stood = Stood::new(was, place, told.odometry.clone(), told.at);
        if told.odometry.is_some() && told.at.is_some_and(|at| ways.is_sure(&at)) {
            self.anchor = Some(stood.clone());
        }
        self.stay = Some(stood);
        self.past_dropped = false;
    }

    /// The last frames were at no place: it is where it was before.
    pub(super) fn resume(&mut self, stay: Option<Stood>, anchor: Option<Stood>) {
        self.stay = stay;
        self.anchor = anchor;
    }

    /// The last frame was there.
    pub(super) fn go_on_from(&mut self, stood: Stood) {
        self.anchor = Some(stood.clone());
        self.stay = Some(stood);
    }
}

impl<'a> Ways<'a> {
    pub(super) fn new(settings: &'a MapperSettings) -> Self {
        Self { settings, linked_before: BTreeSet::new(), linked: BTreeSet::new() }
    }

    /// Whether wheels may go on from there, as the fold says.
    pub(super) fn is_sure(&self, at: &RelativePose) -> bool {
        at.position_sigma_m() <= self.settings.place_spacing.distance_m
    }

    pub(super) fn follow_old(&mut self, link: &Link) {
        self.linked_before.extend([(link.from, link.to), (link.to, link.from)]);
    }

    /// The link to a place that the frame makes.
    pub(super) fn link_to_new_place(
        &mut self,
        run: &Run,
        to: MovedPlace,
        kept: Option<Kept>,
        told: &FrameEvent,
    ) -> Option<Link> {
        let here = self.way_here(run, to.place, Arrival::Makes, told).map(|(_, link)| link);
        let link = match (kept.map(|kept| self.rebased(&kept, here.as_ref())), here) {
            // Wheels know the way to where the robot is; a closure did not say where in its place
            // that was.
            (Some(kept), Some(here)) if kept.kind == LinkKind::Session => Some(here),
            (kept, here) => kept.or(here),
        };
        link.and_then(|link| self.added(link))
    }

    /// The link to a place that was there before: the same as before, or where a link is gone that
    /// stood for it.
    pub(super) fn link_to_known_place(
        &mut self,
        run: &Run,
        to: MovedPlace,
        kept: Option<Kept>,
        (event, told): (&FrameEvent, &FrameEvent),
    ) -> Option<Link> {
        // As sure as it was then: where another frame made the place, that frame's doubt is on top.
        let closes =
            event.decision.reason == Reason::LoopClosure && event.at.is_some_and(|at| self.is_sure(&at));
        let arrival = if closes { Arrival::Closes } else { Arrival::Returns };
        let here = self.way_here(run, to.place, arrival, told);
        let link = match kept {
            Some(kept) => Some(self.rebased(&kept, here.map(|(_, link)| link).as_ref())),
            None => {
                let stood_for = |from: PlaceId| {
                    event.decision.place.is_some_and(|was| self.linked_before.contains(&(from, was)))
                };
                here.filter(|&(from, _)| event.link.is_some() || run.past_dropped || stood_for(from))
                    .map(|(_, link)| link)
            }
        };
        link.and_then(|link| self.added(link))
    }

    /// What a robot measured by itself, between the same places; such links come on top.
    pub(super) fn measured(&mut self, from: MovedPlace, to: MovedPlace, link: &Link) -> Option<Link> {
        let link = self.between(from, to, link)?;
        self.linked.extend([(link.from, link.to), (link.to, link.from)]);
        Some(link)
    }

    /// A link of the old log between what its ends have become; none where those are one.
    pub(super) fn between(&self, from: MovedPlace, to: MovedPlace, link: &Link) -> Option<Link> {
        Some(self.rebased(&(from, to, *link), None)).filter(|link| link.from != link.to)
    }

    /// A correction takes a link of the new log out, and puts another one in.
    pub(super) fn relink(&mut self, was: Option<&Link>, now: Option<&Link>) {
        exchange(&mut self.linked, was, now);
    }

    /// The same of the old log.
    pub(super) fn relink_old(&mut self, was: Option<&Link>, now: Option<&Link>) {
        exchange(&mut self.linked_before, was, now);
    }

    /// Two places have one link.
    fn added(&mut self, link: Link) -> Option<Link> {
        let link = Some(link).filter(|link| link.from != link.to)?;
        self.linked.insert((link.to, link.from));
        self.linked.insert((link.from, link.to)).then_some(link)
    }

    /// A link as the mapper would make it now, and the old place that it would start from.
    fn way_here(
        &self,
        run: &Run,
        to: PlaceId,
        arrival: Arrival,
        told: &FrameEvent,
    ) -> Option<(PlaceId, Link)> {
        let stay = run.stay.as_ref()?;
        let driven = run.anchor.as_ref().and_then(|anchor| {
            let way =
                self.settings.odometry_noise.between(anchor.odometry.as_ref()?, told.odometry.as_ref()?);
            Some((anchor, anchor.at?.then(&way)))
        });
        let (from, kind) = match (arrival, driven, told.at) {
            (Arrival::Makes, Some((anchor, driven)), Some(_)) => (anchor, LinkKind::Driven(driven)),
            (Arrival::Closes, Some((anchor, driven)), Some(at)) => {
                (anchor, LinkKind::Closed(driven.then(&at.back())))
            }
            (Arrival::Makes | Arrival::Closes | Arrival::Returns, _, _) => (stay, LinkKind::Session),
        };
        Some((from.was, Link { from: from.place, to, kind }))
    }

    /// A link of the old log between what its ends have become. What it measured is what was
    /// measured then, less what a map has learnt of its wheels since; how sure it is, where an end
    /// has moved, is what the same way says in the new log.
    fn rebased(&self, (from, to, link): &Kept, here: Option<&Link>) -> Link {
        let ends = Link { from: from.place, to: to.place, kind: LinkKind::Session };
        if from.at.is_none() && to.at.is_none() {
            return Link { kind: link.kind, ..ends };
        }
        let moved = |measured: &RelativePose| from.way_to(to, measured);
        let same_way = here.filter(|here| (here.from, here.to) == (ends.from, ends.to)).map(|here| here.kind);
        let kind = match &link.kind {
            LinkKind::Session => LinkKind::Session,
            LinkKind::Odometry(relative) => {
                as_sure(moved(&self.settings.odometry_noise.from_above(relative)), same_way, LinkKind::Driven)
            }
            LinkKind::Driven(measured) => as_sure(moved(measured), same_way, LinkKind::Driven),
            LinkKind::Closed(measured) => as_sure(moved(measured), same_way, LinkKind::Closed),
        };
        Link { kind, ..ends }
    }
}

/// Both ways.
fn exchange(linked: &mut BTreeSet<(PlaceId, PlaceId)>, was: Option<&Link>, now: Option<&Link>) {
    if let Some(Link { from, to, .. }) = was {
        linked.remove(&(*from, *to));
        linked.remove(&(*to, *from));
    }
    if let Some(Link { from, to, .. }) = now {
        linked.extend([(*from, *to), (*to, *from)]);
    }
}

/// A way with the covariance, and of the kind, of the same way in the new log.
fn as_sure(moved: RelativePose, told: Option<LinkKind>, kind: fn(RelativePose) -> LinkKind) -> LinkKind {
    let with = |told: &RelativePose| RelativePose::new(*moved.pose(), *told.covariance()).unwrap_or(moved);
    match told {
        Some(LinkKind::Driven(told)) => LinkKind::Driven(with(&told)),
        Some(LinkKind::Closed(told)) => LinkKind::Closed(with(&told)),
        Some(LinkKind::Session | LinkKind::Odometry(_)) | None => kind(moved),
    }
}
