//! Whether a candidate is the same place, number by number.

/// Whether a candidate is the same place, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// What must hold altogether, in the order of checking: both views may be of one scene, and,
    /// since look-alike scenes may too, that they show the same place is probable enough.
    pub checks: Vec<Check>,
}

/// One number of a verdict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Check {
    /// What was looked at.
    pub quantity: Quantity,
    /// What was found.
    pub value: f64,
    /// What is asked for.
    pub bound: Bound,
}

/// What is asked of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// It must not be less.
    AtLeast(f64),
    /// It must not be more.
    AtMost(f64),
}

/// What a verdict looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Quantity {
    /// [`super::TwoView::inliers`].
    Inliers,
    /// [`super::Candidate::probability`].
    Probability,
    /// Of the place, where nothing but words can tell.
    Posterior,
    /// |rotation|, in the image plane or in space, in radians.
    RotationRad,
    /// |ln s|.
    LnScale,
    /// |t|, in image widths.
    TranslationWidths,
    /// Features of known depth that agree where the robot is: [`super::Placement`].
    PlacedInliers,
    /// From the earlier frame to the current one as structure measures it, in metres.
    DistanceM,
    /// The same, |heading| in radians.
    HeadingRad,
}

impl std::fmt::Display for Quantity {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Quantity::Inliers => "inliers",
            Quantity::Probability => "probability",
            Quantity::Posterior => "posterior",
            Quantity::RotationRad => "rotation",
            Quantity::LnScale => "scale",
            Quantity::TranslationWidths => "translation",
            Quantity::PlacedInliers => "inliers of known depth",
            Quantity::DistanceM => "distance",
            Quantity::HeadingRad => "heading",
        })
    }
}

impl Verdict {
    /// Whether it is accepted.
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        self.failed().is_none()
    }

    /// The first check for which it is refused.
    #[must_use]
    pub fn failed(&self) -> Option<&Check> {
        self.checks.iter().find(|check| !check.passed())
    }
}

impl Check {
    /// Whether the value keeps to the bound.
    #[must_use]
    pub fn passed(&self) -> bool {
        match self.bound {
            Bound::AtLeast(least) => self.value >= least,
            Bound::AtMost(most) => self.value <= most,
        }
    }
}
