//! Runs that are longer than those of every day: what is tried is numbered and drawn from a seed, each try by itself, so that
//! a run takes up where another stopped, and counts add up over days.

use std::ops::Range;

/// Tries between two lines that say how far a run is.
const A_PART: u64 = 1000;

/// What a run tries.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tries {
    what: &'static str,
    pub(super) seed: u64,
    first: u64,
    count: u64,
}

impl Tries {
    /// `usual` ones of seed 1 from number 0 on, if the environment says nothing else: `WAYPOST_KILLS` is how many there are,
    /// of the seed `WAYPOST_KILLS_SEED`, from the number `WAYPOST_KILLS_FROM` on.
    pub(super) fn asked(what: &'static str, usual: u64) -> Self {
        let name = format!("WAYPOST_{what}");
        let count = number(&name, usual);
        Self {
            what,
            seed: number(&format!("{name}_SEED"), 1),
            first: number(&format!("{name}_FROM"), 0),
            count,
        }
    }

    pub(super) fn count(self) -> u64 {
        self.count
    }

    /// The numbers in parts, after each of which it is told what came of it: see [`Tries::told`].
    pub(super) fn parts(self) -> impl Iterator<Item = Range<u64>> {
        let end = self.first + self.count;
        (self.first..end).step_by(A_PART as usize).map(move |first| first..end.min(first + A_PART))
    }

    /// Says what came of a part, and how to go on after it.
    pub(super) fn told(self, part: &Range<u64>, came: impl std::fmt::Display) {
        let Self { what, seed, .. } = self;
        println!(
            "{what} {} to {} of seed {seed}: {came}; go on with WAYPOST_{what}_FROM={}",
            part.start,
            part.end - 1,
            part.end
        );
    }
}

/// A number from the environment.
pub(super) fn number(variable: &str, otherwise: u64) -> u64 {
    std::env::var(variable).map_or(otherwise, |number| number.parse().expect("a whole number"))
}

#[test]
fn parts_are_all_of_a_run_and_nothing_twice() {
    let tries = Tries { what: "NOTHING", seed: 1, first: 500, count: 2_300 };
    let parts: Vec<Range<u64>> = tries.parts().collect();
    assert_eq!(parts, [500..1_500, 1_500..2_500, 2_500..2_800]);
}
