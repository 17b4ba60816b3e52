//! The best centre so far of each of sixteen lanes.

use super::float_panels::LANES;

/// The best centre of each lane so far, for one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LaneBest {
    pub(super) values: [i32; LANES],
    pub(super) panels: [i32; LANES],
}

impl LaneBest {
    pub(super) const NONE: Self = Self { values: [i32::MAX; LANES], panels: [0; LANES] };

    /// Panels come in rising order and only a lower value replaces another, so the lowest panel
    /// stays among equals.
    #[inline(always)]
    pub(super) fn improve(&mut self, panel: i32, values: &[i32; LANES]) {
        for ((best, panels), &value) in self.values.iter_mut().zip(&mut self.panels).zip(values) {
            let lower = value < *best;
            *best = if lower { value } else { *best };
            *panels = if lower { panel } else { *panels };
        }
    }

    /// The lowest value and the number of its centre, the lowest number among equals: the lowest of
    /// both side by side in one integer.
    pub(super) fn lowest(&self) -> (i32, u32) {
        let both = (0..LANES).map(|lane| {
            let id = self.panels[lane].unsigned_abs() * LANES as u32 + lane as u32;
            i64::from(self.values[lane]) << 32 | i64::from(id)
        });
        let lowest = both.fold(i64::MAX, i64::min);
        ((lowest >> 32) as i32, lowest as u32)
    }
}
