//! Float centres packed so that one row is compared with sixteen centres at once.

use super::centres::Nearest;

/// Centres in one panel.
pub(super) const LANES: usize = 16;

/// Two neighbouring dimensions of the sixteen centres of a panel: dimension 2i and 2i+1 of the
/// first centre, then of the second, and so on.
pub(super) type PanelStep = [u8; 2 * LANES];

/// Inner products of one row with the sixteen centres of a panel.
pub(super) type Dots = [i32; LANES];

/// Rows searched together when there are enough: the kernel keeps their products in registers.
pub(super) const GROUP: usize = 4;

/// Float centres for the search of the nearest.
///
/// ‖x − c‖² = ‖x‖² + (‖c‖² − 2 x·c), and ‖x‖² is the same for all centres, so only inner products
/// are computed. All in 32-bit integers, which the widest descriptor cannot overflow: the result
/// is exact on every processor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct FloatPanels {
    width: usize,
    len: usize,
    steps: Vec<PanelStep>,
    /// ‖c‖²; `i32::MAX` in the lanes of the last panel that hold no centre, so that they never win.
    squared_norms: Vec<[i32; LANES]>,
}

/// Rows to look up, widened to what the kernel multiplies: two dimensions in one `i32`.
pub(super) struct Queries {
    steps_per_row: usize,
    pairs: Vec<i32>,
}

/// The best centre of each lane so far, for one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LaneBest {
    values: [i32; LANES],
    panels: [u32; LANES],
}

impl FloatPanels {
    /// Packs consecutive rows of `width` bytes.
    pub(super) fn pack(width: usize, rows: &[u8]) -> Self {
        let steps_per_panel = width.div_ceil(2);
        let len = rows.len() / width;
        let mut steps = Vec::with_capacity(len.div_ceil(LANES) * steps_per_panel);
        let mut squared_norms = Vec::with_capacity(len.div_ceil(LANES));
        for panel_rows in rows.chunks(LANES * width) {
            let start = steps.len();
            steps.resize(start + steps_per_panel, [0; 2 * LANES]);
            let mut norms = [i32::MAX; LANES];
            for (lane, row) in panel_rows.chunks_exact(width).enumerate() {
                for (step, dimensions) in steps[start..].iter_mut().zip(row.chunks(2)) {
                    step[2 * lane..2 * lane + dimensions.len()].copy_from_slice(dimensions);
                }
                norms[lane] = squared_norm(row);
            }
            squared_norms.push(norms);
        }
        Self { width, len, steps, squared_norms }
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Appends centre `index` as it was packed.
    pub(super) fn unpack(&self, index: usize, row: &mut Vec<u8>) {
        let (panel, lane) = (index / LANES, index % LANES);
        let end = row.len() + self.width;
        row.extend(self.panel(panel).iter().flat_map(|step| [step[2 * lane], step[2 * lane + 1]]));
        row.truncate(end);
    }

    /// The nearest centre of each row, the lowest number among equals.
    pub(super) fn nearest(&self, rows: &[u8], nearest: &mut [Nearest]) {
        let queries = Queries::pack(self.width, rows);
        let mut best = vec![LaneBest::NONE; nearest.len()];
        if !super::avx2::float_nearest(self, &queries, &mut best) {
            self.search(&queries, &mut best, dots::<GROUP>, dots::<1>);
        }
        for ((nearest, best), row) in nearest.iter_mut().zip(&best).zip(rows.chunks_exact(self.width)) {
            let (value, id) = best.lowest();
            *nearest = Nearest { id, distance: (value + squared_norm(row)).unsigned_abs() };
        }
    }

    /// Distances of one row from all centres.
    pub(super) fn distances(&self, row: &[u8]) -> Vec<u32> {
        let query = Queries::pack(self.width, row);
        let mut values = Vec::with_capacity(self.squared_norms.len() * LANES);
        if !super::avx2::float_values(self, &query, &mut values) {
            self.values(&query, &mut values, dots::<1>);
        }
        let squared_norm = squared_norm(row);
        values.truncate(self.len);
        values.into_iter().map(|value| (value + squared_norm).unsigned_abs()).collect()
    }

    /// The search itself. It takes each panel once for all rows, so that the panel stays in the
    /// nearest cache. `group_dots` and `single_dots` are [`dots`] or a faster equal.
    #[inline(always)]
    pub(super) fn search(
        &self,
        queries: &Queries,
        best: &mut [LaneBest],
        group_dots: impl Fn([&[i32]; GROUP], &[PanelStep]) -> [Dots; GROUP],
        single_dots: impl Fn([&[i32]; 1], &[PanelStep]) -> [Dots; 1],
    ) {
        let (group_best, single_best) = best.as_chunks_mut::<GROUP>();
        let grouped = group_best.len() * GROUP;
        for (panel, norms) in self.squared_norms.iter().enumerate() {
            let steps = self.panel(panel);
            for (group, best) in group_best.iter_mut().enumerate() {
                let rows = std::array::from_fn(|row| queries.row(group * GROUP + row));
                for (best, dots) in best.iter_mut().zip(group_dots(rows, steps)) {
                    best.improve(panel as u32, &values(norms, &dots));
                }
            }
            for (row, best) in single_best.iter_mut().enumerate() {
                let [dots] = single_dots([queries.row(grouped + row)], steps);
                best.improve(panel as u32, &values(norms, &dots));
            }
        }
    }

    /// ‖c‖² − 2 x·c of one row for all centres, with the padding of the last panel.
    #[inline(always)]
    pub(super) fn values(
        &self,
        query: &Queries,
        all: &mut Vec<i32>,
        single_dots: impl Fn([&[i32]; 1], &[PanelStep]) -> [Dots; 1],
    ) {
        for (panel, norms) in self.squared_norms.iter().enumerate() {
            let [dots] = single_dots([query.row(0)], self.panel(panel));
            all.extend(values(norms, &dots));
        }
    }

    #[inline(always)]
    fn panel(&self, panel: usize) -> &[PanelStep] {
        let steps_per_panel = self.width.div_ceil(2);
        &self.steps[panel * steps_per_panel..(panel + 1) * steps_per_panel]
    }
}

impl Queries {
    fn pack(width: usize, rows: &[u8]) -> Self {
        let widen = |dimensions: &[u8]| {
            let second = dimensions.get(1).copied().unwrap_or(0);
            i32::from(dimensions[0]) | i32::from(second) << 16
        };
        let pairs = rows.chunks_exact(width).flat_map(|row| row.chunks(2).map(widen)).collect();
        Self { steps_per_row: width.div_ceil(2), pairs }
    }

    #[inline(always)]
    fn row(&self, row: usize) -> &[i32] {
        &self.pairs[row * self.steps_per_row..(row + 1) * self.steps_per_row]
    }
}

impl LaneBest {
    const NONE: Self = Self { values: [i32::MAX; LANES], panels: [0; LANES] };

    /// Panels come in rising order and only a lower value replaces another, so the lowest panel
    /// stays among equals.
    #[inline(always)]
    fn improve(&mut self, panel: u32, values: &[i32; LANES]) {
        for ((best, panels), &value) in self.values.iter_mut().zip(&mut self.panels).zip(values) {
            let lower = value < *best;
            *best = if lower { value } else { *best };
            *panels = if lower { panel } else { *panels };
        }
    }

    fn lowest(&self) -> (i32, u32) {
        let ids = self.panels.iter().enumerate().map(|(lane, panel)| panel * LANES as u32 + lane as u32);
        self.values.iter().copied().zip(ids).min().unwrap_or((i32::MAX, 0))
    }
}

#[inline(always)]
fn values(norms: &[i32; LANES], dots: &Dots) -> [i32; LANES] {
    std::array::from_fn(|lane| norms[lane] - 2 * dots[lane])
}

/// Inner products of `ROWS` rows with the centres of a panel, for any processor.
#[inline(always)]
pub(super) fn dots<const ROWS: usize>(rows: [&[i32]; ROWS], panel: &[PanelStep]) -> [Dots; ROWS] {
    let mut dots = [[0; LANES]; ROWS];
    for (row, dots) in rows.iter().zip(&mut dots) {
        for (&pair, step) in row.iter().zip(panel) {
            let (first, second) = (pair & 0xffff, pair >> 16);
            for lane in 0..LANES {
                dots[lane] += first * i32::from(step[2 * lane]) + second * i32::from(step[2 * lane + 1]);
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
    use crate::vocabulary::avx2;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn vector_instructions_and_plain_loops_agree(
            width in 1..40usize,
            centres in proptest::collection::vec(any::<u8>(), 40..2000),
            rows in proptest::collection::vec(any::<u8>(), 40..800),
        ) {
            let panels = FloatPanels::pack(width, &centres[..centres.len() / width * width]);
            let queries = Queries::pack(width, &rows);
            let mut plain = vec![LaneBest::NONE; rows.len() / width];
            let mut vector = plain.clone();
            panels.search(&queries, &mut plain, dots::<GROUP>, dots::<1>);
            if avx2::float_nearest(&panels, &queries, &mut vector) {
                prop_assert_eq!(&vector, &plain);
            }
            let (mut plain, mut vector) = (Vec::new(), Vec::new());
            panels.values(&queries, &mut plain, dots::<1>);
            if avx2::float_values(&panels, &queries, &mut vector) {
                prop_assert_eq!(vector, plain);
            }
        }
    }
}
