//! `waypost map trim`: which places a map can do without.

use serde_json::json;
use waypost_client::v1::dropped_place::Why;
use waypost_client::v1::trim_map_request::Mode;
use waypost_client::{Client, v1};

use super::short_map;
use crate::failure::Failure;
use crate::output::{Output, table};

/// Say which places a map can do without to have no more than so many, and why
#[derive(clap::Args)]
pub(crate) struct Trimming {
    /// Name of the map
    name: String,
    /// Most places that it is to have
    #[arg(long, value_name = "N")]
    places: u32,
    /// Drop them: frames there stay, at no place, and other places may have other numbers. It cannot be undone
    #[arg(long)]
    apply: bool,
}

pub(super) async fn trim(client: &Client, trimming: Trimming, output: Output) -> Result<(), Failure> {
    let Trimming { name, places, apply } = trimming;
    let mode = if apply { Mode::Apply } else { Mode::Preview };
    let name = format!("maps/{}", short_map(&name));
    let request = v1::TrimMapRequest { name, max_places: places, mode: mode.into() };
    trimmed(client.trim_map(request).await?, mode, output)
}

fn trimmed(response: v1::TrimMapResponse, mode: Mode, output: Output) -> Result<(), Failure> {
    let applied = mode == Mode::Apply;
    let v1::TrimMapResponse { dropped, places_left, over } = response;
    let why = |place: &v1::DroppedPlace| match &place.why {
        Some(Why::Redundant(v1::RedundantPlace { of_place, alike })) => {
            format!("place {of_place} stands there, too, and shows {:.0}% of the same words", alike * 100.0)
        }
        Some(Why::LeastSeen(v1::LeastSeenPlace { looks, apart })) => {
            format!("looked at {looks} times, and the next place is {apart:.2} away")
        }
        None => String::new(),
    };
    let rows: Vec<(u32, String)> = dropped.iter().map(|place| (place.place, why(place))).collect();
    let objects: Vec<_> = rows.iter().map(|(place, why)| json!({ "place": place, "why": why })).collect();
    let object = json!({ "dropped": objects, "places_left": places_left, "over": over, "applied": applied });
    output.result(&object, |out| {
        table(
            out,
            ["PLACE", "WHY IT GOES"],
            rows.iter().map(|(place, why)| [place.to_string(), why.clone()]),
        )?;
        let tense = if applied { "are" } else { "would be" };
        writeln!(out, "{places_left} places {tense} left")?;
        if over > 0 {
            writeln!(out, "{over} more than asked for: the map would fall apart without any of them")?;
        }
        Ok(())
    })
}
