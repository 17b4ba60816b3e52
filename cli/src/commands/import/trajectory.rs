//! Where the robot was by the map and by RTAB-Map's own optimisation, laid over each other.

use std::collections::{BTreeMap, HashMap};

use nalgebra::{Matrix3, Point3, Vector3};
use serde::Serialize;
use waypost_bags::Pose;
use waypost_bags::rtabmap::RtabSession;
use waypost_client::v1::export_poses_request as request;
use waypost_client::{Client, Code, Error, v1};

use crate::failure::Failure;
use crate::odometry;

/// How far apart two trajectories of one drive are, once one was moved and turned to lie on the other as well as it can.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Apart {
    pub(super) frames: usize,
    pub(super) rmse_m: f64,
    pub(super) largest_m: f64,
}

/// A drive as several see it.
#[derive(Debug, Serialize)]
pub(super) struct Trajectory {
    /// maps/{map}/sessions/{session}
    pub(super) session: String,
    /// By RTAB-Map's optimised poses, over the frames that have one.
    pub(super) length_m: f64,
    /// The map against RTAB-Map; null where the map has no trajectory.
    pub(super) map: Option<Apart>,
    /// Odometry alone against RTAB-Map.
    pub(super) odometry: Option<Apart>,
}

/// Fewer frames lie on each other anyhow.
const FEWEST_FRAMES: usize = 3;

/// None where RTAB-Map kept too few optimised poses of the session.
pub(super) async fn trajectory(
    client: &Client,
    name: &str,
    session: &RtabSession,
    optimized: &BTreeMap<i64, Pose>,
) -> Result<Option<Trajectory>, Failure> {
    let theirs: Vec<(i64, Point3<f64>)> =
        session.frames().filter_map(|node| Some((node.stamp_ns, point(optimized.get(&node.id)?)))).collect();
    if theirs.len() < FEWEST_FRAMES {
        return Ok(None);
    }
    let by_wheels = session.frames().filter_map(|node| Some((node.stamp_ns, point(node.pose.as_ref()?))));
    let length_m = theirs.windows(2).map(|step| (step[1].1 - step[0].1).norm()).sum();
    let ours = by_map(client, name).await?;
    Ok(Some(Trajectory {
        session: name.to_owned(),
        length_m,
        map: apart(&ours, &theirs),
        odometry: apart(&by_wheels.collect(), &theirs),
    }))
}

/// Where the map has the session's frames, by their stamps; nowhere if no way was measured.
async fn by_map(client: &Client, name: &str) -> Result<HashMap<i64, Point3<f64>>, Failure> {
    let request = v1::ExportPosesRequest {
        name: name.to_owned(),
        format: request::Format::Tum.into(),
        ..v1::ExportPosesRequest::default()
    };
    let mut text = Vec::new();
    match client.export_poses(request, &mut text).await {
        Ok(_) => {}
        Err(Error::Status { code: Code::FailedPrecondition, .. }) => return Ok(HashMap::new()),
        Err(error) => return Err(error.into()),
    }
    let poses = odometry::parse(&String::from_utf8_lossy(&text)).unwrap_or_default();
    Ok(poses.iter().map(|row| (row.stamp_ns, point(&row.pose))).collect())
}

fn point(pose: &Pose) -> Point3<f64> {
    Point3::from(pose.position_m)
}

/// Over the frames that both have; none if those are too few.
fn apart(ours: &HashMap<i64, Point3<f64>>, theirs: &[(i64, Point3<f64>)]) -> Option<Apart> {
    let pairs = theirs.iter().filter_map(|(stamp_ns, there)| Some((*ours.get(stamp_ns)?, *there)));
    let pairs: Vec<(Point3<f64>, Point3<f64>)> = pairs.collect();
    if pairs.len() < FEWEST_FRAMES {
        return None;
    }
    let squares = squares_after_laying_over(&pairs);
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    let largest = squares.iter().copied().fold(0.0, f64::max);
    Some(Apart { frames: pairs.len(), rmse_m: mean.sqrt(), largest_m: largest.sqrt() })
}

/// The squared distances that are left by the rigid motion that leaves the smallest sum of them (Kabsch, 1976).
fn squares_after_laying_over(pairs: &[(Point3<f64>, Point3<f64>)]) -> Vec<f64> {
    let count = pairs.len() as f64;
    let middle = |points: Vec<Vector3<f64>>| points.into_iter().sum::<Vector3<f64>>() / count;
    let from = middle(pairs.iter().map(|(ours, _)| ours.coords).collect());
    let to = middle(pairs.iter().map(|(_, theirs)| theirs.coords).collect());
    let products = pairs.iter().map(|(ours, theirs)| (theirs.coords - to) * (ours.coords - from).transpose());
    let svd = products.sum::<Matrix3<f64>>().svd(true, true);
    let rotation = match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => {
            // No mirror: along the axis that matters least.
            let sign = (u * v_t).determinant().signum();
            let least = svd.singular_values.imin();
            let mut signs = Vector3::repeat(1.0);
            signs[least] = sign;
            u * Matrix3::from_diagonal(&signs) * v_t
        }
        (_, _) => Matrix3::identity(),
    };
    pairs
        .iter()
        .map(|(ours, theirs)| (rotation * (ours.coords - from) - (theirs.coords - to)).norm_squared())
        .collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::*;

    #[test]
    fn a_moved_and_turned_drive_is_the_same() {
        let turn = Rotation3::from_euler_angles(0.3, -0.2, 2.5);
        let bend = |step: i64| Point3::new(step as f64, (step as f64 * 0.7).sin(), 0.0);
        let ours: HashMap<i64, Point3<f64>> = (0..20).map(|step| (step, bend(step))).collect();
        let mut theirs: Vec<_> =
            (0..20).map(|step| (step, turn * bend(step) + Vector3::new(3.0, -8.0, 1.0))).collect();
        let same = apart(&ours, &theirs).unwrap();
        assert!(same.frames == 20 && same.rmse_m < 1e-9 && same.largest_m < 1e-9, "{same:?}");
        // A screw that turns the other way is another drive.
        let screw = |step: i64| bend(step) + Vector3::new(0.0, 0.0, (step as f64 * 0.7).cos());
        let mirrored: Vec<_> =
            (0..20).map(|step| (step, Point3::new(screw(step).x, -screw(step).y, screw(step).z))).collect();
        let turning: HashMap<i64, Point3<f64>> = (0..20).map(|step| (step, screw(step))).collect();
        assert!(apart(&turning, &mirrored).unwrap().rmse_m > 0.1);
        theirs[7].1 += Vector3::new(0.0, 0.0, 2.0);
        let other = apart(&ours, &theirs).unwrap();
        assert!((0.2..0.5).contains(&other.rmse_m) && other.largest_m > 1.5, "{other:?}");
        assert_eq!(apart(&ours, &theirs[..2]), None);
    }
}
