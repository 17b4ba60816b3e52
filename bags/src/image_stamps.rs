//! Which images of a topic are used, by their stamps.

use crate::error::{LeftOut, Problem};
use crate::succession::{Step, Succession};
use crate::survey::Topic;

/// Stamps of the images that can be used: they follow each other ([`Succession`] has the rule), and rise, which maps ask
/// for. So single wrong ones are left out, and all after a clock that was set back, up to where it was.
pub(crate) fn stamps(images: &Topic, stamps: Vec<Option<i64>>) -> (Vec<Option<i64>>, Option<LeftOut>) {
    let chosen = chosen(&stamps);
    let mut left_out = images.left_out.clone();
    let mut before_ns = 0;
    let mut stamps_ns = Vec::with_capacity(stamps.len());
    for (((number, image), stamp_ns), is_chosen) in (1..).zip(&images.images).zip(stamps).zip(chosen) {
        let problem = match stamp_ns {
            Some(stamp_ns) if stamp_ns <= 0 => Some(Problem::NoStamp),
            Some(stamp_ns) if stamp_ns <= before_ns => Some(Problem::NotRising { stamp_ns, before_ns }),
            Some(stamp_ns) if !is_chosen => Some(Problem::Astray { stamp_ns, before_ns }),
            Some(stamp_ns) => {
                before_ns = stamp_ns;
                None
            }
            None => None,
        };
        stamps_ns.push(stamp_ns.filter(|_| problem.is_none()));
        if let Some(problem) = problem {
            leave_out(&mut left_out, number, image.log_ns, problem);
        }
    }
    (stamps_ns, left_out)
}

/// Which stamps follow each other.
fn chosen(stamps: &[Option<i64>]) -> Vec<bool> {
    let mut chosen = vec![false; stamps.len()];
    let mut order = Succession::default();
    // Of the latest that counts, and of the first since all began anew.
    let (mut last, mut first) = (0, 0);
    for (index, stamp_ns) in stamps.iter().enumerate() {
        let Some(stamp_ns) = stamp_ns.filter(|stamp_ns| *stamp_ns > 0) else { continue };
        let items = match order.push(stamp_ns, index) {
            Step::Follows(index) => vec![(stamp_ns, index)],
            Step::Held | Step::Repeats => continue,
            Step::GoOn(items) => items,
            Step::InPlaceOfLast(items) => {
                chosen[last] = false;
                items
            }
            Step::InPlaceOfAll(items) => {
                chosen[first..=last].fill(false);
                items
            }
            Step::Anew(items) => {
                first = items.first().map_or(first, |(_, index)| *index);
                items
            }
        };
        for (_, index) in items {
            chosen[index] = true;
            last = index;
        }
    }
    order.end().into_iter().for_each(|(_, index)| chosen[index] = true);
    chosen
}
fn leave_out(left_out: &mut Option<LeftOut>, number: u64, log_ns: i64, problem: Problem) {
    let this = LeftOut { count: 1, first_number: number, first_log_ns: log_ns, first_problem: problem };
    *left_out = Some(match left_out.take() {
        None => this,
        Some(other) => {
            let count = other.count + 1;
            let first = if other.first_number <= number { other } else { this };
            LeftOut { count, ..first }
        }
    });
}
