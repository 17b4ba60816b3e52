//! What people say of loop closures, as messages.

use fabmap::PlaceId;
use topomap::mapper::Said;
use waypost_proto::v1;

use super::references::frame_reference;
use crate::service::corrections::{CorrectionKind, CorrectionView};

pub(crate) fn correction(view: CorrectionView) -> v1::Correction {
    let CorrectionView { name, kind, frame, matched, place, frames, said, undone } = view;
    let Said { by: token, said_ns: create_time_ns } = said;
    let verdict = match kind {
        CorrectionKind::Withdrawn => v1::correction::Verdict::Withdrawn,
        CorrectionKind::Confirmed => v1::correction::Verdict::Confirmed,
    };
    v1::Correction {
        name,
        verdict: verdict.into(),
        frame: Some(frame_reference(frame)),
        matched_frame: Some(frame_reference(matched)),
        place_number: place.map(PlaceId::number),
        frames: u32::try_from(frames).unwrap_or(u32::MAX),
        token,
        create_time_ns,
        undone: undone
            .map(|Said { by: token, said_ns: create_time_ns }| v1::Undoing { token, create_time_ns }),
    }
}
