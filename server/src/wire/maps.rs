//! Maps, their loop closures and what they can do without as messages.

use topomap::rewriting::{Dispensable, Distance, Why};
use waypost_proto::v1;

use super::corrections::correction;
use super::references::frame_reference;
use super::settings::settings_message;
use crate::names::{map_name, model_name};
use crate::service::corrections::CorrectionCounts;
use crate::service::maps::{LoopClosureView, MapBytes, MapCounts, MapExtent, MapView};

pub(crate) fn map(view: MapView) -> v1::Map {
    let MapView { map, model, settings, created_ns, counts, corrections, state_hash, bytes, extent } = view;
    let MapCounts { sessions, frames, loop_closures, places, links } = counts;
    let CorrectionCounts { withdrawn, confirmed, links_added, links_taken_out } = corrections;
    v1::Map {
        name: map_name(&map),
        model: model_name(&model),
        settings: Some(settings_message(&settings)),
        create_time_ns: created_ns,
        places,
        links: (links + links_added).saturating_sub(links_taken_out),
        sessions,
        frames,
        loop_closures,
        state_hash,
        storage: bytes.map(|bytes| storage(bytes, frames)),
        withdrawn_loop_closures: withdrawn,
        confirmed_loop_closures: confirmed,
        extent: extent.map(map_extent),
    }
}

fn map_extent(extent: MapExtent) -> v1::MapExtent {
    let MapExtent { parts, measured_places, sides_m: [length_m, width_m] } = extent;
    v1::MapExtent { parts, measured_places, length_m, width_m }
}

fn storage(bytes: MapBytes, frames: u64) -> v1::MapStorage {
    let per_frame = bytes.per_frame(frames);
    let MapBytes { log, checkpoint, features, thumbnails, images } = bytes;
    v1::MapStorage {
        log_bytes: log,
        checkpoint_bytes: checkpoint,
        features_bytes: features,
        thumbnail_bytes: thumbnails,
        image_bytes: images,
        bytes_per_frame: per_frame,
    }
}

pub(crate) fn loop_closure(view: LoopClosureView) -> v1::LoopClosure {
    let LoopClosureView { frame, matched, place, posterior, probability, correction: said } = view;
    v1::LoopClosure {
        frame: Some(frame_reference(frame)),
        matched_frame: Some(frame_reference(matched)),
        place_number: place.number(),
        posterior,
        probability,
        correction: said.map(correction),
    }
}

pub(crate) fn dropped_place(dropped: Dispensable) -> v1::DroppedPlace {
    use v1::dropped_place::Reason;
    use v1::least_seen_place::Distance as Nearest;
    let Dispensable { place, why } = dropped;
    let reason = match why {
        Why::Redundant { of, alike } => {
            Reason::Redundant(v1::RedundantPlace { of_place_number: of.number(), similarity: alike })
        }
        Why::LeastSeen { looks, nearest } => {
            let distance = match nearest {
                Distance::Metres(distance_m) => Nearest::DistanceM(distance_m),
                Distance::Links(links) => Nearest::DistanceLinks(links),
            };
            Reason::LeastSeen(v1::LeastSeenPlace { looks: looks.into(), distance: Some(distance) })
        }
    };
    v1::DroppedPlace { place_number: place.number(), reason: Some(reason) }
}
