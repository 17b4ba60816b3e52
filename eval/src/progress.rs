//! Progress bars on stderr; silent where stderr is not a terminal.

use std::borrow::Cow;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar for `steps` steps of what `name` says.
#[must_use]
pub fn bar(name: impl Into<Cow<'static, str>>, steps: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:>14} [{wide_bar}] {pos}/{len} {elapsed} (eta {eta})");
    let bar = ProgressBar::new(steps as u64).with_message(name);
    match style {
        Ok(style) => bar.with_style(style.progress_chars("=> ")),
        Err(_) => bar,
    }
}
