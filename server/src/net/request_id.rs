//! Ids that requests are known by: in the log, and by their senders.
//!
//! The layer of `tower-http` takes any id that a client sends; ours end up in logs, so they are checked first.

use std::fmt;

use http::{HeaderMap, HeaderName, HeaderValue};
use tracing::Span;

pub(crate) const HEADER: HeaderName = HeaderName::from_static("x-request-id");

const MAX_LEN: usize = 64;

/// The id that a client sent, or one made up.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RequestId(String);

impl RequestId {
    /// A client's own id if it has 1 to 64 printable ASCII characters and no space: what it sends ends
    /// up in the log.
    pub(crate) fn of(headers: &HeaderMap) -> Self {
        let sent = headers.get(HEADER).and_then(|sent| sent.to_str().ok());
        match sent.filter(|sent| is_valid(sent)) {
            Some(sent) => Self(sent.to_owned()),
            None => Self(made_up()),
        }
    }

    /// Goes into the answer.
    pub(crate) fn tell(&self, headers: &mut HeaderMap) {
        if let Ok(value) = HeaderValue::from_str(&self.0) {
            headers.insert(HEADER, value);
        }
    }

    /// What is logged within it carries the id. At the level of errors, so that no filter takes it away.
    pub(crate) fn span(&self) -> Span {
        tracing::error_span!("request", request_id = %self)
    }
}

impl fmt::Display for RequestId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

fn is_valid(id: &str) -> bool {
    (1..=MAX_LEN).contains(&id.len()) && id.bytes().all(|byte| byte.is_ascii_graphic())
}

fn made_up() -> String {
    // Without randomness the ids would be alike; requests are served all the same.
    format!("{:016x}", getrandom::u64().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_valid_id_is_kept_and_any_other_replaced() {
        let of = |value: &[u8]| {
            let mut headers = HeaderMap::new();
            headers.insert(HEADER, HeaderValue::from_bytes(value).unwrap());
            RequestId::of(&headers).to_string()
        };
        for good in ["a", "0f-e:1/x", &"x".repeat(64)] {
            assert_eq!(of(good.as_bytes()), good);
        }
        for bad in ["", "a b", &"x".repeat(65), "ä", "a\tb"] {
            let made = of(bad.as_bytes());
            assert!(made.len() == 16 && made != bad, "{bad:?} gave {made:?}");
        }
        assert_ne!(RequestId::of(&HeaderMap::new()), RequestId::of(&HeaderMap::new()));
    }
}
