//! What people said of the source, said of the target.

use fabmap::appearance::PlaceId;

use super::Joining;
use crate::ids::SessionId;
use crate::log::{
    Confirmation, Correction, CorrectionEvent, Link, Relinked, Resumed, Stood, Undoing, Withdrawal,
};

impl Joining<'_> {
    /// The same correction of the same frames.
    pub(super) fn corrected(&mut self, position: u64, event: &CorrectionEvent) -> Option<CorrectionEvent> {
        let CorrectionEvent { position: _, session, by, said_ns, correction } = event;
        let correction = match correction {
            Correction::Withdrawn(withdrawal) => {
                let withdrawal = self.withdrawn(withdrawal, *session)?;
                self.relinked.insert(position, withdrawal.relinked.clone());
                Correction::Withdrawn(Box::new(withdrawal))
            }
            Correction::Confirmed(Confirmation { frame, earlier, link }) => {
                Correction::Confirmed(Confirmation {
                    frame: *self.frames.get(frame)?,
                    earlier: *self.frames.get(earlier)?,
                    link: match link {
                        Some(link) => self.corrected_link(link, *session)?,
                        None => None,
                    },
                })
            }
            Correction::Undone(Undoing { correction, place }) => {
                let correction = *self.frames.get(correction)?;
                for Relinked { event, was, now } in self.relinked.remove(&correction).unwrap_or_default() {
                    self.relink(event, now.as_ref(), was);
                }
                Correction::Undone(Undoing {
                    correction,
                    place: match place {
                        Some(place) => Some(self.joined(*place)?),
                        None => None,
                    },
                })
            }
        };
        let session = *self.sessions.get(session)?;
        Some(CorrectionEvent { position, session, by: by.clone(), said_ns: *said_ns, correction })
    }

    fn withdrawn(&mut self, withdrawal: &Withdrawal, session: SessionId) -> Option<Withdrawal> {
        let Withdrawal { frame, earlier, place, frames, relinked, resumed } = withdrawal;
        let mut joined = Vec::new();
        for Relinked { event, was: _, now } in relinked {
            let event = *self.frames.get(event)?;
            let was = self.links.get(&event).copied();
            let now = match now {
                Some(now) => self.corrected_link(now, session)?,
                None => None,
            };
            self.relink(event, was.as_ref(), now);
            joined.push(Relinked { event, was, now });
        }
        Some(Withdrawal {
            frame: *self.frames.get(frame)?,
            earlier: *self.frames.get(earlier)?,
            place: self.joined(*place)?,
            frames: frames.iter().map(|frame| self.frames.get(frame).copied()).collect::<Option<_>>()?,
            relinked: joined,
            resumed: match resumed {
                Some(Resumed { stay, anchor }) => {
                    Some(Resumed { stay: self.stood(stay.as_ref())?, anchor: self.stood(anchor.as_ref())? })
                }
                None => None,
            },
        })
    }

    fn joined(&self, place: PlaceId) -> Option<PlaceId> {
        self.places.get(place.index()).map(|joined| joined.place)
    }

    fn stood(&self, stood: Option<&Stood>) -> Option<Option<Stood>> {
        let Some(Stood { place, odometry, at }) = stood else { return Some(None) };
        let joined = self.places.get(place.index())?;
        let at = at.map(|at| joined.seen(&at));
        Some(Some(Stood { place: joined.place, odometry: odometry.clone(), at }))
    }

    /// The link between the same places, linked or not; none where they are one.
    fn corrected_link(&self, link: &Link, session: SessionId) -> Option<Option<Link>> {
        let from = self.places.get(link.from.index())?;
        let to = self.places.get(link.to.index())?;
        let kind = self.kind(&link.kind, (from, to), session);
        Some((from.place != to.place).then_some(Link { from: from.place, to: to.place, kind }))
    }

    fn relink(&mut self, event: u64, was: Option<&Link>, now: Option<Link>) {
        if let Some(was) = was {
            self.linked.remove(&(was.from, was.to));
            self.linked.remove(&(was.to, was.from));
        }
        match now {
            Some(now) => {
                self.linked.extend([(now.from, now.to), (now.to, now.from)]);
                self.links.insert(event, now);
            }
            None => {
                self.links.remove(&event);
            }
        }
    }
}
