//! Odometry files: poses of base_link at their own times, as CSV or in the TUM format.

use waypost_bags::Pose;
use waypost_client::v1::{self, Odometry, Quaternion, Vector3};

use crate::file_stamps::nanoseconds_with_exponent;

/// Describes the formats in `--help`.
pub(crate) const FORMATS: &str = "\
Odometry files have the absolute poses of base_link in the odom frame (x forward, y left, metres,
radians), with stamps that rise. Where images have stamps, poses are at any rate and by the same clock:
the pose of an image lies between the two around it, which are at most 1 s apart. Where images have none,
there is one row per image, in their order, and its stamp is the image's. Two formats are read:
  CSV, with the header     stamp_ns,x_m,y_m,yaw_rad
  TUM, without a header    stamp_s x y z qx qy qz qw     (blanks between; # begins a comment)";

const CSV_HEADER: [&str; 4] = ["stamp_ns", "x_m", "y_m", "yaw_rad"];
const TUM_COLUMNS: [&str; 8] = ["stamp_s", "x", "y", "z", "qx", "qy", "qz", "qw"];
/// How far the norm of a unit quaternion may be off after rounding to four digits.
const UNIT_TOLERANCE: f64 = 1e-3;

/// A pose by the wheels, with its time.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StampedPose {
    pub(crate) stamp_ns: i64,
    pub(crate) pose: Pose,
    /// The heading as a CSV file has it, which may count whole turns.
    pub(crate) yaw_rad: Option<f64>,
}

/// A pose as a frame carries it.
pub(crate) fn message(pose: &Pose) -> Odometry {
    Odometry { pose: Some(pose_message(pose)), covariance: Vec::new() }
}

pub(crate) fn pose_message(pose: &Pose) -> v1::Pose {
    let ([x, y, z], [qx, qy, qz, qw]) = (pose.position_m, pose.orientation);
    v1::Pose {
        position_m: Some(Vector3 { x, y, z }),
        orientation: Some(Quaternion { x: qx, y: qy, z: qz, w: qw }),
    }
}

/// What is wrong, and in which line.
#[derive(Debug, PartialEq, thiserror::Error)]
pub(crate) enum OdometryError {
    #[error("no poses in it; write a row for each")]
    Empty,
    #[error("line {line}: the header is `{found}`; write `stamp_ns,x_m,y_m,yaw_rad`")]
    Header { line: usize, found: String },
    #[error(
        "line {line}: {found} columns parted by commas, and no header; write `stamp_ns,x_m,y_m,yaw_rad` above them (the ground \
         truth of EuRoC has other columns: take columns 1 to 8 as `stamp_s x y z qx qy qz qw`, with qw last)"
    )]
    NoHeader { line: usize, found: usize },
    #[error("line {line}: {found} columns in place of {wanted}; write `{columns}`")]
    Columns { line: usize, found: usize, wanted: usize, columns: String },
    #[error(
        "line {line}: `{text}` are too many seconds for a stamp, and look like nanoseconds; divide them by 1000000000, or write them \
         without a point into a CSV file with the header `stamp_ns,x_m,y_m,yaw_rad`"
    )]
    Nanoseconds { line: usize, text: String },
    #[error("line {line}: `{text}` is no number for {column}; write a finite number")]
    Number { line: usize, column: &'static str, text: String },
    #[error(
        "line {line}: the stamp `{text}` is no whole number of nanoseconds; write seconds x 1000000000, without a point"
    )]
    WholeNanoseconds { line: usize, text: String },
    #[error(
        "line {line}: columns are parted by semicolons; part them by commas, under the header `stamp_ns,x_m,y_m,yaw_rad`"
    )]
    Semicolons { line: usize },
    #[error("line {line}: the quaternion (qx, qy, qz, qw) has length {length:.4}; it has to be 1")]
    NotARotation { line: usize, length: f64 },
    #[error("line {line}: the stamp is not above that of the row before; sort the rows by time")]
    NotRising { line: usize },
}

/// Reads either format; a comma in the first row makes it CSV.
pub(crate) fn parse(text: &str) -> Result<Vec<StampedPose>, OdometryError> {
    let mut rows = text
        .lines()
        .zip(1..)
        .map(|(row, line)| (line, row.trim().trim_start_matches('\u{feff}')))
        .filter(|(_, row)| !row.is_empty() && !row.starts_with('#'))
        .peekable();
    let poses = match rows.peek() {
        None => return Err(OdometryError::Empty),
        Some((line, row)) if row.contains(';') => return Err(OdometryError::Semicolons { line: *line }),
        Some((line, row)) if row.contains(',') && row.starts_with(|first: char| first.is_ascii_digit()) => {
            return Err(OdometryError::NoHeader { line: *line, found: row.split(',').count() });
        }
        Some((line, header)) if header.contains(',') => {
            if !header.split(',').map(str::trim).eq(CSV_HEADER) {
                return Err(OdometryError::Header { line: *line, found: (*header).to_owned() });
            }
            rows.skip(1).map(|(line, row)| Ok((line, csv_row(line, row)?))).collect::<Result<Vec<_>, _>>()?
        }
        Some((_, row)) => {
            let headings = usize::from(row.split_whitespace().eq(TUM_COLUMNS));
            rows.skip(headings)
                .map(|(line, row)| Ok((line, tum_row(line, row)?)))
                .collect::<Result<Vec<_>, _>>()?
        }
    };
    if poses.is_empty() {
        return Err(OdometryError::Empty);
    }
    if let Some((line, _)) = poses
        .iter()
        .zip(poses.iter().skip(1))
        .find_map(|((_, before), after)| (after.1.stamp_ns <= before.stamp_ns).then_some(after))
    {
        return Err(OdometryError::NotRising { line: *line });
    }
    Ok(poses.into_iter().map(|(_, pose)| pose).collect())
}

fn csv_row(line: usize, row: &str) -> Result<StampedPose, OdometryError> {
    let [stamp_ns, x, y, yaw] = fields(line, row.split(','), CSV_HEADER, ",")?;
    let stamp_ns =
        stamp_ns.parse().map_err(|_| OdometryError::WholeNanoseconds { line, text: stamp_ns.to_owned() })?;
    let [x, y, yaw] = numbers(line, [x, y, yaw], [CSV_HEADER[1], CSV_HEADER[2], CSV_HEADER[3]])?;
    let (z, w) = (yaw / 2.0).sin_cos();
    let pose = Pose { position_m: [x, y, 0.0], orientation: [0.0, 0.0, z, w] };
    Ok(StampedPose { stamp_ns, pose, yaw_rad: Some(yaw) })
}

fn tum_row(line: usize, row: &str) -> Result<StampedPose, OdometryError> {
    let [stamp_s, position_and_rotation @ ..] = fields(line, row.split_whitespace(), TUM_COLUMNS, " ")?;
    let stamp_ns = nanoseconds_with_exponent(stamp_s).ok_or_else(|| match stamp_s.parse::<f64>() {
        Ok(stamp) if stamp.is_finite() && stamp > 0.0 => {
            OdometryError::Nanoseconds { line, text: stamp_s.to_owned() }
        }
        Ok(_) | Err(_) => not_a_number(line, TUM_COLUMNS[0], stamp_s),
    })?;
    let [_, columns @ ..] = TUM_COLUMNS;
    let [x, y, z, qx, qy, qz, qw] = numbers(line, position_and_rotation, columns)?;
    let length = [qx, qy, qz, qw].map(|part| part * part).iter().sum::<f64>().sqrt();
    if (length - 1.0).abs() > UNIT_TOLERANCE {
        return Err(OdometryError::NotARotation { line, length });
    }
    let orientation = [qx, qy, qz, qw].map(|part| part / length);
    Ok(StampedPose { stamp_ns, pose: Pose { position_m: [x, y, z], orientation }, yaw_rad: None })
}

fn fields<'a, const COLUMNS: usize>(
    line: usize,
    row: impl Iterator<Item = &'a str>,
    columns: [&'static str; COLUMNS],
    parted_by: &str,
) -> Result<[&'a str; COLUMNS], OdometryError> {
    let row: Vec<&str> = row.map(str::trim).collect();
    let found = row.len();
    let wrong = |_| OdometryError::Columns { line, found, wanted: COLUMNS, columns: columns.join(parted_by) };
    row.try_into().map_err(wrong)
}

fn numbers<const COLUMNS: usize>(
    line: usize,
    texts: [&str; COLUMNS],
    columns: [&'static str; COLUMNS],
) -> Result<[f64; COLUMNS], OdometryError> {
    let mut values = [0.0; COLUMNS];
    for ((value, text), column) in values.iter_mut().zip(texts).zip(columns) {
        *value = text
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite())
            .ok_or_else(|| not_a_number(line, column, text))?;
    }
    Ok(values)
}

fn not_a_number(line: usize, column: &'static str, text: &str) -> OdometryError {
    OdometryError::Number { line, column, text: text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file_stamps::nanoseconds;

    fn pose(row: &StampedPose) -> (Vector3, Quaternion) {
        let pose = pose_message(&row.pose);
        (pose.position_m.unwrap(), pose.orientation.unwrap())
    }

    #[test]
    fn csv_is_planar() {
        let rows = parse("stamp_ns, x_m, y_m, yaw_rad\n10,1.5,-2,3.141592653589793\n\n20,0,0,0\n").unwrap();
        assert_eq!(rows.iter().map(|row| row.stamp_ns).collect::<Vec<_>>(), [10, 20]);
        let (position_m, turned) = pose(&rows[0]);
        assert_eq!(position_m, Vector3 { x: 1.5, y: -2.0, z: 0.0 });
        assert!((turned.z - 1.0).abs() < 1e-12 && turned.w.abs() < 1e-12, "{turned:?}");
        assert_eq!(pose(&rows[1]).1, Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 });
    }

    #[test]
    fn tum_keeps_nanoseconds() {
        let text = "# a comment\n1403636579.763555527 1 2 3 0 0 0.6 0.8\n1403636580 0 0 0 0 0 0 1\n";
        let rows = parse(text).unwrap();
        assert_eq!(rows[0].stamp_ns, 1_403_636_579_763_555_527);
        assert_eq!(rows[1].stamp_ns, 1_403_636_580_000_000_000);
        let (position_m, orientation) = pose(&rows[0]);
        assert_eq!(position_m, Vector3 { x: 1.0, y: 2.0, z: 3.0 });
        assert!((orientation.z - 0.6).abs() < 1e-12 && (orientation.w - 0.8).abs() < 1e-12);
    }

    #[test]
    fn tum_may_name_its_columns() {
        assert_eq!(parse("stamp_s x y z qx qy qz qw\n0.1 0 0 0 0 0 0 1\n").unwrap().len(), 1);
    }

    #[test]
    fn errors_name_their_line() {
        let csv = |rows: &str| parse(&format!("stamp_ns,x_m,y_m,yaw_rad\n{rows}")).unwrap_err();
        assert_eq!(parse("\n# nothing\n").unwrap_err(), OdometryError::Empty);
        assert_eq!(csv(""), OdometryError::Empty);
        assert!(matches!(parse("\nt,x,y,yaw\n").unwrap_err(), OdometryError::Header { line: 2, .. }));
        let euroc =
            "#timestamp, p_RS_R_x [m], q_RS_w []\n1403636580838555648,4.6,-1.7,0.5,0.5,-0.1,-0.8,-0.1\n";
        assert_eq!(parse(euroc).unwrap_err(), OdometryError::NoHeader { line: 2, found: 8 });
        assert!(matches!(csv("1,0,0,0\n2,0,0\n"), OdometryError::Columns { line: 3, found: 3, .. }));
        assert!(matches!(csv("1,nan,0,0"), OdometryError::Number { line: 2, column: "x_m", .. }));
        assert!(csv("1.5,0,0,0").to_string().contains("whole number of nanoseconds"));
        let semicolons = parse("stamp_ns;x_m;y_m;yaw_rad\n1;0;0;0\n").unwrap_err();
        assert_eq!(semicolons, OdometryError::Semicolons { line: 1 });
        assert_eq!(csv("1,0,0,0\n2,0,0,0\n2,0,0,0\n"), OdometryError::NotRising { line: 4 });
        let skewed = parse("1 0 0 0 0 0 0 2").unwrap_err();
        assert_eq!(skewed, OdometryError::NotARotation { line: 1, length: 2.0 });
        assert!(matches!(parse("1e9s 0 0 0 0 0 0 1").unwrap_err(), OdometryError::Number { line: 1, .. }));
        let nanoseconds = parse("1700000000000000000 0 0 0 0 0 0 1").unwrap_err();
        assert!(matches!(nanoseconds, OdometryError::Nanoseconds { line: 1, .. }), "{nanoseconds}");
    }

    #[test]
    fn messages_say_how_to_mend_it() {
        let missing = parse("stamp_ns,x_m,y_m,yaw_rad\n1,2\n").unwrap_err().to_string();
        assert_eq!(missing, "line 2: 2 columns in place of 4; write `stamp_ns,x_m,y_m,yaw_rad`");
        let missing = parse("1.5 0 0 0 0 0 1").unwrap_err().to_string();
        assert_eq!(missing, "line 1: 7 columns in place of 8; write `stamp_s x y z qx qy qz qw`");
    }

    /// As numpy writes them.
    #[test]
    fn numbers_may_have_exponents() {
        let row = "1.5000000000e+00 -2.5e-01 0.0e+00 0.0e+00 0.0e+00 0.0e+00 0.0e+00 1.0e+00";
        let read = parse(row).unwrap();
        assert_eq!((read[0].stamp_ns, read[0].pose.position_m[0]), (1_500_000_000, -0.25));
    }

    #[test]
    fn seconds_are_exact_or_refused() {
        assert_eq!(nanoseconds("0.000000001"), Some(1));
        assert_eq!(nanoseconds("-1.5"), Some(-1_500_000_000));
        assert_eq!(nanoseconds("12."), Some(12_000_000_000));
        assert_eq!(nanoseconds("1.0000000019"), Some(1_000_000_001));
        for text in ["", ".5", "1,5", "inf", "99999999999999", "1.5.5", "--1"] {
            assert_eq!(nanoseconds(text), None, "{text}");
        }
    }
}
