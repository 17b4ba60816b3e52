//! Which stamps follow each other, where single ones are wrong and clocks are set.

use std::fmt;

/// A stamp at most this far above the last follows it, whatever the rate.
const LEAST_STEP_NS: i64 = 1_000_000_000;
/// So many times the last step follow, too, where stamps come more slowly.
const STEPS: i64 = 2;
/// So many stamps that follow each other are believed against those before them.
pub(crate) const AGREEING: usize = 3;

/// Tells stamps that follow each other from single wrong ones and from a clock that was set, in the order in which
/// they come.
///
/// A stamp above the last follows it if it is at most a second, or twice the last step, above it; or a second more than has
/// passed since the one before by another clock, as that of recording. It counts at once. Any other is held, and what comes
/// next decides:
///
/// - A stamp that follows the last one leaves out all that is held: it was astray.
/// - Three stamps that rise, the held ones among them, are believed. Above the last, they go on after it, as after a
///   pause or a clock that was set ahead. Not above it, the clock was set back: all begins anew with them.
/// - Where those three follow the stamp before the last, or there are fewer than three before them, no clock was set: those
///   in between were astray.
///
/// A stamp that is the last one again is left out. So stamps that rise throughout are all believed, one wrong stamp costs itself
/// alone, and no more than two things are ever held.
#[derive(Clone, Debug, PartialEq)]
pub struct Succession<T> {
    /// The last stamp that counts, and the one before it.
    last_ns: Option<i64>,
    before_last_ns: Option<i64>,
    /// How many count since all began anew.
    length: usize,
    held: Vec<Held<T>>,
    came: u64,
    astray: Astray,
}

#[derive(Clone, Debug, PartialEq)]
struct Held<T> {
    number: u64,
    stamp_ns: i64,
    item: T,
}

/// What became of a stamp.
#[derive(Clone, Debug, PartialEq)]
pub enum Step<T> {
    /// It counts.
    Follows(T),
    /// It counts once others agree with it.
    Held,
    /// It is the last one again, and does not count.
    Repeats,
    /// These count, and go on after the last.
    GoOn(Vec<(i64, T)>),
    /// These count and go on after the one before the last, which was astray and does not count any more.
    InPlaceOfLast(Vec<(i64, T)>),
    /// All those before were astray, and do not count any more; these count.
    InPlaceOfAll(Vec<(i64, T)>),
    /// The clock was set back: all begins anew with these.
    Anew(Vec<(i64, T)>),
}

/// What did not follow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Astray {
    /// How many stamps do not count.
    pub left_out: u64,
    /// The first of them: its number among all, from 1, and itself.
    pub first: Option<(u64, i64)>,
    /// How many times the clock was set back.
    pub set_back: u64,
    /// The first of these times: the number of the first stamp after it, and how far the clock went.
    pub first_set_back: Option<(u64, i64)>,
}

impl Astray {
    /// Whether all stamps counted.
    #[must_use]
    pub fn is_none(&self) -> bool {
        self.left_out == 0 && self.set_back == 0
    }

    fn leave_out(&mut self, count: usize, first: (u64, i64)) {
        self.left_out += count as u64;
        if count > 0 && self.first.is_none_or(|(number, _)| first.0 < number) {
            self.first = Some(first);
        }
    }
}

impl fmt::Display for Astray {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { left_out, first, set_back, first_set_back } = self;
        match first {
            Some((number, stamp_ns)) if *left_out == 1 => write!(
                f,
                "1 message is left out, number {number}: its stamp {stamp_ns} does not follow those around it"
            )?,
            Some((number, stamp_ns)) => write!(
                f,
                "{left_out} messages are left out: their stamps do not follow those around them; the first is number {number}, \
                 with the stamp {stamp_ns}"
            )?,
            None => {}
        }
        if let Some((number, by_ns)) = first_set_back {
            let between = if *left_out > 0 { "; " } else { "" };
            let times = if *set_back > 1 { format!("{set_back} times, first ") } else { String::new() };
            let by_s = *by_ns as f64 / 1e9;
            write!(f, "{between}its clock was set back {times}by {by_s:.3} s, at message {number}")?;
        }
        Ok(())
    }
}

impl<T> Default for Succession<T> {
    fn default() -> Self {
        Self {
            last_ns: None,
            before_last_ns: None,
            length: 0,
            held: Vec::new(),
            came: 0,
            astray: Astray::default(),
        }
    }
}

impl<T> Succession<T> {
    /// Takes the next stamp, with what it is of.
    pub fn push(&mut self, stamp_ns: i64, item: T) -> Step<T> {
        self.push_after(0, stamp_ns, item)
    }

    /// Takes the next stamp, which came so long after the one before it by another clock.
    pub fn push_after(&mut self, passed_ns: i64, stamp_ns: i64, item: T) -> Step<T> {
        self.came += 1;
        if self.last_ns.is_none_or(|last_ns| self.follows(last_ns, stamp_ns, passed_ns)) {
            self.drop_held();
            self.count(stamp_ns);
            return Step::Follows(item);
        }
        let highest_ns = self.held.last().map(|held| held.stamp_ns);
        if self.last_ns == Some(stamp_ns) || highest_ns == Some(stamp_ns) {
            self.astray.leave_out(1, (self.came, stamp_ns));
            return Step::Repeats;
        }
        if highest_ns.is_some_and(|highest_ns| stamp_ns < highest_ns) {
            self.drop_held();
        }
        self.held.push(Held { number: self.came, stamp_ns, item });
        if self.held.len() < AGREEING { Step::Held } else { self.believe() }
    }

    /// No more stamps come: nothing speaks against held ones that are above the last.
    pub fn end(&mut self) -> Vec<(i64, T)> {
        if self.is_behind() {
            self.drop_held();
        }
        self.take_held()
    }

    /// What did not follow so far; what is held is not in it.
    pub fn astray(&self) -> Astray {
        self.astray
    }

    /// Whether the latest stamps lie behind the last that counts, and it is not decided yet whether a clock was set back.
    pub fn is_behind(&self) -> bool {
        self.held.first().zip(self.last_ns).is_some_and(|(held, last_ns)| held.stamp_ns < last_ns)
    }

    /// The last stamp that counts.
    pub fn last_ns(&self) -> Option<i64> {
        self.last_ns
    }

    /// How many stamps count since all began, or began anew.
    pub fn length(&self) -> usize {
        self.length
    }

    fn follows(&self, last_ns: i64, stamp_ns: i64, passed_ns: i64) -> bool {
        let step_ns = self.before_last_ns.map_or(0, |before_ns| last_ns.saturating_sub(before_ns));
        let most_ns = step_ns.saturating_mul(STEPS).max(passed_ns.saturating_add(LEAST_STEP_NS));
        stamp_ns > last_ns && stamp_ns.saturating_sub(last_ns) <= most_ns
    }

    fn count(&mut self, stamp_ns: i64) {
        self.before_last_ns = self.last_ns;
        self.last_ns = Some(stamp_ns);
        self.length += 1;
    }

    fn drop_held(&mut self) {
        if let Some(first) = self.held.first() {
            self.astray.leave_out(self.held.len(), (first.number, first.stamp_ns));
        }
        self.held.clear();
    }

    fn take_held(&mut self) -> Vec<(i64, T)> {
        let held = std::mem::take(&mut self.held);
        held.iter().for_each(|held| self.count(held.stamp_ns));
        held.into_iter().map(|held| (held.stamp_ns, held.item)).collect()
    }

    fn believe(&mut self) -> Step<T> {
        let (Some(first), Some(last_ns)) = (self.held.first(), self.last_ns) else { return Step::Held };
        let (number, first_ns) = (first.number, first.stamp_ns);
        if first_ns > last_ns {
            return Step::GoOn(self.take_held());
        }
        // What was astray came right before what is held, repeats apart.
        let astray_from = |count: usize| number.saturating_sub(count as u64).max(1);
        let goes_on =
            |before_ns: &i64| first_ns > *before_ns && first_ns.saturating_sub(*before_ns) <= LEAST_STEP_NS;
        if let Some(before_ns) = self.before_last_ns.filter(goes_on) {
            self.astray.leave_out(1, (astray_from(1), last_ns));
            self.last_ns = Some(before_ns);
            self.before_last_ns = None;
            self.length -= 1;
            return Step::InPlaceOfLast(self.take_held());
        }
        let length = std::mem::take(&mut self.length);
        self.before_last_ns = None;
        self.last_ns = None;
        if length < AGREEING {
            self.astray.leave_out(length, (astray_from(length), last_ns));
            return Step::InPlaceOfAll(self.take_held());
        }
        self.astray.set_back += 1;
        self.astray.first_set_back.get_or_insert((number, last_ns.saturating_sub(first_ns)));
        Step::Anew(self.take_held())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: i64 = 1_000_000_000;

    /// Which stamps, in tenths of a second, count in the end, and what did not follow.
    fn counting(stamps: &[i64]) -> (Vec<i64>, Astray) {
        let mut succession = Succession::default();
        let mut counting: Vec<i64> = Vec::new();
        let tenth = |items: Vec<(i64, i64)>| items.into_iter().map(|(_, tenth)| tenth);
        for &stamp in stamps {
            match succession.push(stamp * SECOND_NS / 10, stamp) {
                Step::Follows(stamp) => counting.push(stamp),
                Step::Held | Step::Repeats => {}
                Step::GoOn(items) => counting.extend(tenth(items)),
                Step::InPlaceOfLast(items) => {
                    counting.pop();
                    counting.extend(tenth(items));
                }
                Step::InPlaceOfAll(items) | Step::Anew(items) => counting = tenth(items).collect(),
            }
        }
        counting.extend(tenth(succession.end()));
        (counting, succession.astray())
    }

    #[test]
    fn stamps_that_rise_all_count() {
        for stamps in [[1, 2, 3, 4, 5, 6], [1, 2, 900, 901, 902, 5000], [100, 300, 500, 700, 5000, 9000]] {
            assert_eq!(counting(&stamps), (stamps.to_vec(), Astray::default()));
        }
    }

    #[test]
    fn one_wrong_stamp_costs_itself_alone() {
        let (counted, astray) = counting(&[1, 2, 90_000, 3, 4, -5, 5, 6, 6, 7]);
        assert_eq!(counted, [1, 2, 3, 4, 5, 6, 7]);
        assert_eq!((astray.left_out, astray.first, astray.set_back), (3, Some((3, 9_000 * SECOND_NS)), 0));
        // As the first, where nothing spoke against it.
        let (counted, astray) = counting(&[90_000, 1, 2, 3, 4]);
        assert_eq!((counted.as_slice(), astray.left_out, astray.set_back), ([1, 2, 3, 4].as_slice(), 1, 0));
        assert_eq!(astray.first, Some((1, 9_000 * SECOND_NS)));
        // So near that it was believed first.
        let (counted, astray) = counting(&[0, 20, 40, 60, 65, 80, 66, 67, 68, 69]);
        assert_eq!(counted, [0, 20, 40, 60, 65, 66, 67, 68, 69]);
        assert_eq!((astray.left_out, astray.first, astray.set_back), (1, Some((6, 8 * SECOND_NS)), 0));
    }

    #[test]
    fn a_clock_that_is_set_ahead_goes_on_and_one_that_is_set_back_begins_anew() {
        let (counted, astray) = counting(&[1, 2, 3, 9001, 9002, 9003, 9004]);
        assert_eq!((counted.len(), astray), (7, Astray::default()));
        let (counted, astray) = counting(&[1001, 1002, 1003, 1004, 1, 2, 3, 4]);
        assert_eq!((counted.as_slice(), astray.left_out), ([1, 2, 3, 4].as_slice(), 0));
        assert_eq!((astray.set_back, astray.first_set_back), (1, Some((5, 100 * SECOND_NS + 300_000_000))));
        assert_eq!(astray.to_string(), "its clock was set back by 100.300 s, at message 5");
    }

    #[test]
    fn after_a_pause_a_stamp_follows_that_another_clock_agrees_with() {
        let mut succession = Succession::default();
        assert_eq!(succession.push_after(0, SECOND_NS, ()), Step::Follows(()));
        assert_eq!(succession.push_after(9 * SECOND_NS, 10 * SECOND_NS, ()), Step::Follows(()));
        assert_eq!(succession.push_after(9 * SECOND_NS, 9000 * SECOND_NS, ()), Step::Held);
        assert_eq!(succession.push_after(SECOND_NS, 11 * SECOND_NS, ()), Step::Follows(()));
    }

    #[test]
    fn two_clocks_in_turns_leave_one_of_them_out() {
        let in_turns: Vec<i64> = (0..50).flat_map(|tick| [10_000 + tick, tick]).collect();
        let (counted, astray) = counting(&in_turns);
        assert_eq!((counted.len(), astray.left_out, astray.set_back), (50, 50, 0));
    }
}
