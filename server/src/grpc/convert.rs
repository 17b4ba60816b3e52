//! Messages to the service's values. Every field is named, so that none is forgotten.

use nalgebra::Isometry3;
use topomap::mapper::MapPose;
use topomap::odometry::Odometry;
use topomap::relative_pose::RelativePose;
use topomap::relaxation::PlanarPose;
use waypost_proto::v1;
use waypost_proto::v1::camera::Model;
use waypost_proto::v1::panorama::Projection;

use crate::error::ServiceError;
use crate::service::camera::{Camera, CameraModel};
use crate::service::content::{Content, WordList};

/// An enum's value, unless it is one that this server does not know.
pub(super) fn known<E: TryFrom<i32>>(field: &str, value: i32) -> Result<E, ServiceError> {
    E::try_from(value).map_err(|_| {
        ServiceError::invalid(format_args!("{field} has the value {value}, which this server does not know"))
    })
}

pub(super) fn histogram(message: v1::WordHistogram) -> Content {
    let v1::WordHistogram { words, counts } = message;
    Content::Histogram { words, counts }
}

pub(super) fn word_list(message: v1::WordList) -> Content {
    let v1::WordList { words, x_px, y_px, size_px, angle_rad, image_width_px, image_height_px } = message;
    Content::Words(WordList { words, x_px, y_px, size_px, angle_rad, image_width_px, image_height_px })
}

pub(super) fn odometry_message(odometry: &Odometry) -> v1::Odometry {
    v1::Odometry {
        pose: Some(pose_message(odometry.pose())),
        // Stored column by column.
        covariance: odometry
            .covariance()
            .map_or_else(Vec::new, |covariance| covariance.transpose().as_slice().to_vec()),
    }
}

/// What a robot measured.
pub(super) fn measured(pose: Option<v1::Pose>, covariance: Vec<f64>) -> Result<RelativePose, ServiceError> {
    let missing =
        "nothing was measured; send the pose of base_link at the frame in base_link at the earlier one";
    let pose = pose.ok_or_else(|| ServiceError::invalid(missing))?;
    let (position_m, orientation) = self::pose(pose, "the measurement")?;
    let covariance: [f64; 36] = covariance.try_into().map_err(|covariance: Vec<f64>| {
        ServiceError::invalid(format_args!(
            "the measurement's covariance has {} values; send 36, row by row: how sure it is decides what it counts",
            covariance.len()
        ))
    })?;
    RelativePose::measured_in_space(position_m, orientation, &covariance).map_err(ServiceError::invalid)
}

pub(super) fn map_pose(pose: &MapPose) -> v1::MapPose {
    let MapPose { part, robot, odom } = pose;
    v1::MapPose { part: *part, robot: Some(planar_pose(robot)), map_to_odom: Some(planar_pose(odom)) }
}

/// A pose on the ground.
pub(super) fn planar_pose(pose: &PlanarPose) -> v1::Pose {
    pose_message(&pose.on_the_ground())
}

fn pose_message(pose: &Isometry3<f64>) -> v1::Pose {
    let (position, orientation) = (pose.translation, pose.rotation);
    v1::Pose {
        position_m: Some(v1::Vector3 { x: position.x, y: position.y, z: position.z }),
        orientation: Some(v1::Quaternion {
            x: orientation.i,
            y: orientation.j,
            z: orientation.k,
            w: orientation.w,
        }),
    }
}

pub(super) fn odometry(message: v1::Odometry) -> Result<Odometry, ServiceError> {
    let v1::Odometry { pose, covariance } = message;
    let missing = "the odometry has no pose; send position and orientation, or leave the odometry out";
    let pose = pose.ok_or_else(|| ServiceError::invalid(missing))?;
    let (position_m, orientation) = self::pose(pose, "the odometry")?;
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

fn pose(message: v1::Pose, whose: &str) -> Result<([f64; 3], [f64; 4]), ServiceError> {
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

pub(super) fn camera(message: v1::Camera) -> Result<Camera, ServiceError> {
    let v1::Camera { model, image_width_px, image_height_px, base_to_camera } = message;
    let camera = Camera {
        model: model.map(camera_model).transpose()?,
        image_size_px: ((image_width_px, image_height_px) != (0, 0))
            .then_some((image_width_px, image_height_px)),
        base_to_camera: base_to_camera.map(|message| pose(message, "the camera")).transpose()?,
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
                Projection::Cylindrical => CameraModel::Cylindrical { vertical_rad },
                Projection::Equirectangular => CameraModel::Equirectangular {
                    vertical_rad: (vertical_rad != 0.0).then_some(vertical_rad),
                },
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
            CameraModel::HyperbolicMirror {
                center_px,
                inner_radius_px,
                outer_radius_px,
                eccentricity,
                horizon_radius_px,
                ahead_rad,
            }
        }
    })
}
