//! Float centres packed so that one row is compared with sixteen centres at once.

use super::centres::Nearest;

/// Centres in one panel.
pub(super) const LANES: usize = 16;

/// Neighbouring dimensions in one step.
pub(super) const STEP_DIMENSIONS: usize = 4;

/// Four neighbouring dimensions of the sixteen centres of a panel: dimensions 4i to 4i+3 of the
/// first centre, then of the second, and so on.
pub(super) type PanelStep = [u8; STEP_DIMENSIONS * LANES];

/// Inner products of one row, less 128 in each dimension, with the sixteen centres of a panel.
type Dots = [i32; LANES];

/// Rows that the plain loop searches together.
const PLAIN_GROUP: usize = 4;

/// Float centres for the search of the nearest.
///
/// ‖x − c‖² = ‖x‖² + (‖c‖² − 2 x·c), and ‖x‖² is the same for all centres, so only inner products
/// are computed. Processors multiply unsigned bytes by signed ones, so x is taken less 128:
/// ‖c‖² − 2 x·c = (‖c‖² − 256 Σc) − 2 (x − 128)·c. All in 32-bit integers, which the widest
/// descriptor cannot overflow: the result is exact on every processor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct FloatPanels {
    width: usize,
    len: usize,
    steps: Vec<PanelStep>,
    /// ‖c‖² − 256 Σc; `i32::MAX` in the lanes of the last panel that hold no centre, so that they
    /// never win.
    constants: Vec<[i32; LANES]>,
}

/// Rows to look up, less 128, in groups: of each group the first four dimensions of all its rows,
/// then the next four. `Step` is what a kernel multiplies.
pub(super) struct Queries<Step, const GROUP: usize> {
    rows: usize,
    steps_per_row: usize,
    steps: Vec<[Step; GROUP]>,
}

/// The best centre of each lane so far, for one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LaneBest {
    pub(super) values: [i32; LANES],
    pub(super) panels: [i32; LANES],
}

impl FloatPanels {
    /// Packs consecutive rows of `width` bytes.
    pub(super) fn pack(width: usize, rows: &[u8]) -> Self {
        let steps_per_panel = width.div_ceil(STEP_DIMENSIONS);
        let len = rows.len() / width;
        let mut steps = Vec::with_capacity(len.div_ceil(LANES) * steps_per_panel);
        let mut constants = Vec::with_capacity(len.div_ceil(LANES));
        for panel_rows in rows.chunks(LANES * width) {
            let start = steps.len();
            steps.resize(start + steps_per_panel, [0; STEP_DIMENSIONS * LANES]);
            let mut of_panel = [i32::MAX; LANES];
            for (lane, row) in panel_rows.chunks_exact(width).enumerate() {
                let place = lane * STEP_DIMENSIONS;
                for (step, dimensions) in steps[start..].iter_mut().zip(row.chunks(STEP_DIMENSIONS)) {
                    step[place..place + dimensions.len()].copy_from_slice(dimensions);
                }
                let sum: i32 = row.iter().map(|&value| i32::from(value)).sum();
                of_panel[lane] = squared_norm(row) - 256 * sum;
            }
            constants.push(of_panel);
        }
        Self { width, len, steps, constants }
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Appends centre `index` as it was packed.
    pub(super) fn unpack(&self, index: usize, row: &mut Vec<u8>) {
        let (panel, place) = (index / LANES, index % LANES * STEP_DIMENSIONS);
        let end = row.len() + self.width;
        row.extend(self.panel(panel).iter().flat_map(|step| &step[place..place + STEP_DIMENSIONS]));
        row.truncate(end);
    }

    /// The nearest centre of each row, the lowest number among equals.
    pub(super) fn nearest(&self, rows: &[u8], nearest: &mut [Nearest]) {
        let mut best = vec![LaneBest::NONE; nearest.len()];
        if !super::x86::float_search(self, rows, &mut best) {
            self.search_plainly(rows, &mut best);
        }
        for ((nearest, best), row) in nearest.iter_mut().zip(&best).zip(rows.chunks_exact(self.width)) {
            let (value, id) = best.lowest();
            *nearest = Nearest { id, distance: (value + squared_norm(row)).unsigned_abs() };
        }
    }

    /// Distances of each row from all centres, row by row.
    pub(super) fn distances(&self, rows: &[u8]) -> Vec<u32> {
        let padded = self.constants.len() * LANES;
        let mut values = vec![0; rows.len() / self.width * padded];
        if !super::x86::float_values(self, rows, &mut values) {
            self.values_plainly(rows, &mut values);
        }
        let mut distances = Vec::with_capacity(rows.len() / self.width * self.len);
        for (row, values) in rows.chunks_exact(self.width).zip(values.chunks_exact(padded)) {
            let squared_norm = squared_norm(row);
            distances.extend(values[..self.len].iter().map(|value| (value + squared_norm).unsigned_abs()));
        }
        distances
    }

    /// Takes each panel once for all groups of rows, so that the panel stays in the nearest cache.
    /// `visitor` gets row, panel, the panel's constants and `dots` of both, panels in rising order.
    #[inline(always)]
    pub(super) fn visit<Step, Dots, const GROUP: usize>(
        &self,
        queries: &Queries<Step, GROUP>,
        dots: impl Fn(&[[Step; GROUP]], &[PanelStep]) -> [Dots; GROUP],
        mut visitor: impl FnMut(usize, usize, &[i32; LANES], Dots),
    ) {
        for (panel, constants) in self.constants.iter().enumerate() {
            let steps = self.panel(panel);
            let groups = queries.steps.chunks_exact(queries.steps_per_row);
            for (first, group) in (0..queries.rows).step_by(GROUP).zip(groups) {
                for (row, dots) in (first..queries.rows).zip(dots(group, steps)) {
                    visitor(row, panel, constants, dots);
                }
            }
        }
    }

    fn search_plainly(&self, rows: &[u8], best: &mut [LaneBest]) {
        let queries = Queries::<_, PLAIN_GROUP>::pack(self.width, rows, |step| step);
        self.visit(&queries, dots, |row, panel, constants, dots| {
            best[row].improve(panel as i32, &values(constants, &dots));
        });
    }

    /// ‖c‖² − 2 x·c of each row for all centres and the padding of the last panel, row by row.
    fn values_plainly(&self, rows: &[u8], all: &mut [i32]) {
        let queries = Queries::<_, PLAIN_GROUP>::pack(self.width, rows, |step| step);
        let (all, _) = all.as_chunks_mut::<LANES>();
        self.visit(&queries, dots, |row, panel, constants, dots| {
            all[row * self.constants.len() + panel] = values(constants, &dots);
        });
    }

    pub(super) fn panels(&self) -> usize {
        self.constants.len()
    }

    pub(super) fn width(&self) -> usize {
        self.width
    }

    #[inline(always)]
    fn panel(&self, panel: usize) -> &[PanelStep] {
        let steps_per_panel = self.width.div_ceil(STEP_DIMENSIONS);
        &self.steps[panel * steps_per_panel..(panel + 1) * steps_per_panel]
    }
}

impl<Step: Copy + Default, const GROUP: usize> Queries<Step, GROUP> {
    /// Packs consecutive rows of `width` bytes. Dimensions that are missing in the last step are
    /// those of 0 in any centre, so their value does not matter, nor do rows missing in the last group.
    #[inline(always)]
    pub(super) fn pack(width: usize, rows: &[u8], step: impl Fn([i8; STEP_DIMENSIONS]) -> Step) -> Self {
        let less_128 = |dimensions: [u8; STEP_DIMENSIONS]| dimensions.map(|value| (value ^ 128) as i8);
        let steps_per_row = width.div_ceil(STEP_DIMENSIONS);
        let len = rows.len() / width;
        let mut steps = vec![[Step::default(); GROUP]; len.div_ceil(GROUP) * steps_per_row];
        let groups = steps.chunks_exact_mut(steps_per_row);
        for (group, rows) in groups.zip(rows.chunks(GROUP * width)) {
            for (member, row) in rows.chunks_exact(width).enumerate() {
                let (whole, rest) = row.as_chunks::<STEP_DIMENSIONS>();
                for (steps, &dimensions) in group.iter_mut().zip(whole) {
                    steps[member] = step(less_128(dimensions));
                }
                if let Some(steps) = group.get_mut(whole.len()) {
                    let mut dimensions = [0; STEP_DIMENSIONS];
                    dimensions[..rest.len()].copy_from_slice(rest);
                    steps[member] = step(less_128(dimensions));
                }
            }
        }
        Self { rows: len, steps_per_row, steps }
    }
}

impl LaneBest {
    const NONE: Self = Self { values: [i32::MAX; LANES], panels: [0; LANES] };

    /// Panels come in rising order and only a lower value replaces another, so the lowest panel
    /// stays among equals.
    #[inline(always)]
    fn improve(&mut self, panel: i32, values: &[i32; LANES]) {
        for ((best, panels), &value) in self.values.iter_mut().zip(&mut self.panels).zip(values) {
            let lower = value < *best;
            *best = if lower { value } else { *best };
            *panels = if lower { panel } else { *panels };
        }
    }

    /// The lowest value and the number of its centre, the lowest number among equals: the lowest of
    /// both side by side in one integer.
    fn lowest(&self) -> (i32, u32) {
        let both = (0..LANES).map(|lane| {
            let id = self.panels[lane].unsigned_abs() * LANES as u32 + lane as u32;
            i64::from(self.values[lane]) << 32 | i64::from(id)
        });
        let lowest = both.fold(i64::MAX, i64::min);
        ((lowest >> 32) as i32, lowest as u32)
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

fn squared_norm(row: &[u8]) -> i32 {
    row.iter().map(|&value| i32::from(value) * i32::from(value)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vocabulary::x86;
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
            let mut plain_values = vec![0; plain.len() * panels.constants.len() * LANES];
            panels.search_plainly(&rows, &mut plain);
            panels.values_plainly(&rows, &mut plain_values);
            for kernel in x86::FLOAT_KERNELS {
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
