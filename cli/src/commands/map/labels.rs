//! `waypost map label`, `waypost map labels`: labels of places.

use serde_json::json;
use waypost_client::{Client, v1};

use crate::failure::Failure;
use crate::names::short_map;
use crate::output::{Output, table};

/// Label a place, so that robots can be sent there by name; several places may have the same label
#[derive(clap::Args)]
pub(crate) struct Labelling {
    /// Name of the map
    name: String,
    /// Number of the place
    place: u32,
    /// The label
    #[arg(required_unless_present = "remove", conflicts_with = "remove")]
    label: Option<String>,
    /// Label all places of its room; the map must be navigated by appearance
    #[arg(long, conflicts_with = "remove")]
    space: bool,
    /// Remove the label
    #[arg(long)]
    remove: bool,
}

pub(super) async fn label(client: &Client, labelling: Labelling, output: Output) -> Result<(), Failure> {
    let Labelling { name, place, label, space, remove: _ } = labelling;
    let place = format!("maps/{}/places/{place}", short_map(&name));
    if label.as_deref() == Some("") {
        return Err(Failure::Unfit(
            "a label is no empty text; --remove takes the place's label away".to_owned(),
        ));
    }
    let Some(label) = label else {
        client.delete_label(&place).await?;
        return output.result(&json!({ "unlabelled": place }), |out| writeln!(out, "{place} has no label"));
    };
    let scope = if space { v1::LabelScope::Space } else { v1::LabelScope::Place };
    show(&client.set_label(&place, &label, scope).await?, output)
}

pub(super) async fn list(client: &Client, map: &str, output: Output) -> Result<(), Failure> {
    show(&client.labels(map).await?, output)
}

fn show(labels: &[v1::PlaceLabel], output: Output) -> Result<(), Failure> {
    output.result(&json!({ "labels": labels }), |out| {
        let number = |place: &str| place.rsplit('/').next().unwrap_or_default().to_owned();
        table(out, ["PLACE", "LABEL"], labels.iter().map(|row| [number(&row.place), row.label.clone()]))
    })
}
