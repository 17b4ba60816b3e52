//! A centre and how far it is.

/// The centre nearest to a row, and its distance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Nearest {
    pub(crate) id: u32,
    pub(crate) distance: u32,
}

impl Nearest {
    /// Takes a centre that is nearer than the one so far; offered in rising order, the lowest
    /// number stays among equals.
    #[inline(always)]
    pub(crate) fn improve(&mut self, id: u32, distance: u32) {
        if distance < self.distance {
            *self = Self { id, distance };
        }
    }
}
