//! The search for the nearest float centre, by the fastest instructions of this processor.

use super::float_panels::{FloatPanels, LANES, PanelStep, Queries, STEP_DIMENSIONS, squared_norm};
use super::kernels;
use super::lane_best::LaneBest;
use super::nearest::Nearest;

/// Inner products of one row, less 128 in each dimension, with the sixteen centres of a panel.
type Dots = [i32; LANES];

/// Rows that the plain loop searches together.
const PLAIN_GROUP: usize = 4;

impl FloatPanels {
    /// The nearest centre of each row, the lowest number among equals.
    pub(super) fn nearest(&self, rows: &[u8], nearest: &mut [Nearest]) {
        let mut best = vec![LaneBest::NONE; nearest.len()];
        if !kernels::float_search(self, rows, &mut best) {
            self.search_plainly(rows, &mut best);
        }
        for ((nearest, best), row) in nearest.iter_mut().zip(&best).zip(rows.chunks_exact(self.width())) {
            let (value, id) = best.lowest();
            *nearest = Nearest { id, distance: (value + squared_norm(row)).unsigned_abs() };
        }
    }

    /// Distances of each row from all centres, row by row.
    pub(super) fn distances(&self, rows: &[u8]) -> Vec<u32> {
        let padded = self.panels() * LANES;
        let mut values = vec![0; rows.len() / self.width() * padded];
        if !kernels::float_values(self, rows, &mut values) {
            self.values_plainly(rows, &mut values);
        }
        let mut distances = Vec::with_capacity(rows.len() / self.width() * self.len());
        for (row, values) in rows.chunks_exact(self.width()).zip(values.chunks_exact(padded)) {
            let squared_norm = squared_norm(row);
            distances.extend(values[..self.len()].iter().map(|value| (value + squared_norm).unsigned_abs()));
        }
        distances
    }

    fn search_plainly(&self, rows: &[u8], best: &mut [LaneBest]) {
        let queries = Queries::<_, PLAIN_GROUP>::pack(self.width(), rows, |step| step);
        self.visit(&queries, dots, |row, panel, constants, dots| {
            best[row].improve(panel as i32, &values(constants, &dots));
        });
    }

    /// ‖c‖² − 2 x·c of each row for all centres and the padding of the last panel, row by row.
    fn values_plainly(&self, rows: &[u8], all: &mut [i32]) {
        let queries = Queries::<_, PLAIN_GROUP>::pack(self.width(), rows, |step| step);
        let (all, _) = all.as_chunks_mut::<LANES>();
        self.visit(&queries, dots, |row, panel, constants, dots| {
            all[row * self.panels() + panel] = values(constants, &dots);
        });
    }
}

#[inline(always)]
fn values(constants: &[i32; LANES], dots: &Dots) -> [i32; LANES] {
    std::array::from_fn(|lane| constants[lane] - 2 * dots[lane])
}

/// Inner products of a group of rows with the centres of a panel, for any processor.
#[inline(always)]
fn dots<const GROUP: usize>(group: &[[[i8; STEP_DIMENSIONS]; GROUP]], panel: &[PanelStep]) -> [Dots; GROUP] {
    let mut dots = [[0; LANES]; GROUP];
    for (queries, step) in group.iter().zip(panel) {
        let (centres, _) = step.as_chunks::<STEP_DIMENSIONS>();
        for (query, dots) in queries.iter().zip(&mut dots) {
            for (dot, centre) in dots.iter_mut().zip(centres) {
                for (&query, &value) in query.iter().zip(centre) {
                    *dot += i32::from(query) * i32::from(value);
                }
            }
        }
    }
    dots
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn vector_instructions_and_plain_loops_agree(
            width in 1..40usize,
            centres in proptest::collection::vec(any::<u8>(), 40..2000),
            rows in proptest::collection::vec(any::<u8>(), 40..800),
        ) {
            let panels = FloatPanels::pack(width, &centres[..centres.len() / width * width]);
            let mut plain = vec![LaneBest::NONE; rows.len() / width];
            let mut plain_values = vec![0; plain.len() * panels.panels() * LANES];
            panels.search_plainly(&rows, &mut plain);
            panels.values_plainly(&rows, &mut plain_values);
            for kernel in kernels::FLOAT_KERNELS {
                let mut vector = vec![LaneBest::NONE; plain.len()];
                if (kernel.search)(&panels, &rows, &mut vector) {
                    prop_assert_eq!(&vector, &plain);
                }
                let mut values = vec![0; plain_values.len()];
                if (kernel.values)(&panels, &rows, &mut values) {
                    prop_assert_eq!(&values, &plain_values);
                }
            }
        }
    }
}
