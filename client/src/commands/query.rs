//! `waypost query`: where one image was taken.

use std::path::PathBuf;

use serde::Serialize;
use waypost_client::{Client, ClientOptions, v1};

use crate::explanations::{PlaceExplanationView, show_place};
use crate::failure::{EXIT_CODES, Failure};
use crate::output::Output;
use crate::robot_words::{ContentMaker, WordForm};
use crate::views::{GeometryView, MatchView};

/// Tell where an image was taken, by its looks alone
#[derive(clap::Args)]
#[command(after_help = EXIT_CODES)]
pub(crate) struct Arguments {
    /// Map to look in
    map: String,
    /// A JPEG or PNG
    image: PathBuf,
    /// Send words instead of the image; as in `waypost stream`
    #[arg(
        long,
        value_enum,
        value_name = "FORM",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "keypoints"
    )]
    words: Option<WordForm>,
    /// Explain the most probable place by so many words for and as many against it, at most 100
    #[arg(
        long,
        value_name = "WORDS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "10",
        default_value_t = 0,
        hide_default_value = true
    )]
    explain: u32,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Answer {
    accepted: bool,
    new_place_posterior: f64,
    words: u32,
    /// The most probable places, most probable first.
    places: Vec<Probability>,
    /// Null if the map is empty or too few words were seen.
    matched: Option<MatchView>,
    /// Null unless asked for.
    explanation: Option<PlaceExplanationView>,
}

#[derive(Serialize)]
struct Probability {
    place: u32,
    posterior: f64,
}

pub(crate) async fn run(arguments: Arguments, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let Arguments { map, image, words, explain } = arguments;
    let bytes = tokio::fs::read(&image).await.map_err(Failure::file("read", &image))?;
    let client = Client::connect(server).await?;
    let contents = ContentMaker::new(&client, &map, words).await?;
    let content = contents.content(bytes).await;
    let response = client.query(&map, content, &contents.words_hash(), explain).await?;
    let v1::QueryResponse { places, new_place_posterior, r#match, accepted, words, explanation } = response;
    let answer = Answer {
        accepted,
        new_place_posterior,
        words,
        places: places
            .into_iter()
            .map(|v1::PlaceProbability { place, posterior }| Probability { place, posterior })
            .collect(),
        matched: r#match.map(MatchView::from),
        explanation: explanation.map(PlaceExplanationView::from),
    };
    output.result(&answer, |out| {
        match &answer.matched {
            Some(MatchView { place, posterior, log_odds: _, frame, geometry }) => {
                let verdict = if answer.accepted { "seen before" } else { "not sure" };
                writeln!(out, "{verdict}: place {place}, posterior {posterior:.6}")?;
                if let Some(frame) = frame {
                    writeln!(out, "best match: frame {} of {}", frame.sequence, frame.session)?;
                }
                if let Some(GeometryView { matches, inliers, evidence, probability, similarity: _ }) =
                    geometry
                {
                    writeln!(
                        out,
                        "geometry: {inliers} of {matches} matches agree, evidence {evidence:.1}; \
                         the same place with {probability:.3}"
                    )?;
                }
            }
            None => writeln!(
                out,
                "nothing to compare: {} different words, {} places",
                words,
                answer.places.len()
            )?,
        }
        writeln!(out, "somewhere new: {new_place_posterior:.6}")?;
        for Probability { place, posterior } in &answer.places {
            writeln!(out, "  place {place:<8} {posterior:.6}")?;
        }
        answer.explanation.as_ref().map_or(Ok(()), |explanation| show_place(explanation, out))
    })
}
