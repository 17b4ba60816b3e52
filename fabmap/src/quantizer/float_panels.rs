//! Float centres packed so that one row is compared with sixteen centres at once.

/// Centres in one panel.
pub(super) const LANES: usize = 16;

/// Neighbouring dimensions in one step.
pub(super) const STEP_DIMENSIONS: usize = 4;

/// Four neighbouring dimensions of the sixteen centres of a panel: dimensions 4i to 4i+3 of the
/// first centre, then of the second, and so on.
pub(super) type PanelStep = [u8; STEP_DIMENSIONS * LANES];

/// Float centres for the search of the nearest.
///
/// ‖x − c‖² = ‖x‖² + (‖c‖² − 2 x·c), and ‖x‖² is the same for all centres, so only inner products
/// are computed. Processors multiply unsigned bytes by signed ones, so x is taken less 128:
/// ‖c‖² − 2 x·c = (‖c‖² − 256 Σc) − 2 (x − 128)·c. All in 32-bit integers, which the widest
/// descriptor cannot overflow: the result is exact on every processor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct FloatPanels {
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
        let panel = index / LANES;
        let place = index % LANES * STEP_DIMENSIONS;
        let end = row.len() + self.width;
        row.extend(self.panel(panel).iter().flat_map(|step| &step[place..place + STEP_DIMENSIONS]));
        row.truncate(end);
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
    /// those of 0 in any centre, so their value does not matter, nor do rows missing in the last
    /// group.
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

pub(super) fn squared_norm(row: &[u8]) -> i32 {
    row.iter().map(|&value| i32::from(value) * i32::from(value)).sum()
}
