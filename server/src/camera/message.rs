//! Cameras as databases and snapshots kept them before they had a byte form of their own: the message that robots sent,
//! as it was then. Its fields never change.

use prost::Message;

use super::{Camera, CameraModel, Mirror};

#[derive(Clone, PartialEq, Message)]
struct CameraMessage {
    #[prost(oneof = "ModelMessage", tags = "1, 2, 3, 4, 5")]
    model: Option<ModelMessage>,
    #[prost(uint32, tag = "6")]
    image_width_px: u32,
    #[prost(uint32, tag = "7")]
    image_height_px: u32,
    #[prost(message, optional, tag = "8")]
    base_to_camera: Option<PoseMessage>,
}

#[derive(Clone, PartialEq, prost::Oneof)]
enum ModelMessage {
    #[prost(message, tag = "1")]
    Pinhole(LensMessage),
    #[prost(message, tag = "2")]
    FieldOfView(FieldOfViewMessage),
    #[prost(message, tag = "3")]
    Fisheye(LensMessage),
    #[prost(message, tag = "4")]
    Panorama(PanoramaMessage),
    #[prost(message, tag = "5")]
    HyperbolicMirror(MirrorMessage),
}

#[derive(Clone, PartialEq, Message)]
struct LensMessage {
    #[prost(double, tag = "1")]
    fx_px: f64,
    #[prost(double, tag = "2")]
    fy_px: f64,
    #[prost(double, tag = "3")]
    cx_px: f64,
    #[prost(double, tag = "4")]
    cy_px: f64,
    #[prost(double, repeated, tag = "5")]
    distortion: Vec<f64>,
}

#[derive(Clone, PartialEq, Message)]
struct FieldOfViewMessage {
    #[prost(double, tag = "1")]
    horizontal_rad: f64,
}

#[derive(Clone, PartialEq, Message)]
struct PanoramaMessage {
    /// 1 is cylindrical, 2 equirectangular.
    #[prost(int32, tag = "1")]
    projection: i32,
    /// 0 if it is not known.
    #[prost(double, tag = "2")]
    vertical_rad: f64,
}

#[derive(Clone, PartialEq, Message)]
struct MirrorMessage {
    #[prost(double, tag = "1")]
    center_x_px: f64,
    #[prost(double, tag = "2")]
    center_y_px: f64,
    #[prost(double, tag = "3")]
    inner_radius_px: f64,
    #[prost(double, tag = "4")]
    outer_radius_px: f64,
    #[prost(double, tag = "5")]
    eccentricity: f64,
    #[prost(double, tag = "6")]
    horizon_radius_px: f64,
    #[prost(double, tag = "7")]
    ahead_rad: f64,
}

#[derive(Clone, PartialEq, Message)]
struct PoseMessage {
    #[prost(message, optional, tag = "1")]
    position_m: Option<VectorMessage>,
    #[prost(message, optional, tag = "2")]
    orientation: Option<QuaternionMessage>,
}

#[derive(Clone, PartialEq, Message)]
struct VectorMessage {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
}

#[derive(Clone, PartialEq, Message)]
struct QuaternionMessage {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
    #[prost(double, tag = "4")]
    w: f64,
}

/// A camera that was kept as an encoded message; none if the bytes are no such message.
pub(crate) fn from_message(encoded: &[u8]) -> Option<Camera> {
    let CameraMessage { model, image_width_px, image_height_px, base_to_camera } =
        CameraMessage::decode(encoded).ok()?;
    let size_px = (image_width_px, image_height_px);
    let pose = base_to_camera.and_then(|pose| Some((pose.position_m?, pose.orientation?)));
    Some(Camera {
        model: model.and_then(camera_model),
        image_size_px: (size_px != (0, 0)).then_some(size_px),
        base_to_camera: pose.map(|(position, orientation)| {
            let VectorMessage { x, y, z } = position;
            let position_m = [x, y, z];
            let QuaternionMessage { x, y, z, w } = orientation;
            (position_m, [x, y, z, w])
        }),
    })
}

fn camera_model(model: ModelMessage) -> Option<CameraModel> {
    Some(match model {
        ModelMessage::Pinhole(LensMessage { fx_px, fy_px, cx_px, cy_px, distortion }) => {
            CameraModel::Pinhole { focal_px: [fx_px, fy_px], center_px: [cx_px, cy_px], distortion }
        }
        ModelMessage::FieldOfView(FieldOfViewMessage { horizontal_rad }) => {
            CameraModel::FieldOfView { horizontal_rad }
        }
        ModelMessage::Fisheye(LensMessage { fx_px, fy_px, cx_px, cy_px, distortion }) => {
            CameraModel::Fisheye { focal_px: [fx_px, fy_px], center_px: [cx_px, cy_px], distortion }
        }
        ModelMessage::Panorama(PanoramaMessage { projection: 1, vertical_rad }) => {
            CameraModel::Cylindrical { vertical_rad }
        }
        ModelMessage::Panorama(PanoramaMessage { projection: 2, vertical_rad }) => {
            CameraModel::Equirectangular { vertical_rad: (vertical_rad > 0.0).then_some(vertical_rad) }
        }
        // No robot could declare it.
        ModelMessage::Panorama(PanoramaMessage { .. }) => return None,
        ModelMessage::HyperbolicMirror(MirrorMessage {
            center_x_px,
            center_y_px,
            inner_radius_px,
            outer_radius_px,
            eccentricity,
            horizon_radius_px,
            ahead_rad,
        }) => CameraModel::HyperbolicMirror(Mirror {
            center_px: [center_x_px, center_y_px],
            inner_radius_px,
            outer_radius_px,
            eccentricity,
            horizon_radius_px,
            ahead_rad,
        }),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A number as a message has it: the key of a double, then the double.
    fn double(tag: u8, value: f64) -> Vec<u8> {
        [vec![tag << 3 | 1], value.to_le_bytes().to_vec()].concat()
    }

    fn nested(tag: u8, content: &[u8]) -> Vec<u8> {
        [&[tag << 3 | 2, content.len() as u8], content].concat()
    }

    #[test]
    fn messages_of_servers_before_are_read() {
        // A pinhole of 640 x 480 with one metre to the left, looking ahead.
        let distortion: Vec<u8> = [0.1_f64, 0.2, 0.3, 0.4].iter().flat_map(|d| d.to_le_bytes()).collect();
        let lens =
            [double(1, 500.0), double(2, 490.0), double(3, 319.5), double(4, 239.5), nested(5, &distortion)];
        let pose =
            [nested(1, &double(2, 1.0)), nested(2, &[double(1, 0.6), double(4, 0.8)].concat())].concat();
        let size = [vec![6 << 3, 0x80, 0x05], vec![7 << 3, 0xe0, 0x03]].concat();
        let message = [nested(1, &lens.concat()), size, nested(8, &pose)].concat();
        let camera = Camera {
            model: Some(CameraModel::Pinhole {
                focal_px: [500.0, 490.0],
                center_px: [319.5, 239.5],
                distortion: vec![0.1, 0.2, 0.3, 0.4],
            }),
            image_size_px: Some((640, 480)),
            base_to_camera: Some(([0.0, 1.0, 0.0], [0.6, 0.0, 0.0, 0.8])),
        };
        assert_eq!(from_message(&message), Some(camera));
    }

    #[test]
    fn every_model_is_read() {
        let model = |tag: u8, content: Vec<u8>| from_message(&nested(tag, &content)).unwrap().model;
        let view = CameraModel::FieldOfView { horizontal_rad: 1.2 };
        assert_eq!(model(2, double(1, 1.2)), Some(view));
        let fisheye =
            CameraModel::Fisheye { focal_px: [300.0, 0.0], center_px: [0.0; 2], distortion: vec![] };
        assert_eq!(model(3, double(1, 300.0)), Some(fisheye));
        let panorama = |projection: u8, rest: Vec<u8>| model(4, [vec![1 << 3, projection], rest].concat());
        assert_eq!(panorama(1, double(2, 1.5)), Some(CameraModel::Cylindrical { vertical_rad: 1.5 }));
        assert_eq!(panorama(2, vec![]), Some(CameraModel::Equirectangular { vertical_rad: None }));
        let band = CameraModel::Equirectangular { vertical_rad: Some(0.7) };
        assert_eq!(panorama(2, double(2, 0.7)), Some(band));
        assert_eq!(panorama(3, vec![]), None);
        let mirror: Vec<u8> = (1..=7).flat_map(|tag| double(tag, f64::from(tag))).collect();
        let found = CameraModel::HyperbolicMirror(Mirror {
            center_px: [1.0, 2.0],
            inner_radius_px: 3.0,
            outer_radius_px: 4.0,
            eccentricity: 5.0,
            horizon_radius_px: 6.0,
            ahead_rad: 7.0,
        });
        assert_eq!(model(5, mirror), Some(found));
        assert_eq!(from_message(&[]), Some(Camera::default()));
        assert_eq!(from_message(b"W is no key"), None);
    }
}
