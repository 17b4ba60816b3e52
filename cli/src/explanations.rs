//! Prints why a place has its posterior.

use std::io::{self, Write};

use waypost_client::v1;

pub(crate) fn show_place(explanation: &v1::PlaceExplanation, out: &mut dyn Write) -> io::Result<()> {
    let v1::PlaceExplanation {
        place_number,
        prior,
        posterior,
        new_place_posterior,
        log_likelihood,
        new_place_log_likelihood,
        average_place_log_likelihood,
        words_for,
        words_against,
        other_words_evidence_nats,
    } = explanation;
    let against_new = log_likelihood - new_place_log_likelihood;
    let against_average = log_likelihood - average_place_log_likelihood;
    writeln!(out, "place {place_number}")?;
    writeln!(out, "  prior                {prior:.3e}")?;
    writeln!(out, "  posterior            {posterior:.9}")?;
    writeln!(out, "  somewhere new        {new_place_posterior:.9}")?;
    writeln!(out, "  evidence against new     {against_new:+.2} nats")?;
    writeln!(out, "  evidence against average {against_average:+.2} nats, of which")?;
    for evidence in words_for.iter().chain(words_against) {
        let v1::WordEvidence { word, seen, hits, looks, evidence_nats } = evidence;
        let seen = if *seen { "seen    " } else { "not seen" };
        writeln!(
            out,
            "    word {word:<7} {seen}  there in {hits:>2} of {looks:>2} looks  {evidence_nats:+.2}"
        )?;
    }
    writeln!(out, "    all other words                              {other_words_evidence_nats:+.2}")
}
