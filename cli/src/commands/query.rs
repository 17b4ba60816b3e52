//! `waypost query`: finds where one image was taken.

use std::path::PathBuf;

use waypost_client::{Client, ClientOptions, v1};

use crate::explanations::show_place;
use crate::failure::{EXIT_CODES, Failure};
use crate::output::Output;
use crate::robot_words::{ContentMaker, Words};

/// Find where an image was taken, by appearance alone
#[derive(clap::Args)]
#[command(
    after_help = EXIT_CODES,
    mut_arg("words", |words| words.help("Send words instead of the image, as in `waypost stream`"))
)]
pub(crate) struct Arguments {
    /// Map to search
    map: String,
    /// A JPEG or PNG
    image: PathBuf,
    #[command(flatten)]
    words: Words,
    /// Explain the most probable place by this many words for it and against it, at most 100
    #[arg(
        long,
        value_name = "WORDS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "10"
    )]
    explain: Option<u32>,
}

pub(crate) async fn run(arguments: Arguments, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let Arguments { map, image, words, explain } = arguments;
    let bytes = tokio::fs::read(&image).await.map_err(Failure::file("read", &image))?;
    let client = Client::connect(server).await?;
    let contents = ContentMaker::new(&client, &map, words.words).await?;
    let content = contents.content(bytes).await;
    let answer = client.query(&map, content, &contents.words_hash(), explain).await?;
    // Whoever may only localize hears the answer all the same.
    let settings =
        client.map(&map, v1::MapView::Basic).await.ok().and_then(|map| map.settings).unwrap_or_default();
    let asked_for =
        settings.closure_threshold.map_or_else(String::new, |least| format!(", {least} asked for"));
    output.result(&answer, |out| {
        let v1::QueryResponse { places, new_place_posterior, r#match: matched, accepted, words, place_explanation } =
            &answer;
        match matched {
            Some(v1::Match { place_number, posterior, log_odds: _, frame, geometry }) => {
                let verdict = if *accepted { "seen before" } else { "not sure" };
                // Without views to compare, the posterior decides.
                match geometry {
                    Some(v1::Geometry { probability, .. }) => {
                        writeln!(out, "{verdict}: place {place_number}, probability {probability:.3}{asked_for}")?;
                    }
                    None => writeln!(out, "{verdict}: place {place_number}, posterior {posterior:.6}{asked_for}")?,
                }
                if let Some(frame) = frame {
                    let note = if frame.note.is_empty() { String::new() } else { format!(", {}", frame.note) };
                    writeln!(out, "best match: frame {} of {}{note}", frame.sequence, frame.session)?;
                }
                if let Some(v1::Geometry { matches, inliers, evidence_inliers, look_alike_inliers, .. }) = geometry {
                    writeln!(
                        out,
                        "geometry: {inliers} of {matches} matches agree, evidence {evidence_inliers:.1} inliers, \
                         look-alikes show {look_alike_inliers:.1}"
                    )?;
                    writeln!(out, "words alone: posterior {posterior:.6}")?;
                }
            }
            None => {
                let places = places.len();
                writeln!(out, "nothing to compare: {words} different words, {places} places")?;
            }
        }
        writeln!(out, "somewhere new: {new_place_posterior:.6}")?;
        for v1::PlaceProbability { place_number, posterior } in places {
            writeln!(out, "  place {place_number:<8} {posterior:.6}")?;
        }
        place_explanation.as_ref().map_or(Ok(()), |explanation| show_place(explanation, out))
    })
}
