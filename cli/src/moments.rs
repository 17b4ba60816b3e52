//! When the images of a folder were taken, and where odometry has the robot then.

use std::path::Path;

use waypost_bags::{Astray, Lacks, MOST_GAP_NS, Poses, RECORDED};
use waypost_client::v1::Odometry;

use crate::failure::Failure;
use crate::images::ImageFile;
use crate::odometry::{StampedPose, message};

/// When an image was taken, and where the robot was.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Moment {
    /// Above 0.
    pub(crate) stamp_ns: i64,
    pub(crate) odometry: Option<Odometry>,
}

/// The moments of a folder's images, and what is to be told of them.
pub(crate) struct Moments {
    /// One for each image.
    pub(crate) moments: Vec<Moment>,
    /// Lines for people.
    pub(crate) told: Vec<String>,
}

/// Stamps that are made up, from above 0, which means no stamp.
pub(crate) fn even(images: usize, rate_hz: f64) -> Vec<Moment> {
    let stamp_ns = |number: usize| (number as f64 * 1e9 / rate_hz).round() as i64;
    (1..=images).map(|number| Moment { stamp_ns: stamp_ns(number), odometry: None }).collect()
}

/// The moments of images that have stamps, or else of as many rows of odometry; made up at a rate where there are
/// neither. `odometry` is a file with what is in it.
///
/// # Errors
/// [`Failure::Unfit`] where odometry and images do not fit together.
pub(crate) fn moments(
    images: &[ImageFile],
    odometry: Option<(&Path, &[StampedPose])>,
    rate_hz: f64,
) -> Result<Moments, Failure> {
    let stamps: Option<Vec<i64>> = images.iter().map(|image| image.stamp_ns).collect();
    let mut found = match (stamps, odometry) {
        (None, None) => return Ok(Moments { moments: even(images.len(), rate_hz), told: Vec::new() }),
        (Some(stamps), None) => {
            Moments { moments: stamps.into_iter().map(alone).collect(), told: Vec::new() }
        }
        (Some(stamps), Some((path, poses))) => joined(&stamps, path, poses)?,
        (None, Some((path, poses))) => a_row_each(images.len(), path, poses)?,
    };
    raise(&mut found);
    Ok(found)
}

fn alone(stamp_ns: i64) -> Moment {
    Moment { stamp_ns, odometry: None }
}

/// The poses of images without stamps, in their order.
fn a_row_each(images: usize, path: &Path, poses: &[StampedPose]) -> Result<Moments, Failure> {
    if poses.len() != images {
        return Err(Failure::Unfit(format!(
            "{} has {} poses for {images} images that have no stamps to join them by; write one row per image, in the order of \
             the images, or give the images stamps, as by names like 1305031102.175304.png",
            path.display(),
            poses.len()
        )));
    }
    let moment = |row: &StampedPose| Moment { stamp_ns: row.stamp_ns, odometry: Some(message(&row.pose)) };
    Ok(Moments { moments: poses.iter().map(moment).collect(), told: Vec::new() })
}

/// The poses at the stamps of images.
fn joined(stamps: &[i64], path: &Path, rows: &[StampedPose]) -> Result<Moments, Failure> {
    let mut poses = Poses::default();
    for row in rows {
        poses.push(row.stamp_ns, row.pose);
    }
    poses.end();
    let mut lacks = Lacks::default();
    let at = |&stamp_ns: &i64| {
        let pose = poses.at(stamp_ns).map_err(|lack| lacks.add(lack)).ok();
        Moment { stamp_ns, odometry: pose.as_ref().map(message) }
    };
    let moments: Vec<Moment> = stamps.iter().map(at).collect();
    let without = moments.iter().filter(|moment| moment.odometry.is_none()).count();
    let name = path.display();
    let count = moments.len();
    if without == count {
        let ends = |first: Option<i64>, last: Option<i64>| {
            format!("from {} s to {} s", seconds(first.unwrap_or(0)), seconds(last.unwrap_or(0)))
        };
        let (first, last) = (rows.first().map(|row| row.stamp_ns), rows.last().map(|row| row.stamp_ns));
        let is_during = |stamp: &i64| {
            first.is_some_and(|first| first <= *stamp) && last.is_some_and(|last| *stamp <= last)
        };
        if stamps.iter().any(is_during) {
            let gap_s = MOST_GAP_NS / 1_000_000_000;
            return Err(Failure::Unfit(format!(
                "no image was taken between two poses of {name} that are at most {gap_s} s apart; give odometry at its own rate, \
                 without gaps"
            )));
        }
        return Err(Failure::Unfit(format!(
            "no image was taken while {name} has poses: images are {}, poses {}; both have to be by one clock",
            ends(stamps.first().copied(), stamps.last().copied()),
            ends(first, last),
        )));
    }
    let mut told = vec![format!("{name}: {} poses, joined to {count} images by time", rows.len())];
    told.extend(without_odometry(lacks, count as u64, poses.astray()));
    Ok(Moments { moments, told })
}

/// How many frames go without odometry, and why; none if all have it.
pub(crate) fn without_odometry(lacks: Lacks, all: u64, astray: Astray) -> Option<String> {
    let Lacks { gap, outside, apart } = lacks;
    let gap_s = MOST_GAP_NS / 1_000_000_000;
    let wait_s = RECORDED.most_ns / 1_000_000_000;
    let (most_images, most_mib) = (RECORDED.most_images, RECORDED.most_bytes >> 20);
    let set_back = if astray.set_back > 0 { ", whose clock was set back" } else { "" };
    let reasons = [
        (gap, format!("around {gap} of them no two poses are at most {gap_s} s apart")),
        (outside, format!("{outside} have stamps before or after those of odometry{set_back}")),
        (
            apart,
            format!(
                "{apart} were recorded too far from odometry of their stamps: by {wait_s} s, {most_images} images or \
                 {most_mib} MiB of them"
            ),
        ),
    ];
    let reasons: Vec<String> =
        reasons.into_iter().filter_map(|(count, reason)| (count > 0).then_some(reason)).collect();
    (lacks.all() > 0).then(|| {
        format!(
            "{} of {all} frames are sent without odometry: {}; places that they make are not measured, and the map may be in \
             parts until a loop closes",
            lacks.all(),
            reasons.join("; ")
        )
    })
}

/// No stamp may be 0 or below: all rise by as much.
fn raise(found: &mut Moments) {
    let first = found.moments.first().map_or(1, |moment| moment.stamp_ns);
    if first > 0 {
        return;
    }
    let shift_ns = 1_i64.saturating_sub(first);
    for moment in &mut found.moments {
        moment.stamp_ns = moment.stamp_ns.saturating_add(shift_ns);
    }
    found.told.push(format!(
        "stamps begin at {} s, and have to be above 0: {shift_ns} ns are added to each",
        seconds(first)
    ));
}

fn seconds(stamp_ns: i64) -> String {
    format!("{:.3}", stamp_ns as f64 * 1e-9)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::odometry::parse;

    const SECOND_NS: i64 = 1_000_000_000;

    fn images(stamps: &[Option<i64>]) -> Vec<ImageFile> {
        let image =
            |&stamp_ns: &Option<i64>| ImageFile { name: String::new(), path: PathBuf::new(), stamp_ns };
        stamps.iter().map(image).collect()
    }

    /// A pose each second from 10 s on, a metre further each.
    fn rows(count: i64) -> Vec<StampedPose> {
        let rows: Vec<String> =
            (0..count).map(|index| format!("{} {index} 0 0 0 0 0 1", 10 + index)).collect();
        parse(&rows.join("\n")).unwrap()
    }

    fn of(stamps: &[Option<i64>], rows: Option<&[StampedPose]>) -> Result<Moments, Failure> {
        moments(&images(stamps), rows.map(|rows| (Path::new("odometry.tum"), rows)), 4.0)
    }

    fn x_m(moment: &Moment) -> Option<f64> {
        Some(moment.odometry.as_ref()?.pose?.position_m?.x)
    }

    #[test]
    fn made_up_stamps_rise_by_the_rate() {
        let made_up = of(&[None, None, None], None).unwrap().moments;
        let stamps: Vec<i64> = made_up.iter().map(|moment| moment.stamp_ns).collect();
        assert_eq!(stamps, [250_000_000, 500_000_000, 750_000_000]);
        assert!(made_up.iter().all(|moment| moment.odometry.is_none()));
    }

    #[test]
    fn odometry_of_another_rate_is_joined_by_time() {
        let stamps = [9_900_000_000, 10 * SECOND_NS, 10_250_000_000, 12_500_000_000].map(Some);
        let Moments { moments, told } = of(&stamps, Some(&rows(3))).unwrap();
        let positions: Vec<Option<f64>> = moments.iter().map(x_m).collect();
        assert_eq!(positions, [None, Some(0.0), Some(0.25), None]);
        assert_eq!(moments.iter().map(|moment| Some(moment.stamp_ns)).collect::<Vec<_>>(), stamps);
        assert!(
            told[0].contains("3 poses, joined to 4 images") && told[1].starts_with(
                    "2 of 4 frames are sent without odometry: 2 have stamps before or after those of odometry; places"
                ),
            "{told:?}"
        );
    }

    #[test]
    fn other_clocks_are_not_joined() {
        let error = of(&[Some(SECOND_NS)], Some(&rows(3))).err().unwrap().to_string();
        assert!(error.contains("from 1.000 s to 1.000 s, poses from 10.000 s to 12.000 s"), "{error}");
    }

    #[test]
    fn images_without_stamps_take_a_row_each() {
        let taken = of(&[None, None], Some(&rows(2))).unwrap().moments;
        assert_eq!((taken[1].stamp_ns, x_m(&taken[1])), (11 * SECOND_NS, Some(1.0)));
        let error = of(&[None, None], Some(&rows(3))).err().unwrap().to_string();
        assert!(error.contains("3 poses for 2 images"), "{error}");
    }

    #[test]
    fn stamps_that_begin_at_zero_are_raised() {
        let Moments { moments, told } = of(&[Some(0), Some(5)], None).unwrap();
        assert_eq!(moments.iter().map(|moment| moment.stamp_ns).collect::<Vec<_>>(), [1, 6]);
        assert_eq!(told.len(), 1);
    }
}
