//! Numbers that must lie between two others.

/// A setting is out of its range, or no number.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{setting} is {value}; it must be from {least} to {most}")]
pub struct OutOfRange {
    /// The name of the setting.
    pub setting: &'static str,
    /// What it is.
    pub value: f64,
    /// Least that it may be.
    pub least: f64,
    /// Most that it may be.
    pub most: f64,
}

/// The first of the settings (name, value, least, most) that is out of range.
pub(crate) fn check(settings: &[(&'static str, f64, f64, f64)]) -> Result<(), OutOfRange> {
    let wrong = settings.iter().find(|&&(_, value, least, most)| !(least..=most).contains(&value));
    wrong.map_or(Ok(()), |&(setting, value, least, most)| Err(OutOfRange { setting, value, least, most }))
}
