//! `waypost map trim`: drops dispensable places.

use waypost_client::v1::dropped_place::Reason;
use waypost_client::v1::least_seen_place::Distance;
use waypost_client::v1::trim_map_request::Mode;
use waypost_client::{Client, v1};

use crate::failure::Failure;
use crate::files::Asking;
use crate::names::short_map;
use crate::output::{Output, table};

/// Show which places could be dropped to bring a map down to a number of places, and why
#[derive(clap::Args)]
pub(crate) struct Trimming {
    /// Name of the map
    name: String,
    /// Most places that the map may have
    #[arg(long, value_name = "N")]
    places: u32,
    /// Drop them; their frames stay, without a place, and other places may get other numbers. It
    /// cannot be undone
    #[arg(long)]
    apply: bool,
    /// Do not ask: needed where nobody can answer, as in a script
    #[arg(long, requires = "apply")]
    yes: bool,
}

pub(super) async fn trim(client: &Client, trimming: Trimming, output: Output) -> Result<(), Failure> {
    let Trimming { name, places, apply, yes } = trimming;
    let mode = if apply { Mode::Apply } else { Mode::Preview };
    if mode == Mode::Apply {
        Asking::unless(yes).confirm_loss(&format!(
            "drop places of {name} until it has {places}, other places getting other numbers? it cannot be undone"
        ))?;
    }
    let name = format!("maps/{}", short_map(&name));
    let request = v1::TrimMapRequest { name, max_places: places, mode: mode.into() };
    trimmed(&client.trim_map(request).await?, mode, output)
}

fn trimmed(response: &v1::TrimMapResponse, mode: Mode, output: Output) -> Result<(), Failure> {
    let applied = mode == Mode::Apply;
    output.result(response, |out| {
        let v1::TrimMapResponse { dropped, remaining_places, excess_places } = response;
        let rows = dropped.iter().map(|place| [place.place_number.to_string(), reason(place)]);
        table(out, ["PLACE", "REASON"], rows)?;
        let tense = if applied { "remain" } else { "would remain" };
        writeln!(out, "{remaining_places} places {tense}")?;
        if *excess_places > 0 {
            writeln!(
                out,
                "{excess_places} more than asked for: the map would fall apart without any of them"
            )?;
        }
        Ok(())
    })
}

fn reason(place: &v1::DroppedPlace) -> String {
    match &place.reason {
        Some(Reason::Redundant(v1::RedundantPlace { of_place_number, similarity })) => {
            let percent = similarity * 100.0;
            format!(
                "place {of_place_number} is at the same position, and shows {percent:.0}% of the same words"
            )
        }
        Some(Reason::LeastSeen(v1::LeastSeenPlace { looks, distance })) => {
            let nearest = match distance {
                Some(Distance::DistanceM(distance_m)) => format!("{distance_m:.2} m"),
                Some(Distance::DistanceLinks(links)) => format!("{links} links"),
                None => "not far".to_owned(),
            };
            format!("looked at {looks} times, and the next place is {nearest} away")
        }
        None => String::new(),
    }
}
