//! What a repair could not bring back, and how that is told.

/// What is lost that is told by name.
const MOST_TOLD: usize = 20;

/// What could not be brought back.
#[derive(Debug, Default)]
pub(super) struct Losses {
    pub(super) events: Vec<String>,
    /// What robots measured.
    pub(super) measured: u64,
    /// What people said of loop closures that the new map does not have.
    pub(super) corrections: Vec<String>,
    pub(super) labels: Vec<String>,
    /// What is kept of frames beside the log.
    pub(super) beside: Vec<String>,
}

impl Losses {
    pub(super) fn in_words(&self) -> String {
        let Self { events, measured, corrections, labels, beside } = self;
        let mut told = Vec::new();
        let lost: Vec<&str> =
            [events, beside, corrections, labels].into_iter().flatten().map(String::as_str).collect();
        if !lost.is_empty() {
            let named = lost.iter().take(MOST_TOLD).copied().collect::<Vec<_>>().join("; ");
            told.push(match lost.len().saturating_sub(MOST_TOLD) {
                0 => format!("lost: {named}"),
                more => format!("lost: {named}; and {more} more"),
            });
        }
        if *measured > 0 {
            told.push(format!("to be measured again: {measured} poses that robots measured"));
        }
        if told.is_empty() { "nothing is lost".to_owned() } else { told.join("; ") }
    }
}
