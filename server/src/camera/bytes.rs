//! The byte form of a camera, as the database and snapshots keep it. Version 1:
//!
//! ```text
//! camera = version u8  model  image size  pose
//! model  = kind u8, then by kind, each number f64:
//!     0  none
//!     1  pinhole: focal lengths and centre, x and y each; count varint, then so many distortion values
//!     2  field of view: horizontal angle
//!     3  fisheye: as a pinhole
//!     4  cylindrical panorama: vertical angle
//!     5  equirectangular panorama
//!     6  the same with its vertical angle
//!     7  hyperbolic mirror: centre x and y, inner and outer radius, eccentricity, radius of the horizon, ahead
//! image size = flag u8; if 1, width u32 and height u32
//! pose       = flag u8; if 1, position x, y, z and orientation x, y, z, w, each f64
//! ```
//!
//! Numbers are those of [`fabmap::codec`]; lengths are in pixels, positions in metres, angles in radians.

use fabmap::codec::{DecodeError, Reader, Writer};

use super::{Camera, CameraModel, Mirror};

const VERSION: u8 = 1;

const NONE: u8 = 0;
const PINHOLE: u8 = 1;
const FIELD_OF_VIEW: u8 = 2;
const FISHEYE: u8 = 3;
const CYLINDRICAL: u8 = 4;
const EQUIRECTANGULAR: u8 = 5;
const EQUIRECTANGULAR_BAND: u8 = 6;
const HYPERBOLIC_MIRROR: u8 = 7;

impl Camera {
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let Self { model, image_size_px, base_to_camera } = self;
        let mut writer = Writer::default();
        writer.u8(VERSION);
        match model {
            None => writer.u8(NONE),
            Some(model) => write_model(&mut writer, model),
        }
        writer.u8(u8::from(image_size_px.is_some()));
        if let Some((width, height)) = image_size_px {
            writer.u32(*width);
            writer.u32(*height);
        }
        writer.u8(u8::from(base_to_camera.is_some()));
        if let Some((position_m, orientation)) = base_to_camera {
            write_all(&mut writer, position_m);
            write_all(&mut writer, orientation);
        }
        writer.into_bytes()
    }

    /// # Errors
    /// [`DecodeError`] if the bytes are not what [`Camera::to_bytes`] makes.
    pub(crate) fn from_bytes(bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(bytes);
        let version = reader.u8()?;
        if version != VERSION {
            return Err(DecodeError::Version { found: version.into(), newest: VERSION.into() });
        }
        let model = read_model(&mut reader)?;
        let image_size_px = match read_flag(&mut reader)? {
            Flag::Absent => None,
            Flag::Present => Some((reader.u32()?, reader.u32()?)),
        };
        let base_to_camera = match read_flag(&mut reader)? {
            Flag::Absent => None,
            Flag::Present => Some((read_all(&mut reader)?, read_all(&mut reader)?)),
        };
        reader.end()?;
        Ok(Self { model, image_size_px, base_to_camera })
    }
}

fn write_model(writer: &mut Writer, model: &CameraModel) {
    match model {
        CameraModel::Pinhole { focal_px, center_px, distortion } => {
            write_lens(writer, PINHOLE, focal_px, center_px, distortion);
        }
        CameraModel::FieldOfView { horizontal_rad } => {
            writer.u8(FIELD_OF_VIEW);
            writer.f64(*horizontal_rad);
        }
        CameraModel::Fisheye { focal_px, center_px, distortion } => {
            write_lens(writer, FISHEYE, focal_px, center_px, distortion);
        }
        CameraModel::Cylindrical { vertical_rad } => {
            writer.u8(CYLINDRICAL);
            writer.f64(*vertical_rad);
        }
        CameraModel::Equirectangular { vertical_rad: None } => writer.u8(EQUIRECTANGULAR),
        CameraModel::Equirectangular { vertical_rad: Some(vertical_rad) } => {
            writer.u8(EQUIRECTANGULAR_BAND);
            writer.f64(*vertical_rad);
        }
        CameraModel::HyperbolicMirror(mirror) => {
            writer.u8(HYPERBOLIC_MIRROR);
            write_all(writer, &mirror.center_px);
            writer.f64(mirror.inner_radius_px);
            writer.f64(mirror.outer_radius_px);
            writer.f64(mirror.eccentricity);
            writer.f64(mirror.horizon_radius_px);
            writer.f64(mirror.ahead_rad);
        }
    }
}

fn read_model(reader: &mut Reader<'_>) -> Result<Option<CameraModel>, DecodeError> {
    Ok(Some(match reader.u8()? {
        NONE => return Ok(None),
        PINHOLE => {
            let focal_px = read_all(reader)?;
            let center_px = read_all(reader)?;
            CameraModel::Pinhole { focal_px, center_px, distortion: read_list(reader)? }
        }
        FIELD_OF_VIEW => CameraModel::FieldOfView { horizontal_rad: reader.f64()? },
        FISHEYE => {
            let focal_px = read_all(reader)?;
            let center_px = read_all(reader)?;
            CameraModel::Fisheye { focal_px, center_px, distortion: read_list(reader)? }
        }
        CYLINDRICAL => CameraModel::Cylindrical { vertical_rad: reader.f64()? },
        EQUIRECTANGULAR => CameraModel::Equirectangular { vertical_rad: None },
        EQUIRECTANGULAR_BAND => CameraModel::Equirectangular { vertical_rad: Some(reader.f64()?) },
        HYPERBOLIC_MIRROR => CameraModel::HyperbolicMirror(Mirror {
            center_px: read_all(reader)?,
            inner_radius_px: reader.f64()?,
            outer_radius_px: reader.f64()?,
            eccentricity: reader.f64()?,
            horizon_radius_px: reader.f64()?,
            ahead_rad: reader.f64()?,
        }),
        other => return Err(DecodeError::invalid(format_args!("a camera of kind {other}"))),
    }))
}

fn write_lens(writer: &mut Writer, kind: u8, focal_px: &[f64; 2], center_px: &[f64; 2], distortion: &[f64]) {
    writer.u8(kind);
    write_all(writer, focal_px);
    write_all(writer, center_px);
    writer.varint(distortion.len() as u64);
    write_all(writer, distortion);
}

fn write_all(writer: &mut Writer, values: &[f64]) {
    values.iter().for_each(|value| writer.f64(*value));
}

fn read_all<const N: usize>(reader: &mut Reader<'_>) -> Result<[f64; N], DecodeError> {
    let mut values = [0.0; N];
    for value in &mut values {
        *value = reader.f64()?;
    }
    Ok(values)
}

fn read_list(reader: &mut Reader<'_>) -> Result<Vec<f64>, DecodeError> {
    let count = reader.count(size_of::<f64>())?;
    (0..count).map(|_| reader.f64()).collect()
}

enum Flag {
    Absent,
    Present,
}

fn read_flag(reader: &mut Reader<'_>) -> Result<Flag, DecodeError> {
    match reader.u8()? {
        0 => Ok(Flag::Absent),
        1 => Ok(Flag::Present),
        other => Err(DecodeError::invalid(format_args!("flag {other}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cameras() -> Vec<Camera> {
        let lens = |distortion: &[f64]| ([500.0, 490.0], [319.5, 239.5], distortion.to_vec());
        let (focal_px, center_px, distortion) = lens(&[0.1, 0.2, 0.3, 0.4, 0.5]);
        let pinhole = CameraModel::Pinhole { focal_px, center_px, distortion };
        let (focal_px, center_px, distortion) = lens(&[]);
        let fisheye = CameraModel::Fisheye { focal_px, center_px, distortion };
        let mirror = CameraModel::HyperbolicMirror(Mirror {
            center_px: [200.0, 150.0],
            inner_radius_px: 40.0,
            outer_radius_px: 140.0,
            eccentricity: 1.5,
            horizon_radius_px: 100.0,
            ahead_rad: -0.5,
        });
        let models = [
            pinhole,
            CameraModel::FieldOfView { horizontal_rad: 1.2 },
            fisheye,
            CameraModel::Cylindrical { vertical_rad: 1.5 },
            CameraModel::Equirectangular { vertical_rad: None },
            CameraModel::Equirectangular { vertical_rad: Some(0.7) },
            mirror,
        ];
        let declared = models.map(|model| Camera {
            model: Some(model),
            image_size_px: Some((640, 480)),
            base_to_camera: Some(([0.1, 0.2, 0.3], [0.5, -0.5, 0.5, -0.5])),
        });
        declared.into_iter().chain([Camera::default()]).collect()
    }

    #[test]
    fn what_is_written_is_read() {
        for camera in cameras() {
            assert_eq!(Camera::from_bytes(&camera.to_bytes()), Ok(camera));
        }
    }

    #[test]
    fn the_bytes_stay_as_they_are() {
        let view = CameraModel::FieldOfView { horizontal_rad: 1.0 };
        let camera = Camera { model: Some(view), image_size_px: Some((2, 1)), base_to_camera: None };
        let bytes = [1, 2, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f, 1, 2, 0, 0, 0, 1, 0, 0, 0, 0];
        assert_eq!(camera.to_bytes(), bytes);
    }

    #[test]
    fn nothing_damaged_is_read() {
        for camera in cameras() {
            let bytes = camera.to_bytes();
            for length in 0..bytes.len() {
                assert!(Camera::from_bytes(&bytes[..length]).is_err(), "{camera:?}, {length} bytes");
            }
            assert!(Camera::from_bytes(&[bytes, vec![0]].concat()).is_err());
        }
        let newer = Camera::from_bytes(&[2, 0, 0, 0]);
        assert_eq!(newer, Err(DecodeError::Version { found: 2, newest: 1 }));
        assert!(Camera::from_bytes(&[1, 8, 0, 0]).is_err() && Camera::from_bytes(&[1, 0, 2, 0]).is_err());
    }
}
