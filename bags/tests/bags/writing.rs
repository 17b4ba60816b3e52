//! Writers of small bags: the three kinds of files, and the two ways of writing messages.

use std::path::{Path, PathBuf};

use tempfile::TempDir;

pub mod mcap_file;
pub mod messages;
pub mod ros1_file;
pub mod rtabmap_file;
pub mod sqlite_file;

/// A message to write.
#[derive(Clone)]
pub struct Message {
    pub topic: &'static str,
    /// As ROS 1 names it.
    pub type_name: &'static str,
    pub log_ns: u64,
    pub fields: messages::Fields,
}

impl Message {
    /// `sensor_msgs/msg/Image` for `sensor_msgs/Image`.
    pub fn ros2_type(&self) -> String {
        self.type_name.replacen('/', "/msg/", 1)
    }
}

/// A folder that goes when the test ends.
pub struct Folder(TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

/// A small PNG whose pixels depend on a number.
pub fn png(number: u8) -> Vec<u8> {
    let pixels = image::RgbImage::from_fn(8, 6, |x, y| image::Rgb([number, x as u8, y as u8]));
    let mut file = std::io::Cursor::new(Vec::new());
    pixels.write_to(&mut file, image::ImageFormat::Png).unwrap();
    file.into_inner()
}

/// A drive: four images at 10 Hz, odometry at 20 Hz that lags behind, a camera and where it is.
pub fn drive() -> Vec<Message> {
    use messages::{camera_info, compressed_image, odometry, transforms};
    let at = |tick: u64| 1_000_000_000 + tick * 50_000_000;
    let mut drive = vec![
        Message {
            topic: "/tf_static",
            type_name: "tf2_msgs/TFMessage",
            log_ns: at(0),
            fields: transforms(&[
                ("base_link", "camera", [0.2, 0.0, 0.3], [0.0, 0.0, 0.0, 1.0]),
                ("camera", "camera_optical", [0.0; 3], [-0.5, 0.5, -0.5, 0.5]),
            ]),
        },
        Message {
            topic: "/camera/camera_info",
            type_name: "sensor_msgs/CameraInfo",
            log_ns: at(0),
            fields: camera_info(at(0), (8, 6), "plumb_bob", &[0.1, 0.0, 0.0, 0.0, 0.0]),
        },
    ];
    for tick in 0..8 {
        if tick % 2 == 0 {
            drive.push(Message {
                topic: "/camera/image/compressed",
                type_name: "sensor_msgs/CompressedImage",
                log_ns: at(tick) + 1,
                fields: compressed_image(at(tick), "png", &png(tick as u8)),
            });
        }
        drive.push(Message {
            topic: "/odom",
            type_name: "nav_msgs/Odometry",
            log_ns: at(tick) + 2,
            // Half a tick before the images.
            fields: odometry(at(tick) - 25_000_000, "base_link", tick as f64),
        });
    }
    drive
}
