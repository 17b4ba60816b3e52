//! What a robot gets: frames that were put to a place that was known before.

use std::collections::HashMap;

use fabmap::appearance::PlaceId;

use crate::dataset::{Truth, Verdict};

/// Frames put to a place that was known at least the gap before, by a closure or by staying where one led.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Recognised {
    /// That place holds a true match.
    pub(super) right: usize,
    /// It holds none, nor one that is counted neither way.
    pub(super) wrong: usize,
}

impl Recognised {
    /// `places`: of each frame, in order, the place that it was put to.
    pub(super) fn of(places: impl Iterator<Item = Option<PlaceId>>, truth: &Truth, gap: usize) -> Self {
        let mut members: HashMap<PlaceId, Vec<usize>> = HashMap::new();
        let mut counted = Self::default();
        for (index, place) in places.enumerate() {
            let Some(place) = place else { continue };
            let members = members.entry(place).or_default();
            let known = members.iter().filter(|&&earlier| earlier + gap <= index);
            let verdicts: Vec<Verdict> = known.map(|&earlier| truth.verdict(index, earlier)).collect();
            if verdicts.contains(&Verdict::True) {
                counted.right += 1;
            } else if !verdicts.is_empty() && !verdicts.contains(&Verdict::Neutral) {
                counted.wrong += 1;
            }
            members.push(index);
        }
        counted
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn a_known_place_is_right_wrong_or_neither() {
        let truth = Truth::new(HashSet::from([(4, 0), (6, 0)]), HashSet::from([(5, 1)]));
        let of = |places: &[Option<PlaceId>], gap| {
            let Recognised { right, wrong } = Recognised::of(places.iter().copied(), &truth, gap);
            (right, wrong)
        };
        let [a, b, c] = [0, 1, 2].map(|place| Some(PlaceId::new(place)));
        // Frame 4 is back where 0 was, 5 where it is not known, 6 by staying there with 4.
        assert_eq!(of(&[a, b, c, None, a, b, a], 4), (2, 0));
        // Put to the wrong places; what was seen within the gap was not known before.
        assert_eq!(of(&[a, b, c, c, b, a, c], 4), (0, 2));
        assert_eq!(of(&[a, a, a, a], 4), (0, 0));
    }
}
