//! `waypost map label`, `waypost map labels`: what places are called.

use serde_json::json;
use waypost_client::{Client, v1};

use super::short_map;
use crate::failure::Failure;
use crate::output::{Output, table};

/// Call a place something, so that robots can be sent there by that name; several places may be called the same
#[derive(clap::Args)]
pub(crate) struct Labelling {
    /// Name of the map
    name: String,
    /// Number of the place
    place: u32,
    /// What it is called
    #[arg(required_unless_present = "remove", conflicts_with = "remove")]
    label: Option<String>,
    /// Call all places of its space so, as of a room; the map must be navigated by appearance
    #[arg(long, conflicts_with = "remove")]
    space: bool,
    /// Take its label away
    #[arg(long)]
    remove: bool,
}

pub(super) async fn label(client: &Client, labelling: Labelling, output: Output) -> Result<(), Failure> {
    let Labelling { name, place, label, space, remove: _ } = labelling;
    let place = format!("maps/{}/places/{place}", short_map(&name));
    let Some(label) = label else {
        client.delete_label(&place).await?;
        return output.result(&json!({ "unlabelled": place }), |out| writeln!(out, "{place} has no label"));
    };
    let reach = if space { v1::LabelReach::Space } else { v1::LabelReach::Place };
    show(&client.set_label(&place, &label, reach).await?, output)
}

pub(super) async fn list(client: &Client, map: &str, output: Output) -> Result<(), Failure> {
    show(&client.labels(map).await?, output)
}

fn show(labels: &[v1::PlaceLabel], output: Output) -> Result<(), Failure> {
    let entry = |v1::PlaceLabel { place, label }: &v1::PlaceLabel| json!({ "place": place, "label": label });
    let entries: Vec<_> = labels.iter().map(entry).collect();
    output.result(&json!({ "labels": entries }), |out| {
        let number = |place: &str| place.rsplit('/').next().unwrap_or_default().to_owned();
        table(out, ["PLACE", "LABEL"], labels.iter().map(|row| [number(&row.place), row.label.clone()]))
    })
}
