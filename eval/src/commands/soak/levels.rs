//! What a server takes of its machine over time, and whether that stays level while its work does.

use serde::Serialize;

/// What the server took at one moment, or in a tenth of the time: medians, and the most of the database's file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Levels {
    /// Memory in RAM, in MiB.
    pub rss_mib: f64,
    /// Open descriptors.
    pub descriptors: f64,
    pub threads: f64,
    /// The database's file, in MiB.
    pub database_mib: f64,
    /// Its write-ahead log, in MiB: for moments as large as the file, while a map is compacted.
    pub wal_mib: f64,
}

impl Levels {
    /// Of all that was read in a tenth.
    pub(super) fn of(read: &[Self]) -> Option<Self> {
        let sorted = |of: fn(&Self) -> f64| {
            let mut values: Vec<f64> = read.iter().map(of).collect();
            values.sort_unstable_by(f64::total_cmp);
            values
        };
        let median = |of| sorted(of).get(read.len() / 2).copied();
        let most = |of| sorted(of).last().copied();
        Some(Self {
            rss_mib: median(|levels| levels.rss_mib)?,
            descriptors: median(|levels| levels.descriptors)?,
            threads: median(|levels| levels.threads)?,
            database_mib: most(|levels| levels.database_mib)?,
            wal_mib: median(|levels| levels.wal_mib)?,
        })
    }
}

/// What a level may grow by: a share of it, and so much beside.
struct Tolerance {
    level: &'static str,
    of: fn(&Levels) -> f64,
    share: f64,
    slack: f64,
}

/// Levels of the process: they begin anew with each life of the server.
const OF_PROCESS: [Tolerance; 3] = [
    Tolerance { level: "rss_mib", of: |levels| levels.rss_mib, share: 0.1, slack: 8.0 },
    Tolerance { level: "descriptors", of: |levels| levels.descriptors, share: 0.0, slack: 8.0 },
    Tolerance { level: "threads", of: |levels| levels.threads, share: 0.0, slack: 8.0 },
];

/// Levels of the disk, which outlive it.
const OF_DISK: [Tolerance; 2] = [
    Tolerance { level: "database_mib", of: |levels| levels.database_mib, share: 0.15, slack: 4.0 },
    Tolerance { level: "wal_mib", of: |levels| levels.wal_mib, share: 0.15, slack: 4.0 },
];

/// What has grown: those of the disk over all `tenths`, those of the process over those of its last life, which began with
/// tenth `last_life`, from 0. The first tenth, of a life too, is the time in which caches fill.
pub(super) fn grown(tenths: &[Levels], last_life: usize) -> Vec<String> {
    let of_process = OF_PROCESS.iter().filter_map(|tolerance| tolerance.exceeded(tenths, last_life));
    let of_disk = OF_DISK.iter().filter_map(|tolerance| tolerance.exceeded(tenths, 0));
    of_process.chain(of_disk).collect()
}

impl Tolerance {
    /// Whether the median of the last three tenths, or of those that there are after the second, is above the second's.
    fn exceeded(&self, tenths: &[Levels], from: usize) -> Option<String> {
        let Self { level, of, share, slack } = self;
        let reference = of(tenths.get(from + 1)?);
        let after = tenths.get(from + 2..).filter(|after| !after.is_empty())?;
        let mut last: Vec<f64> = after.iter().rev().take(3).map(of).collect();
        last.sort_unstable_by(f64::total_cmp);
        let median = last[last.len() / 2];
        let most = reference * (1.0 + share) + slack;
        (median > most).then(|| {
            format!(
                "{level} grew from {reference:.1} in tenth {} to {median:.1} in the last ones; {most:.1} would do",
                from + 2
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEVEL: Levels =
        Levels { rss_mib: 200.0, descriptors: 40.0, threads: 12.0, database_mib: 60.0, wal_mib: 8.0 };

    fn tenths(change: impl Fn(&mut Levels, f64)) -> Vec<Levels> {
        let tenth = |number: u32| {
            let mut levels = LEVEL;
            change(&mut levels, f64::from(number));
            levels
        };
        (0..10).map(tenth).collect()
    }

    #[test]
    fn what_stays_or_is_fetched_in_the_first_tenth_is_level() {
        assert_eq!(grown(&tenths(|_, _| {}), 5), [""; 0]);
        let warm = tenths(|levels, tenth| {
            levels.rss_mib = [50.0, 200.0][usize::from(tenth > 0.0 && tenth != 5.0)];
            levels.database_mib = [5.0, 60.0][usize::from(tenth > 0.0)];
        });
        assert_eq!(grown(&warm, 5), [""; 0]);
        // Once is not always.
        let once = tenths(|levels, tenth| levels.descriptors += [0.0, 100.0][usize::from(tenth == 8.0)]);
        assert_eq!(grown(&once, 5), [""; 0]);
    }

    #[test]
    fn every_level_that_grows_is_told() {
        type Leak = fn(&mut Levels, f64);
        let leaks: [(&str, Leak); 5] = [
            ("rss_mib", |levels, tenth| levels.rss_mib += 30.0 * tenth),
            ("descriptors", |levels, tenth| levels.descriptors += 5.0 * tenth),
            ("threads", |levels, tenth| levels.threads += 5.0 * tenth),
            ("database_mib", |levels, tenth| levels.database_mib += 4.0 * tenth),
            ("wal_mib", |levels, tenth| levels.wal_mib += 2.0 * tenth),
        ];
        for (level, leak) in leaks {
            let told = grown(&tenths(leak), 5);
            assert!(told.len() == 1 && told[0].starts_with(level), "{level}: {told:?}");
        }
    }

    #[test]
    fn a_tenth_is_its_medians_and_its_largest_database() {
        let read = [3.0, 1.0, 2.0].map(|level| Levels {
            rss_mib: level,
            descriptors: level,
            threads: level,
            database_mib: level,
            wal_mib: level,
        });
        let of = Levels::of(&read).unwrap();
        assert_eq!(
            (of.rss_mib, of.descriptors, of.threads, of.database_mib, of.wal_mib),
            (2.0, 2.0, 2.0, 3.0, 2.0)
        );
        assert_eq!(Levels::of(&[]), None);
    }

    #[test]
    fn a_new_life_begins_low_and_hides_no_leak() {
        let restarted = tenths(|levels, tenth| levels.rss_mib += 40.0 * (tenth % 5.0));
        assert_eq!(grown(&restarted, 5).len(), 1);
        assert_eq!(grown(&tenths(|_, _| {})[..2], 0), [""; 0], "nothing to compare");
    }
}
