//! What is limited, and what is said where a limit is reached.

use std::num::NonZeroU32;
use std::time::Duration;

/// What may be limited of what is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Quota {
    Maps,
    Sessions,
    FramesPerSecond,
    Kept,
}

impl Quota {
    /// As it is set.
    pub(crate) fn setting(self) -> &'static str {
        match self {
            Self::Maps => "max_maps",
            Self::Sessions => "max_sessions",
            Self::FramesPerSecond => "max_frames_per_second",
            Self::Kept => "max_kept_mib",
        }
    }
}

/// Who has a quota.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Holder {
    Token,
    Server,
}

impl Holder {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Token => "token",
            Self::Server => "server",
        }
    }
}

/// The quotas of a token. What is `None` is not limited.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Limits {
    /// Maps that it made, and that are there.
    pub(crate) maps: Option<u32>,
    /// Sessions that it opened, and that maps keep.
    pub(crate) sessions: Option<u32>,
    /// Over all its streams.
    pub(crate) frames_per_second: Option<f64>,
    /// What its sessions keep.
    pub(crate) kept_mib: Option<u32>,
}

impl Limits {
    /// For a list; `None` if nothing is limited.
    pub(crate) fn in_words(&self) -> Option<String> {
        let Self { maps, sessions, frames_per_second, kept_mib } = self;
        let words = [
            maps.map(|maps| format!("{maps} maps")),
            sessions.map(|sessions| format!("{sessions} sessions")),
            frames_per_second.map(|frames| format!("{frames} frames a second")),
            kept_mib.map(|mib| format!("{mib} MiB kept")),
        ];
        let words: Vec<String> = words.into_iter().flatten().collect();
        (!words.is_empty()).then(|| format!("at most {}", words.join(", ")))
    }
}

/// The quotas of a server: of all tokens, and those without one, together. What is `None` is not limited.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServerLimits {
    /// Maps that there may be.
    pub max_maps: Option<NonZeroU32>,
    /// Sessions that maps may keep.
    pub max_sessions: Option<NonZeroU32>,
    /// Mebibytes that sessions may keep.
    pub max_kept_mib: Option<NonZeroU32>,
}

/// Why something would be too much, of whom, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{message}")]
pub(crate) struct OverQuota {
    pub(crate) quota: Quota,
    pub(crate) holder: Holder,
    pub(crate) message: String,
    /// When to ask again; `None` if that is of no use before something is deleted or a quota raised.
    pub(crate) retry_after: Option<Duration>,
}

impl OverQuota {
    /// A frame above what a token may send.
    pub(super) fn of_frames(token: &str, per_second: f64, wait: Duration) -> Self {
        let message = format!(
            "the token {token} has sent the {per_second} frames a second that it may (max_frames_per_second), over all its \
             streams; send this one again in {:.1} s, send fewer, or ask who runs the server for more (waypost token limit \
             {token} --max-frames-per-second {})",
            wait.as_secs_f64(),
            2.0 * per_second
        );
        Self { quota: Quota::FramesPerSecond, holder: Holder::Token, message, retry_after: Some(wait) }
    }

    /// The same of a frame, which may come again.
    pub(super) fn passing(self, retry_after: Duration) -> Self {
        let message =
            format!("{}; this frame may be sent again in {} s", self.message, retry_after.as_secs());
        Self { message, retry_after: Some(retry_after), ..self }
    }
}

/// Whose quota it is.
#[derive(Clone, Copy, Debug)]
pub(super) enum Whose<'a> {
    Token(&'a str),
    Server,
}

/// What is said where there would be more than the limit.
pub(super) fn over(whose: Whose<'_>, quota: Quota, used: u64, limit: u32) -> OverQuota {
    let (has, free) = match quota {
        Quota::Maps => (format!("{used} of the {limit} maps"), "delete one (waypost map rm)"),
        Quota::Sessions => (
            format!("{used} of the {limit} sessions"),
            "go on with one of them by its name, delete one (waypost session rm)",
        ),
        Quota::Kept => {
            let used_mib = used as f64 / f64::from(1 << 20);
            let has = format!("{used_mib:.1} of the {limit} MiB in its sessions");
            (has, "delete sessions (waypost session rm)")
        }
        Quota::FramesPerSecond => (format!("{used} of the {limit} frames a second"), "send fewer"),
    };
    let setting = quota.setting();
    let flag = setting.replace('_', "-");
    let more = limit.saturating_add(if quota == Quota::Kept { limit } else { 1 });
    let (holder, message) = match whose {
        Whose::Token(token) => (
            Holder::Token,
            format!(
                "the token {token} has {has} that it may ({setting}); {free}, or ask who runs the server for more (waypost \
                 token limit {token} --{flag} {more})"
            ),
        ),
        Whose::Server => (
            Holder::Server,
            format!(
                "the server has {has} that it may, whosever they are ({setting}); {free}, or ask who runs the server to \
                 raise that setting (waypost-server --{flag} {more})"
            ),
        ),
    };
    OverQuota { quota, holder, message, retry_after: None }
}
