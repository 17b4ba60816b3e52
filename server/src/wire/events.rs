//! What happens in maps and on the server, as messages.

use waypost_proto::v1;
use waypost_proto::v1::map_event::Event;

use super::navigations::navigation;
use super::sessions::listed_frame;
use crate::metrics::{HistoryView, SeriesName};
use crate::names::token_name;
use crate::service::events::MapEventView;
use crate::service::refusals::{Refusal, RefusalView};

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

pub(crate) fn metrics_history(view: HistoryView) -> v1::MetricsHistory {
    let HistoryView { times_ns, series } = view;
    let series = series.into_iter().map(|(SeriesName { metric, part }, values)| v1::MetricSeries {
        metric,
        part: part.unwrap_or_default(),
        values,
    });
    v1::MetricsHistory { times_ns, series: series.collect() }
}

pub(crate) fn refusal(view: RefusalView) -> v1::Refusal {
    let RefusalView { number: _, refusal, first_ns, last_ns, times } = view;
    let Refusal { request, code, message, peer, token, stream } = refusal;
    v1::Refusal {
        last_time_ns: last_ns,
        first_time_ns: first_ns,
        times,
        request,
        code: code.to_owned(),
        message,
        peer: peer.map(|peer| peer.to_string()).unwrap_or_default(),
        token: token.map(|token| token_name(&token)).unwrap_or_default(),
        stream,
    }
}
