//! Poses and cameras, to and from messages.

use nalgebra::Isometry3;
use posegraph::PlanarPose;
use topomap::mapper::MapPose;
use topomap::metric::{Odometry, RelativePose};
use waypost_proto::v1;
use waypost_proto::v1::camera::Model;
use waypost_proto::v1::panorama::Projection;

use super::known;
use crate::camera::{Camera, CameraModel, Mirror};
use crate::error::ServiceError;

pub(crate) fn odometry_message(odometry: &Odometry) -> v1::Odometry {
    v1::Odometry {
        pose: Some(pose_message(odometry.pose())),
        // Stored column by column.
        covariance: odometry
            .covariance()
            .map_or_else(Vec::new, |covariance| covariance.transpose().as_slice().to_vec()),
    }
}

/// What a robot measured.
pub(crate) fn measured(pose: Option<v1::Pose>, covariance: Vec<f64>) -> Result<RelativePose, ServiceError> {
    let missing =
        "nothing was measured; send the pose of base_link at the frame in base_link at the earlier one";
    let pose = pose.ok_or_else(|| ServiceError::invalid(missing))?;
    let (position_m, orientation) = pose_parts(pose, "the measurement")?;
    let covariance: [f64; 36] = covariance.try_into().map_err(|covariance: Vec<f64>| {
        ServiceError::invalid(format_args!(
            "the measurement's covariance has {} values; send 36, row by row: how sure it is decides what it counts",
            covariance.len()
        ))
    })?;
    RelativePose::measured_in_space(position_m, orientation, &covariance).map_err(ServiceError::invalid)
}

pub(crate) fn map_pose_message(pose: &MapPose) -> v1::MapPose {
    let MapPose { part, robot, odom } = pose;
    v1::MapPose { part: part.number(), robot: Some(planar_pose(robot)), map_to_odom: Some(planar_pose(odom)) }
}

/// A pose on the ground.
pub(crate) fn planar_pose(pose: &PlanarPose) -> v1::Pose {
    pose_message(&pose.on_the_ground())
}

fn pose_message(pose: &Isometry3<f64>) -> v1::Pose {
    // No zero has a minus.
    let [x, y, z] = [pose.translation.x, pose.translation.y, pose.translation.z].map(|metres| metres + 0.0);
    let position_m = Some(v1::Vector3 { x, y, z });
    let rotation = pose.rotation;
    let [x, y, z, w] = [rotation.i, rotation.j, rotation.k, rotation.w].map(|number| number + 0.0);
    v1::Pose { position_m, orientation: Some(v1::Quaternion { x, y, z, w }) }
}

pub(crate) fn odometry(message: v1::Odometry) -> Result<Odometry, ServiceError> {
    let v1::Odometry { pose, covariance } = message;
    let missing = "the odometry has no pose; send position and orientation, or leave the odometry out";
    let pose = pose.ok_or_else(|| ServiceError::invalid(missing))?;
    let (position_m, orientation) = pose_parts(pose, "the odometry")?;
    let covariance: Option<[f64; 36]> = match covariance.len() {
        0 => None,
        36 => covariance.try_into().ok(),
        other => {
            return Err(ServiceError::invalid(format_args!(
                "the odometry's covariance has {other} values; send 36, row by row, or none"
            )));
        }
    };
    Odometry::new(position_m, orientation, covariance.as_ref()).map_err(ServiceError::invalid)
}

fn pose_parts(message: v1::Pose, whose: &str) -> Result<([f64; 3], [f64; 4]), ServiceError> {
    let v1::Pose { position_m, orientation } = message;
    let (Some(position), Some(orientation)) = (position_m, orientation) else {
        return Err(ServiceError::invalid(format_args!(
            "the pose of {whose} needs both position and orientation"
        )));
    };
    let v1::Vector3 { x, y, z } = position;
    let position = [x, y, z];
    let v1::Quaternion { x, y, z, w } = orientation;
    Ok((position, [x, y, z, w]))
}

pub(crate) fn camera(message: v1::Camera) -> Result<Camera, ServiceError> {
    let v1::Camera { model, image_width_px, image_height_px, base_to_camera } = message;
    let camera = Camera {
        model: model.map(camera_model).transpose()?,
        image_size_px: (image_width_px.is_some() || image_height_px.is_some())
            .then_some((image_width_px.unwrap_or(0), image_height_px.unwrap_or(0))),
        base_to_camera: base_to_camera.map(|message| pose_parts(message, "the camera")).transpose()?,
    };
    camera.check()?;
    Ok(camera)
}

fn camera_model(model: Model) -> Result<CameraModel, ServiceError> {
    Ok(match model {
        Model::Pinhole(v1::Pinhole { fx_px, fy_px, cx_px, cy_px, distortion }) => {
            CameraModel::Pinhole { focal_px: [fx_px, fy_px], center_px: [cx_px, cy_px], distortion }
        }
        Model::FieldOfView(v1::FieldOfView { horizontal_rad }) => CameraModel::FieldOfView { horizontal_rad },
        Model::Fisheye(v1::Fisheye { fx_px, fy_px, cx_px, cy_px, distortion }) => {
            CameraModel::Fisheye { focal_px: [fx_px, fy_px], center_px: [cx_px, cy_px], distortion }
        }
        Model::Panorama(panorama) => {
            let v1::Panorama { projection, vertical_rad } = panorama;
            match known("projection", projection)? {
                Projection::Cylindrical => {
                    CameraModel::Cylindrical { vertical_rad: vertical_rad.unwrap_or(0.0) }
                }
                Projection::Equirectangular => CameraModel::Equirectangular { vertical_rad },
                Projection::Unspecified => {
                    return Err(ServiceError::invalid(
                        "say whether the panorama is cylindrical or equirectangular",
                    ));
                }
            }
        }
        Model::HyperbolicMirror(mirror) => {
            let v1::HyperbolicMirror {
                center_x_px,
                center_y_px,
                inner_radius_px,
                outer_radius_px,
                eccentricity,
                horizon_radius_px,
                ahead_rad,
            } = mirror;
            let center_px = [center_x_px, center_y_px];
            CameraModel::HyperbolicMirror(Mirror {
                center_px,
                inner_radius_px,
                outer_radius_px,
                eccentricity,
                horizon_radius_px: horizon_radius_px.unwrap_or(0.0),
                ahead_rad,
            })
        }
    })
}

/// A camera as it was declared.
pub(crate) fn camera_message(camera: &Camera) -> v1::Camera {
    let Camera { model, image_size_px, base_to_camera } = camera;
    let (image_width_px, image_height_px) = image_size_px.unzip();
    let base_to_camera = base_to_camera.map(|([x, y, z], [i, j, k, w])| v1::Pose {
        position_m: Some(v1::Vector3 { x, y, z }),
        orientation: Some(v1::Quaternion { x: i, y: j, z: k, w }),
    });
    let model = model.as_ref().map(model_message);
    v1::Camera { model, image_width_px, image_height_px, base_to_camera }
}

fn model_message(model: &CameraModel) -> Model {
    match model.clone() {
        CameraModel::Pinhole { focal_px: [fx_px, fy_px], center_px: [cx_px, cy_px], distortion } => {
            Model::Pinhole(v1::Pinhole { fx_px, fy_px, cx_px, cy_px, distortion })
        }
        CameraModel::FieldOfView { horizontal_rad } => Model::FieldOfView(v1::FieldOfView { horizontal_rad }),
        CameraModel::Fisheye { focal_px: [fx_px, fy_px], center_px: [cx_px, cy_px], distortion } => {
            Model::Fisheye(v1::Fisheye { fx_px, fy_px, cx_px, cy_px, distortion })
        }
        CameraModel::Cylindrical { vertical_rad } => Model::Panorama(v1::Panorama {
            projection: Projection::Cylindrical.into(),
            vertical_rad: Some(vertical_rad),
        }),
        CameraModel::Equirectangular { vertical_rad } => {
            Model::Panorama(v1::Panorama { projection: Projection::Equirectangular.into(), vertical_rad })
        }
        CameraModel::HyperbolicMirror(Mirror {
            center_px: [center_x_px, center_y_px],
            inner_radius_px,
            outer_radius_px,
            eccentricity,
            horizon_radius_px,
            ahead_rad,
        }) => Model::HyperbolicMirror(v1::HyperbolicMirror {
            center_x_px,
            center_y_px,
            inner_radius_px,
            outer_radius_px,
            eccentricity,
            // 0 where it was not declared.
            horizon_radius_px: Some(horizon_radius_px).filter(|radius| *radius > 0.0),
            ahead_rad,
        }),
    }
}
