//! What tells that a robot is not where it is believed to be.

use super::guidance::{Driver, LostBecause};
use super::settings::SupervisionSettings;

/// Frames since the last closure in which something known should have been seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct UnknownLooks {
    driving: u32,
    standing: u32,
    /// Those while driving that showed too little to say anything.
    dim: u32,
    /// Driven from the closure to the last of those while driving, in metres.
    at_m: f64,
    /// The same to the last of all.
    last_m: f64,
    /// How long the wheels turned since the closure, by the robot's clock.
    driven_ns: i64,
}

/// What a frame without a closure showed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shown {
    /// Something, and nothing known.
    Something,
    /// Too little to say anything.
    TooLittle,
}

/// What counts as having moved since the last frame that counted.
const MOVED_M: f64 = 0.02;

/// Wheels that turned no further since the last frame stand.
const STANDS_M: f64 = 1e-3;

impl UnknownLooks {
    pub(super) fn add(&mut self, shown: Shown, driver: Driver, since_closure_m: f64) {
        let moved = since_closure_m - self.at_m > MOVED_M;
        let stands = since_closure_m - self.last_m <= STANDS_M;
        self.last_m = since_closure_m;
        let counted = match (driver, shown) {
            (Driver::Commands, Shown::Something) if moved => &mut self.driving,
            (Driver::Commands, Shown::TooLittle) if moved => &mut self.dim,
            // Of a fast camera: it shows what the last one showed.
            (Driver::Commands, Shown::Something | Shown::TooLittle) if !stands => return,
            (Driver::Commands | Driver::Reflex, Shown::Something | Shown::TooLittle) => &mut self.standing,
        };
        *counted += 1;
        if moved {
            self.at_m = since_closure_m;
        }
    }

    /// The wheels turned for so long.
    pub(super) fn drive(&mut self, elapsed_ns: i64) {
        self.driven_ns = self.driven_ns.saturating_add(elapsed_ns);
    }

    /// Why the robot is lost, if it is.
    pub(super) fn too_many(&self, settings: &SupervisionSettings) -> Option<LostBecause> {
        if self.driving >= settings.unknown_looks {
            return Some(LostBecause::UnknownLooks { frames: self.driving });
        }
        if self.standing >= settings.unknown_looks_standing {
            return Some(LostBecause::UnknownLooks { frames: self.standing });
        }
        let frames = self.driving + self.dim;
        let is_long = self.driven_ns >= settings.lost_ns && frames >= settings.lost_looks;
        is_long.then_some(LostBecause::NothingRecognised { frames, driven_ns: self.driven_ns })
    }
}
