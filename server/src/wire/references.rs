//! Frames as others name them.

use waypost_proto::v1;

use crate::open_map::answers::FrameReference;

pub(crate) fn frame_reference(reference: FrameReference) -> v1::FrameReference {
    let FrameReference { session, sequence, stamp_ns, note } = reference;
    v1::FrameReference { session, sequence, stamp_ns, note }
}
