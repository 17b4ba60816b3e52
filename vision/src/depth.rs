//! How far features are, as far as that is known.

/// How near a feature is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepth {
    /// One over its depth along the camera's axis, in 1/m; near 0 for what is far away.
    pub per_m: f64,
    /// Standard deviation, in 1/m, above 0.
    pub sigma_per_m: f64,
}

/// The depths of a frame's features, as far as they are known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Structure {
    depths: Vec<Option<InverseDepth>>,
}

impl Structure {
    /// Depths by feature.
    #[must_use]
    pub(crate) fn new(depths: Vec<Option<InverseDepth>>) -> Self {
        Self { depths }
    }

    /// Depths by feature; `None` where one is not known. Empty where none is: of a session's first
    /// frame, or where wheels or camera are not known.
    #[must_use]
    pub fn depths(&self) -> &[Option<InverseDepth>] {
        &self.depths
    }

    /// How many features have one.
    #[must_use]
    pub fn known(&self) -> usize {
        self.depths.iter().flatten().count()
    }
}
