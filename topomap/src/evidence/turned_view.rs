//! Does a robot see all around what it saw before, from the same spot?

/// What two panoramas have in common if the robot has at most turned on the spot between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TurnedView {
    /// Features of the view that has fewer.
    pub features: u32,
    /// Features that look alike, and like nothing else.
    pub matches: u32,
    /// Those of the matches that one turn about the upright axis explains: they have no parallax.
    pub turned: u32,
}

/// Least share of the features that match where nothing has moved: noise and other pixels leave 0.6
/// to 0.9 of them, and somebody may pass by.
const MATCHING_SHARE: f64 = 0.4;

/// Least share of the matches that have no parallax there: they are three quarters at least by
/// turns alone, and two thirds at most once the robot has moved by 10 cm in an office.
const TURNED_SHARE: f64 = 0.7;

impl TurnedView {
    /// Whether nearly all is seen from the same spot.
    #[must_use]
    pub fn is_from_the_same_spot(&self) -> bool {
        let Self { features, matches, turned } = *self;
        f64::from(matches) >= MATCHING_SHARE * f64::from(features.max(1))
            && f64::from(turned) >= TURNED_SHARE * f64::from(matches)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_nearly_all_and_without_parallax() {
        let view = |features, matches, turned| TurnedView { features, matches, turned };
        for same in [view(500, 500, 500), view(500, 200, 140)] {
            assert!(same.is_from_the_same_spot(), "{same:?}");
        }
        for other in [view(500, 199, 199), view(500, 400, 279), view(0, 0, 0), view(500, 0, 0)] {
            assert!(!other.is_from_the_same_spot(), "{other:?}");
        }
    }
}
