//! Fewer steps that fail still: pieces of the list are left out, larger ones first, for as long as there is time.

use std::time::{Duration, Instant};

use super::operations::Step;

/// Leaves out what the failure does not need. `fails` runs a list of steps from nothing.
pub(super) async fn shrunk<F: Future<Output = Option<String>>>(
    mut steps: Vec<Step>,
    mut why: String,
    within: Duration,
    fails: impl Fn(Vec<Step>) -> F,
) -> (Vec<Step>, String) {
    let until = Instant::now() + within;
    let mut piece = steps.len() / 2;
    while piece > 0 {
        let mut from = 0;
        let mut any = false;
        while from < steps.len() {
            if Instant::now() > until {
                return (steps, why);
            }
            let fewer: Vec<Step> =
                steps[..from].iter().chain(steps.iter().skip(from + piece)).cloned().collect();
            match fails(fewer.clone()).await {
                Some(still) => {
                    (steps, why, any) = (fewer, still, true);
                }
                None => from += piece,
            }
        }
        // A single step may go once another one has.
        piece = if piece == 1 && any { 1 } else { piece / 2 };
    }
    (steps, why)
}
