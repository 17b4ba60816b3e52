//! Which frames of a recording are sent with odometry.

use std::str::FromStr;

use anyhow::{Context, Error, Result, bail};
use topomap::metric::Odometry;

/// Of each recording, which frames are sent with odometry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum HeardWheels {
    /// Every one.
    #[default]
    All,
    /// None.
    Never,
    /// So many, then none.
    First(usize),
    /// Those from this one on.
    From(usize),
    /// All but those from the first to before the second.
    Without(usize, usize),
    /// Every one, but from this one on wheels say that the robot stands.
    FrozenFrom(usize),
}

impl HeardWheels {
    /// What frame `index` of a recording is sent with, by the odometry of all its frames.
    pub(super) fn of_frame(self, index: usize, odometry: &[Odometry]) -> Option<Odometry> {
        let heard = match self {
            Self::All => Some(index),
            Self::Never => None,
            Self::First(count) => (index < count).then_some(index),
            Self::From(first) => (index >= first).then_some(index),
            Self::Without(first, end) => (!(first..end).contains(&index)).then_some(index),
            Self::FrozenFrom(last) => Some(index.min(last)),
        };
        odometry.get(heard?).cloned()
    }
}

impl FromStr for HeardWheels {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let number =
            |text: &str| text.parse::<usize>().with_context(|| format!("'{text}' is no number of frames"));
        Ok(match text.split_once(':') {
            None if text == "all" => Self::All,
            None if text == "none" => Self::Never,
            Some(("first", count)) => Self::First(number(count)?),
            Some(("from", first)) => Self::From(number(first)?),
            Some(("frozen-from", last)) => Self::FrozenFrom(number(last)?),
            Some(("without", range)) => {
                let (first, end) = range.split_once('-').context("write without:A-B, frames A to B - 1")?;
                Self::Without(number(first)?, number(end)?)
            }
            Some(_) | None => bail!("write all, none, first:N, from:N, without:A-B or frozen-from:N"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The x in metres that each of six frames a metre apart is sent with.
    fn sent(text: &str) -> Vec<Option<f64>> {
        let at = |x| Odometry::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], None).unwrap();
        let odometry: Vec<Odometry> = (0..6).map(f64::from).map(at).collect();
        let heard: HeardWheels = text.parse().unwrap();
        let x_m = |odometry: Odometry| odometry.pose().translation.x;
        (0..6).map(|index| heard.of_frame(index, &odometry).map(x_m)).collect()
    }

    #[test]
    fn frames_are_sent_with_what_is_heard() {
        let (all, none) = ([0.0, 1.0, 2.0, 3.0, 4.0, 5.0].map(Some), None);
        assert_eq!(sent("all"), all);
        assert_eq!(sent("none"), [none; 6]);
        assert_eq!(sent("first:2"), [all[0], all[1], none, none, none, none]);
        assert_eq!(sent("from:4"), [none, none, none, none, all[4], all[5]]);
        assert_eq!(sent("without:1-4"), [all[0], none, none, none, all[4], all[5]]);
        assert_eq!(sent("frozen-from:2"), [all[0], all[1], all[2], all[2], all[2], all[2]]);
        for wrong in ["", "some", "first:", "without:3", "first:-1"] {
            assert!(wrong.parse::<HeardWheels>().is_err(), "{wrong}");
        }
    }
}
