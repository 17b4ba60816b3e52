//! `waypost map ls`, `show`, `loop-closures`, `places`: maps and their contents.

use serde_json::json;
use waypost_client::v1;

use crate::corrections::{frame_words, told};
use crate::failure::Failure;
use crate::names::{short, short_map};
use crate::output::{Output, fields, rounded, table};

pub(super) fn list(maps: &[v1::Map], output: Output) -> Result<(), Failure> {
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

pub(super) fn show(map: &v1::Map, output: Output) -> Result<(), Failure> {
    output.result(map, |out| {
        writeln!(out, "{}", map.name)?;
        writeln!(out, "  model                {}", map.model)?;
        writeln!(out, "  places               {}", map.places)?;
        writeln!(out, "  links                {}", map.links)?;
        writeln!(out, "  sessions             {}", map.sessions)?;
        writeln!(out, "  frames               {}", map.frames)?;
        writeln!(out, "  loop closures        {}", map.loop_closures)?;
        if map.withdrawn_loop_closures > 0 {
            writeln!(out, "    withdrawn          {}", map.withdrawn_loop_closures)?;
        }
        if map.confirmed_loop_closures > 0 {
            writeln!(out, "  confirmed by people  {}", map.confirmed_loop_closures)?;
        }
        writeln!(out, "  metres               {}", metres_words(map.extent.as_ref()))?;
        fields(out, &map.settings, "the model's")?;
        if map.settings.as_ref().is_some_and(verifies_nothing) {
            writeln!(
                out,
                "                       it keeps words alone, so nothing is verified: words decide"
            )?;
        }
        fields(out, &map.storage, "none")?;
        map.state_hash.as_ref().map_or(Ok(()), |hash| writeln!(out, "  state hash           {hash}"))
    })
}

/// How far a map reaches.
fn metres_words(extent: Option<&v1::MapExtent>) -> String {
    let Some(v1::MapExtent { parts, measured_places, length_m, width_m }) = extent else {
        return "none: the way between two places was never measured".to_owned();
    };
    let [length, width] = [length_m, width_m].map(|metres| rounded(*metres, 1));
    if *parts > 1 {
        return format!(
            "{length} x {width} m in the largest of {parts} parts; {measured_places} places measured in all"
        );
    }
    format!("{length} x {width} m, {measured_places} places measured")
}

/// Whether there is nothing by which the map could verify.
fn verifies_nothing(settings: &v1::MapSettings) -> bool {
    settings.keep() == v1::map_settings::Keep::Words
}

pub(super) fn loop_closures(closures: &[v1::LoopClosure], output: Output) -> Result<(), Failure> {
    output.result(&json!({ "loop_closures": closures }), |out| {
        // Few maps have any.
        let said = closures.iter().any(|closure| closure.correction.is_some());
        let rows = closures.iter().map(|closure| {
            let v1::LoopClosure { frame, matched_frame, place_number, posterior, probability, correction } =
                closure;
            [
                frame_words(frame.as_ref()),
                frame_words(matched_frame.as_ref()),
                place_number.to_string(),
                format!("{posterior:.4}"),
                probability.map_or("not verified".to_owned(), |probability| format!("{probability:.4}")),
                correction.as_ref().map_or_else(String::new, told),
            ]
        });
        table(
            out,
            ["FRAME", "MATCHED FRAME", "PLACE", "POSTERIOR", "PROBABILITY", if said { "SAID" } else { "" }],
            rows,
        )
    })
}

pub(super) fn places(places: &[v1::Place], output: Output) -> Result<(), Failure> {
    output.result(&json!({ "places": places }), |out| {
        let rows = places.iter().map(|place| {
            let v1::Place { name, looks, words, frames, linked_place_numbers, word_hits: _, pose } = place;
            let linked: Vec<String> = linked_place_numbers.iter().map(u32::to_string).collect();
            [
                name.rsplit('/').next().unwrap_or(name).to_owned(),
                looks.to_string(),
                words.to_string(),
                frames.len().to_string(),
                linked.join(" "),
                pose.as_ref().and_then(pose_words).unwrap_or_else(|| "-".to_owned()),
            ]
        });
        table(out, ["PLACE", "LOOKS", "WORDS", "FRAMES", "LINKED WITH", "WHERE"], rows)
    })
}

/// Where a place is, seen from above.
fn pose_words(place: &v1::PlacePose) -> Option<String> {
    let v1::PlacePose { part, pose } = place;
    let v1::Pose { position_m, orientation } = pose.as_ref()?;
    let position = (*position_m)?;
    let orientation = (*orientation)?;
    let heading_deg = (2.0 * orientation.z.atan2(orientation.w)).to_degrees();
    let of_part = if *part == 0 { String::new() } else { format!(" from place {part}") };
    let [x_m, y_m] = [position.x, position.y].map(|metres| rounded(metres, 2));
    Some(format!("{x_m} {y_m} m {}°{of_part}", rounded(heading_deg, 0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_those_of_the_largest_part() {
        let extent = |parts| v1::MapExtent { parts, measured_places: 91, length_m: 8.26, width_m: 10.31 };
        assert_eq!(metres_words(Some(&extent(1))), "8.3 x 10.3 m, 91 places measured");
        let several = "8.3 x 10.3 m in the largest of 2 parts; 91 places measured in all";
        assert_eq!(metres_words(Some(&extent(2))), several);
        assert!(metres_words(None).starts_with("none: "));
    }
}
