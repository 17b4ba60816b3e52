//! Places that a frame is compared with, and what speaks for them.

use fabmap::appearance::PlaceId;
use fabmap::codec::{DecodeError, Reader, Writer};

use super::look_alikes::unknown_over_frames;
use super::placement::Placement;
use super::probability::{Contributions, ProbabilityWeights};
use super::two_view::{CandidateForm, TwoView};
#[cfg(test)]
use super::two_view::{Similarity, ViewMotion};
use crate::bytes::{decode_option, encode_option, finite, not_negative};
use crate::ids::FrameId;
use crate::metric::RelativePose;

/// An earlier frame of a place, as a match.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// The place.
    pub place: PlaceId,
    /// Its posterior probability.
    pub posterior: f64,
    /// ln [posterior / (1 - posterior)], nats: tells apart what rounds to 1.
    pub log_odds: f64,
    /// Of the frames that the place has learnt from, the one that explains the observation best.
    pub frame: FrameId,
}

impl Match {
    pub(crate) fn encode(&self, writer: &mut Writer) {
        let Match { place, posterior, log_odds, frame } = self;
        writer.u32(place.number());
        writer.f64(*posterior);
        writer.f64(*log_odds);
        writer.u64(*frame);
    }

    pub(crate) fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Match {
            place: PlaceId::new(reader.u32()?),
            posterior: reader.f64()?,
            log_odds: reader.f64()?,
            frame: reader.u64()?,
        })
    }
}

/// Evidence of a pair of frames that lets the frames before speak in full. Recall at full precision
/// on the development sequences is the same from 10 to 30.
const ENOUGH: f64 = 20.0;

/// What a feature of known depth adds that agrees where the robot is. Of pairs of the simulated
/// worlds that are more than a metre off, none that stands alone gets to two thirds of the evidence
/// that is asked for.
const WORTH_OF_PLACED: f64 = 2.0;

/// A place that a frame was compared with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The place, and the frame of it that was compared.
    pub matched: Match,
    /// What geometry found; `None` if one of the two frames has no keypoints.
    pub view: Option<TwoView>,
    /// What the session's last frames said for a place near this one, in inliers.
    pub support: f64,
    /// Where in the place's frame the robot was at that frame, if it is known.
    pub seen_from: Option<RelativePose>,
    /// What the best look-alike of this kind of place is expected to come to over the same frames,
    /// in inliers, above 0. Where the session took that frame itself, and has not lost sight of what
    /// lies between, what that comes to, if it is more.
    pub look_alike_inliers: f64,
    /// ln [p / (1 - p)] of the probability that both frames show the same place, by all that is
    /// known, in nats; see [`ProbabilityWeights`]. Without a view, by words alone.
    pub log_odds_nats: f64,
}

#[cfg(test)]
impl Candidate {
    /// A view that a good deal speaks for, whose image has grown and shifted by so much.
    pub(crate) fn shifted(ln_scale: f64, shift_widths: f64) -> Self {
        let motion = Similarity { rotation_rad: 0.0, ln_scale, translation_widths: [shift_widths, 0.0] };
        let motion = Some(ViewMotion::Similarity(motion));
        let placement = Placement::Unknown;
        let view = TwoView { matches: 90, inliers: 80, distinct_inliers: 80, motion, placement };
        let matched = Match { place: PlaceId::new(0), posterior: 1.0, log_odds: 9.0, frame: 1 };
        Self::new(matched, Some(view), None, 10.0).judged(0.0, &ProbabilityWeights::default())
    }
}

impl Candidate {
    /// What was compared, before it is judged.
    #[must_use]
    pub fn new(
        matched: Match,
        view: Option<TwoView>,
        seen_from: Option<RelativePose>,
        look_alike_inliers: f64,
    ) -> Self {
        let log_odds_nats = matched.log_odds;
        Self { matched, view, support: 0.0, seen_from, look_alike_inliers, log_odds_nats }
    }

    /// The same with what the last frames say for it, and how probable that makes it by `weights`.
    #[must_use]
    pub fn judged(self, support: f64, weights: &ProbabilityWeights) -> Self {
        let supported = Self { support, ..self };
        let log_odds_nats = match self.view {
            Some(_) => supported.contributions(weights).log_odds_nats(),
            None => self.matched.log_odds,
        };
        Self { log_odds_nats, ..supported }
    }

    /// That both frames show the same place, in [0, 1]: what is held against the map's threshold.
    /// Without keypoints the posterior.
    #[must_use]
    pub fn probability(&self) -> f64 {
        match self.view {
            Some(_) => 1.0 / (1.0 + (-self.log_odds_nats).exp()),
            None => self.matched.posterior,
        }
    }

    /// What speaks for it and against it, in nats. Without keypoints the posterior decides alone,
    /// and this says nothing.
    #[must_use]
    pub fn contributions(&self, weights: &ProbabilityWeights) -> Contributions {
        weights.contributions(self.evidence(), self.look_alike_inliers, self.matched.log_odds)
    }

    /// min(1, e / 20) (e + 2 p + support) with e the pair's own evidence and p the features of known
    /// depth that agree where the robot is, in inliers: what this frame and the last ones say
    /// together, once this one says enough. A robot that has just left its old way still has the
    /// support, and no match.
    #[must_use]
    pub fn evidence(&self) -> f64 {
        let own = self.own_evidence();
        let placed = self.view.map_or(0, |view| view.placement.inliers());
        (own / ENOUGH).min(1.0) * (own + WORTH_OF_PLACED * f64::from(placed) + self.support)
    }

    /// Where in the place's frame the robot is now, if structure measured it.
    #[must_use]
    pub fn placed(&self) -> Option<RelativePose> {
        match self.view.as_ref()?.placement {
            Placement::At { pose, inliers: _ } => Some(self.seen_from?.then(&pose)),
            Placement::Unknown | Placement::Nowhere => None,
        }
    }

    /// See [`TwoView::evidence`].
    #[must_use]
    pub fn own_evidence(&self) -> f64 {
        self.view.as_ref().map_or(0.0, TwoView::evidence)
    }

    /// What proposals are ranked by: first those that geometry has evidence for, by their log-odds;
    /// then all others by the log-odds of their posterior, less [`Candidate::UNVERIFIED`].
    #[must_use]
    pub fn score(&self) -> f64 {
        if self.evidence() > 0.0 { self.log_odds_nats } else { self.matched.log_odds - Self::UNVERIFIED }
    }

    /// More than any log-odds.
    pub const UNVERIFIED: f64 = 1000.0;
}

impl Candidate {
    pub(crate) fn encode(&self, writer: &mut Writer) {
        let Candidate { matched, view, support, seen_from, look_alike_inliers, log_odds_nats } = self;
        matched.encode(writer);
        encode_option(view.as_ref(), writer, TwoView::encode);
        writer.f64(*support);
        encode_option(seen_from.as_ref(), writer, RelativePose::encode);
        writer.f64(*look_alike_inliers);
        writer.f64(*log_odds_nats);
    }

    pub(crate) fn decode(form: CandidateForm, reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let matched = Match::decode(reader)?;
        let view = decode_option(reader, |reader| TwoView::decode(form, reader))?;
        let support = not_negative(reader.f64()?)?;
        let seen_from = match form {
            CandidateForm::WithoutPlacement => None,
            CandidateForm::WithPlacement | CandidateForm::WithProbability => {
                decode_option(reader, RelativePose::decode)?
            }
        };
        match form {
            CandidateForm::WithoutPlacement | CandidateForm::WithPlacement => {
                let candidate = Self::new(matched, view, seen_from, unknown_over_frames());
                Ok(candidate.judged(support, &ProbabilityWeights::default()))
            }
            CandidateForm::WithProbability => {
                let look_alike_inliers = not_negative(reader.f64()?)?;
                let log_odds_nats = finite(reader.f64()?)?;
                if look_alike_inliers == 0.0 {
                    return Err(DecodeError::invalid("look-alikes of no inlier"));
                }
                Ok(Candidate { matched, view, support, seen_from, look_alike_inliers, log_odds_nats })
            }
        }
    }
}
