//! Why a place got its posterior, as it is shown.

use std::io::{self, Write};

use serde::Serialize;
use waypost_client::v1;

#[derive(Serialize)]
pub(crate) struct PlaceExplanationView {
    place: u32,
    prior: f64,
    posterior: f64,
    new_place_posterior: f64,
    log_likelihood: f64,
    new_place_log_likelihood: f64,
    average_place_log_likelihood: f64,
    words_for: Vec<WordEvidenceView>,
    words_against: Vec<WordEvidenceView>,
    other_words_nats: f64,
}

#[derive(Serialize)]
struct WordEvidenceView {
    word: u32,
    seen: bool,
    hits: u32,
    looks: u32,
    nats: f64,
}

impl From<v1::PlaceExplanation> for PlaceExplanationView {
    fn from(explanation: v1::PlaceExplanation) -> Self {
        let v1::PlaceExplanation {
            place,
            prior,
            posterior,
            new_place_posterior,
            log_likelihood,
            new_place_log_likelihood,
            average_place_log_likelihood,
            words_for,
            words_against,
            other_words_nats,
        } = explanation;
        Self {
            place,
            prior,
            posterior,
            new_place_posterior,
            log_likelihood,
            new_place_log_likelihood,
            average_place_log_likelihood,
            words_for: words_for.into_iter().map(WordEvidenceView::from).collect(),
            words_against: words_against.into_iter().map(WordEvidenceView::from).collect(),
            other_words_nats,
        }
    }
}

impl From<v1::WordEvidence> for WordEvidenceView {
    fn from(evidence: v1::WordEvidence) -> Self {
        let v1::WordEvidence { word, seen, hits, looks, nats } = evidence;
        Self { word, seen, hits, looks, nats }
    }
}

pub(crate) fn show_place(explanation: &PlaceExplanationView, out: &mut dyn Write) -> io::Result<()> {
    let PlaceExplanationView { place, prior, posterior, log_likelihood, .. } = explanation;
    let against_new = log_likelihood - explanation.new_place_log_likelihood;
    let against_average = log_likelihood - explanation.average_place_log_likelihood;
    writeln!(out, "place {place}")?;
    writeln!(out, "  prior                {prior:.3e}")?;
    writeln!(out, "  posterior            {posterior:.9}")?;
    writeln!(out, "  somewhere new        {:.9}", explanation.new_place_posterior)?;
    writeln!(out, "  evidence against new     {against_new:+.2} nats")?;
    writeln!(out, "  evidence against average {against_average:+.2} nats, of which")?;
    for evidence in explanation.words_for.iter().chain(&explanation.words_against) {
        let WordEvidenceView { word, seen, hits, looks, nats } = evidence;
        let seen = if *seen { "seen    " } else { "not seen" };
        writeln!(out, "    word {word:<7} {seen}  there in {hits:>2} of {looks:>2} looks  {nats:+.2}")?;
    }
    writeln!(out, "    all other words                              {:+.2}", explanation.other_words_nats)
}
