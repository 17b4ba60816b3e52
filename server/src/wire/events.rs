//! What happens in maps, as messages.

use waypost_proto::v1;
use waypost_proto::v1::map_event::Event;

use super::navigations::navigation;
use super::sessions::listed_frame;
use crate::service::events::MapEventView;

pub(crate) fn map_event(view: MapEventView) -> v1::MapEvent {
    let event = match view {
        MapEventView::Started { next_position, log } => {
            Event::Started(v1::WatchStarted { next_position, log })
        }
        MapEventView::Frame { position, frame } => {
            Event::Frame(v1::DecidedFrame { position, frame: Some(listed_frame(*frame)) })
        }
        MapEventView::Navigation(view) => Event::Navigation(navigation(*view)),
    };
    v1::MapEvent { event: Some(event) }
}
