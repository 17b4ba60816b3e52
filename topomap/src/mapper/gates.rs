//! What a frame has to pass to close a loop.

use fabmap::appearance::PlaceId;
use fabmap::recognizer::Recognition;

use super::frame::FrameInput;
use super::state::Mapper;

/// The conditions for a loop closure with one place, in the order of checking.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gates {
    /// The place.
    pub place: PlaceId,
    /// Different words of the frame, against the fewest that say anything.
    pub words: Gate,
    /// Posterior of the place, against that of somewhere new.
    pub known_place: Gate,
    /// Frames since the session was there, as the guard counts them. All of the session's if it was
    /// not there lately.
    pub guard: Gate,
    /// Posterior of the place, against the map's threshold.
    pub threshold: Gate,
}

/// One condition: `value` must be at least `required`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// Whether it holds.
    pub passed: bool,
    /// What was found.
    pub value: f64,
    /// What is asked for.
    pub required: f64,
}

impl Mapper {
    /// How the frame `input`, recognised as `recognition`, stands with `place`. None if there is no
    /// such place or session.
    #[must_use]
    pub fn gates(&self, input: &FrameInput, recognition: &Recognition, place: PlaceId) -> Option<Gates> {
        let posterior = *recognition.posterior.places.get(place.index())?;
        let session = self.map().session(input.session)?;
        let at_least = |value: f64, required: f64| Gate { passed: value >= required, value, required };
        let since = session.since(place, self.settings());
        Some(Gates {
            place,
            words: at_least(input.observation.len() as f64, self.settings().min_words as f64),
            known_place: at_least(posterior, recognition.posterior.new_place),
            guard: Gate {
                passed: since.is_none(),
                value: since.unwrap_or(session.gone(self.settings())),
                required: self.settings().guard_frames as f64,
            },
            threshold: at_least(posterior, self.settings().closure_threshold),
        })
    }
}
