//! What was refused lately, so that somebody who was not there can see who was told what. It is kept in memory, and the
//! server's log has it, too.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::pages::{Page, numbered_page, page_from, page_size};

/// Refusals that are kept; the oldest make room.
const KEPT: usize = 1000;

/// Who is refused the same again and again is one refusal, if it is among so many of the newest.
const ALIKE_AMONG: usize = 64;

/// Longest texts that are kept of a refusal.
const MAX_MESSAGE_BYTES: usize = 500;
const MAX_REQUEST_BYTES: usize = 200;

/// A request or a frame that was refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Refusal {
    /// `/waypost.v1.MapService/GetMap`, or `GET /v1/maps/attic`.
    pub(crate) request: String,
    /// The kind of error in lower snake case.
    pub(crate) code: &'static str,
    /// What was told.
    pub(crate) message: String,
    /// Where it came from, if that is known.
    pub(crate) peer: Option<IpAddr>,
    /// Name of the token that it came with, if it is one of the server's.
    pub(crate) token: Option<String>,
    /// Of a frame or a goal: the session or the navigation that it was for.
    pub(crate) stream: String,
}

impl Refusal {
    /// Something that a robot sent on an open stream, `stream`.
    pub(crate) fn on_stream(
        request: &str,
        stream: &str,
        token: Option<&String>,
        error: &ServiceError,
    ) -> Self {
        Self {
            request: request.to_owned(),
            code: error.code_name(),
            message: error.to_string(),
            peer: None,
            token: token.cloned(),
            stream: stream.to_owned(),
        }
    }
}

/// A refusal as people see it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct RefusalView {
    /// Rises with each refusal, so that pages go on where they were.
    pub(crate) number: u64,
    pub(crate) refusal: Refusal,
    pub(crate) first_ns: i64,
    pub(crate) last_ns: i64,
    /// How often the same was refused.
    pub(crate) times: u64,
}

/// What was refused since the server began. Cheap to clone.
#[derive(Clone, Debug, Default)]
pub(crate) struct RefusalLog {
    kept: Arc<Mutex<Kept>>,
}

#[derive(Debug, Default)]
struct Kept {
    /// Newest last; numbers rise.
    refusals: VecDeque<RefusalView>,
    next: u64,
}

impl RefusalLog {
    pub(crate) fn note(&self, mut refusal: Refusal) {
        shorten(&mut refusal.request, MAX_REQUEST_BYTES);
        shorten(&mut refusal.message, MAX_MESSAGE_BYTES);
        let now = now_ns();
        let mut kept = self.kept();
        let number = kept.next;
        kept.next += 1;
        let newest = kept.refusals.len().saturating_sub(ALIKE_AMONG);
        let alike = kept.refusals.range(newest..).position(|known| known.refusal == refusal);
        let again = match alike.and_then(|index| kept.refusals.remove(newest + index)) {
            Some(known) => RefusalView { number, last_ns: now, times: known.times + 1, ..known },
            None => RefusalView { number, refusal, first_ns: now, last_ns: now, times: 1 },
        };
        kept.refusals.push_back(again);
        if kept.refusals.len() > KEPT {
            kept.refusals.pop_front();
        }
    }

    /// Newest first.
    pub(crate) fn list(&self, size: u32, token: &str) -> Result<Page<RefusalView>, ServiceError> {
        let size = page_size(size)?;
        let before = numbered_page(token)?.unwrap_or(u64::MAX);
        let kept = self.kept();
        let mut older = kept.refusals.iter().rev().filter(|refusal| refusal.number < before);
        let items: Vec<RefusalView> = older.by_ref().take(size as usize).cloned().collect();
        let next = match (older.next(), items.last()) {
            (Some(_), Some(last)) => page_from(last.number),
            (None, _) | (_, None) => String::new(),
        };
        Ok(Page { items, next })
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Cuts `text` to so many bytes, and says that it did.
fn shorten(text: &mut String, most: usize) {
    if text.len() > most {
        text.truncate(text.floor_char_boundary(most));
        text.push('…');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(message: &str) -> Refusal {
        let error = ServiceError::invalid(message);
        Refusal::on_stream("/waypost.v1.SessionService/Stream", "maps/hall/sessions/monday", None, &error)
    }

    #[test]
    fn the_same_again_is_counted_and_comes_first() {
        let log = RefusalLog::default();
        for message in ["one", "two", "one"] {
            log.note(refused(message));
        }
        let listed = log.list(0, "").unwrap();
        let told: Vec<(&str, u64)> =
            listed.items.iter().map(|item| (item.refusal.message.as_str(), item.times)).collect();
        assert_eq!(told, [("one", 2), ("two", 1)]);
        assert!(listed.items[0].first_ns <= listed.items[1].first_ns && listed.next.is_empty());
    }

    #[test]
    fn the_oldest_make_room_and_pages_go_back_to_them() {
        let log = RefusalLog::default();
        for number in 0..KEPT + 5 {
            log.note(refused(&number.to_string()));
        }
        let (mut told, mut token) = (Vec::new(), String::new());
        loop {
            let Page { items, next } = log.list(300, &token).unwrap();
            told.extend(items.into_iter().map(|item| item.refusal.message));
            token = next;
            if token.is_empty() {
                break;
            }
        }
        let newest_first: Vec<String> = (5..KEPT + 5).rev().map(|number| number.to_string()).collect();
        assert_eq!(told, newest_first);
        assert!(log.list(0, "junk").is_err() && log.list(1001, "").is_err());
    }

    #[test]
    fn long_texts_are_cut_between_letters() {
        let log = RefusalLog::default();
        log.note(refused(&"ä".repeat(MAX_MESSAGE_BYTES)));
        let listed = log.list(0, "").unwrap();
        assert_eq!(listed.items[0].refusal.message, format!("{}…", "ä".repeat(MAX_MESSAGE_BYTES / 2)));
    }
}
