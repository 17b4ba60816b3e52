//! Progress bars on stderr, for people at a terminal only.

use std::borrow::Cow;
use std::io::IsTerminal;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressFinish, ProgressStyle};

use crate::output::Output;

const BAR: &str = "{msg:24} [{bar:40}] {pos}/{len} {eta}";
const BYTES: &str = "{msg:24} [{bar:40}] {bytes}/{total_bytes} {eta}";
const PERCENT: &str = "{msg:24} [{bar:40}] {percent}%";
const SPINNER: &str = "{spinner} {msg} {elapsed}";

/// Counts things out of a known number.
pub(crate) fn counter(output: Output, message: impl Into<Cow<'static, str>>, length: usize) -> ProgressBar {
    bar(output, BAR, length as u64, message)
}

/// Counts bytes out of a known number.
pub(crate) fn bytes(output: Output, message: impl Into<Cow<'static, str>>, length: u64) -> ProgressBar {
    bar(output, BYTES, length, message)
}

/// Shows a percentage.
pub(crate) fn percentage(output: Output) -> ProgressBar {
    bar(output, PERCENT, 100, "")
}

/// Shows activity of unknown length.
pub(crate) fn spinner(output: Output, message: impl Into<Cow<'static, str>>) -> ProgressBar {
    let spinner = bar(output, SPINNER, 0, message);
    spinner.enable_steady_tick(Duration::from_millis(120));
    spinner
}

fn bar(output: Output, template: &str, length: u64, message: impl Into<Cow<'static, str>>) -> ProgressBar {
    let visible = output == Output::Text && std::io::stderr().is_terminal();
    let target = if visible { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
    // A template that does not parse leaves the default bar.
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    // Also after an error.
    let finish = ProgressFinish::AndClear;
    ProgressBar::with_draw_target(Some(length), target)
        .with_style(style)
        .with_message(message)
        .with_finish(finish)
}
