//! `waypost map ls`, `show`, `matches`, `places`: what a map is and has, for people.

use std::io::{self, Write};

use serde_json::json;
use waypost_client::v1;

use super::short_map;
use crate::commands::model::short;
use crate::failure::Failure;
use crate::output::{Output, table};
use crate::views::{ClosureView, FrameView, MapSummary, PlacePoseView, PlaceView, SettingsView, StorageView};

pub(super) fn list(maps: Vec<v1::Map>, output: Output) -> Result<(), Failure> {
    let maps: Vec<MapSummary> = maps.into_iter().map(MapSummary::from).collect();
    output.result(&json!({ "maps": maps }), |out| {
        let rows = maps.iter().map(|map| {
            [
                short_map(&map.name).to_owned(),
                short(&map.model).to_owned(),
                map.places.to_string(),
                map.links.to_string(),
                map.sessions.to_string(),
                map.frames.to_string(),
                map.loop_closures.to_string(),
            ]
        });
        table(out, ["MAP", "MODEL", "PLACES", "LINKS", "SESSIONS", "FRAMES", "CLOSURES"], rows)
    })
}

pub(super) fn show(map: v1::Map, output: Output) -> Result<(), Failure> {
    let map = MapSummary::from(map);
    output.result(&map, |out| {
        writeln!(out, "{}", map.name)?;
        writeln!(out, "  model                {}", map.model)?;
        writeln!(out, "  places               {}", map.places)?;
        writeln!(out, "  links                {}", map.links)?;
        writeln!(out, "  sessions             {}", map.sessions)?;
        writeln!(out, "  frames               {}", map.frames)?;
        writeln!(out, "  loop closures        {}", map.loop_closures)?;
        show_settings(&map.settings, out)?;
        if let Some(storage) = &map.storage {
            show_storage(storage, out)?;
        }
        map.state_hash.as_ref().map_or(Ok(()), |hash| writeln!(out, "  state hash           {hash}"))
    })
}

fn show_storage(storage: &StorageView, out: &mut dyn Write) -> io::Result<()> {
    let StorageView {
        log_bytes,
        checkpoint_bytes,
        features_bytes,
        thumbnail_bytes,
        image_bytes,
        bytes_per_frame,
    } = storage;
    let parts = [
        ("words and decisions", log_bytes),
        ("checkpoint", checkpoint_bytes),
        ("features", features_bytes),
        ("thumbnails", thumbnail_bytes),
        ("images", image_bytes),
    ];
    for (part, bytes) in parts {
        writeln!(out, "  {part:<20} {bytes} bytes")?;
    }
    writeln!(out, "  per frame            {bytes_per_frame:.0} bytes")
}

fn show_settings(settings: &SettingsView, out: &mut dyn Write) -> io::Result<()> {
    let SettingsView {
        dependence,
        new_place,
        closure_threshold,
        guard_frames,
        new_place_prior,
        true_positive_rate,
        false_positive_rate,
        keep,
        verification,
        place_spacing_m,
        place_spacing_rad,
        navigation_strategy,
    } = settings;
    let or_default = |value: &Option<f64>| value.map_or("the model's".to_owned(), |value| value.to_string());
    writeln!(out, "  dependence           {dependence}")?;
    writeln!(out, "  new place            {new_place}")?;
    writeln!(out, "  new place prior      {}", or_default(new_place_prior))?;
    writeln!(out, "  closure threshold    {}", or_default(closure_threshold))?;
    writeln!(out, "  guard                {} frames", guard_frames.unwrap_or_default())?;
    writeln!(out, "  true positive rate   {}", or_default(true_positive_rate))?;
    writeln!(out, "  false positive rate  {}", or_default(false_positive_rate))?;
    writeln!(out, "  verification         {verification}")?;
    let (distance_m, angle_rad) =
        (place_spacing_m.unwrap_or_default(), place_spacing_rad.unwrap_or_default());
    writeln!(out, "  place spacing        {distance_m} m, {:.1} degrees", angle_rad.to_degrees())?;
    writeln!(out, "  navigation           {navigation_strategy}")?;
    writeln!(out, "  keeps                {keep}")
}

pub(super) fn matches(closures: Vec<v1::LoopClosure>, output: Output) -> Result<(), Failure> {
    let closures: Vec<ClosureView> = closures.into_iter().map(ClosureView::from).collect();
    output.result(&json!({ "matches": closures }), |out| {
        let rows = closures.iter().map(|closure| {
            let ClosureView { frame, matched_frame, place, posterior, probability } = closure;
            [
                frame_words(frame),
                frame_words(matched_frame),
                place.to_string(),
                format!("{posterior:.4}"),
                probability.map_or("not verified".to_owned(), |probability| format!("{probability:.4}")),
            ]
        });
        table(out, ["FRAME", "MATCHED FRAME", "PLACE", "BY WORDS", "WITH GEOMETRY"], rows)
    })
}

pub(super) fn places(places: Vec<v1::Place>, output: Output) -> Result<(), Failure> {
    let places: Vec<PlaceView> = places.into_iter().map(PlaceView::from).collect();
    output.result(&json!({ "places": places }), |out| {
        let rows = places.iter().map(|place| {
            let PlaceView { name, looks, words, frames, linked, pose } = place;
            let pose = pose.map_or("-".to_owned(), |PlacePoseView { part, x_m, y_m, heading_rad }| {
                let of_part = if part == 0 { String::new() } else { format!(" from place {part}") };
                format!("{x_m:.2} {y_m:.2} m {:.0}°{of_part}", heading_rad.to_degrees())
            });
            let linked: Vec<String> = linked.iter().map(u32::to_string).collect();
            [
                name.rsplit('/').next().unwrap_or(name).to_owned(),
                looks.to_string(),
                words.to_string(),
                frames.len().to_string(),
                linked.join(" "),
                pose,
            ]
        });
        table(out, ["PLACE", "LOOKS", "WORDS", "FRAMES", "LINKED WITH", "WHERE"], rows)
    })
}

fn frame_words(frame: &Option<FrameView>) -> String {
    match frame {
        Some(FrameView { session, sequence, stamp_ns: _ }) => {
            format!("{}#{sequence}", session.rsplit('/').next().unwrap_or(session))
        }
        None => "-".to_owned(),
    }
}
