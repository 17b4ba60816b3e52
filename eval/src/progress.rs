//! Progress bars on stderr; silent where stderr is not a terminal.

use std::borrow::Cow;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar for `steps` steps of what `name` says.
pub(crate) fn bar(name: impl Into<Cow<'static, str>>, steps: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:>14} [{wide_bar}] {pos}/{len} {elapsed} (eta {eta})");
    let style = style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> ");
    ProgressBar::new(steps as u64).with_message(name).with_style(style)
}
