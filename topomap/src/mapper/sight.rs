//! What lies between an earlier frame of a session and now, and whether that is in sight still.
//!
//! A robot that drives straight on sees what is ahead of it for as long as it takes to get there.
//! Its earlier frames show in order what it sees now, and yet it was not there again. What tells is
//! the way between: a robot that came back had lost sight of it, one that drove on has it in sight.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;

use super::frame::FrameInHand;
use super::proposing::EarlierMatch;
use crate::ids::FrameId;
use crate::map::Look;

/// Ends of a way, as a share of it, that do not stand for what lies between.
const QUARTER: usize = 4;

/// Frames between that are looked at, at most: all over the way, however long it is.
const LOOKED_AT: usize = 32;

impl FrameInHand<'_> {
    /// By place that is compared by a frame of the session itself: another of its frames, from
    /// between that one and now.
    pub(super) fn frames_between(&self, compared: &[EarlierMatch]) -> BTreeMap<PlaceId, FrameId> {
        if self.makes_each_frame_a_place() {
            return BTreeMap::new();
        }
        let mut earlier: Vec<(PlaceId, u64)> = compared.iter().filter_map(|best| self.own(best)).collect();
        // What lies between the latest and now lies between the others and now, too.
        earlier.sort_by_key(|&(_, number)| Reverse(number));
        let mut chosen: Vec<Look> = Vec::new();
        let mut between = BTreeMap::new();
        for (place, number) in earlier {
            let amid = self.amid(number);
            let is_amid = |look: &&Look| {
                let (first, last) = (amid.first(), amid.last());
                first.is_some_and(|first| first.number <= look.number)
                    && last.is_some_and(|last| look.number <= last.number)
            };
            let known = chosen.iter().find(is_amid).copied();
            let Some(look) = known.or_else(|| self.neither_most_nor_least_alike(amid)) else { continue };
            if known.is_none() {
                chosen.push(look);
            }
            between.insert(place, look.frame);
        }
        between
    }

    /// The place of a match and the number of its frame, if the session took that.
    fn own(&self, best: &EarlierMatch) -> Option<(PlaceId, u64)> {
        let place = best.matched.place;
        let seen = self.mapper.map().locate(place, best.matched.frame)?;
        (seen.session == self.input.session).then_some((place, seen.number))
    }

    /// What places learnt from the session since its frame `number`, but for both ends of that way.
    fn amid(&self, number: u64) -> &[Look] {
        let looks = self.mapper.map().learnt_after(self.input.session, number);
        let quarter = looks.len() / QUARTER;
        &looks[quarter..looks.len() - quarter]
    }

    /// By words: a way may lead past the same place once more, and past a wall.
    fn neither_most_nor_least_alike(&self, looks: &[Look]) -> Option<Look> {
        let step = looks.len().div_ceil(LOOKED_AT).max(1);
        let mut looks: Vec<Look> = looks.iter().step_by(step).copied().collect();
        let posterior = |look: &Look| self.recognition.posterior.places[look.place.index()];
        looks.sort_by(|a, b| posterior(a).total_cmp(&posterior(b)).then(a.number.cmp(&b.number)));
        looks.get(looks.len() / 2).copied()
    }
}
