//! Cameras as calibration tools write them down, or as numbers.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde_norway::Value;
use waypost_bags::{Camera, CameraInfo, Intrinsics, Lens, Undeclared};

/// Describes `--camera` in `--help`.
pub(crate) const FORMATS: &str = "\
A --camera is one of
  a YAML file of ROS    camera_info as camera_calibration writes it, or as `ros2 topic echo` shows it
  a YAML file of Kalibr camchain (cam0 is taken), or EuRoC's sensor.yaml
  KITTI's calib.txt     of rectified images, where all its cameras see alike
  numbers               fx,fy,cx,cy in pixels, then the distortion k1,k2,p1,p2[,k3], if there is any
  fisheye: numbers      fisheye:fx,fy,cx,cy[,k1,k2,k3,k4], equidistant
  fov: degrees          fov:62, its horizontal field of view, where nobody calibrated it
It is taken to be in the middle of the robot, looking ahead.";

/// Begin of the lines of KITTI's calib.txt that are projections of cameras; some files leave it out.
const KITTI_CAMERAS: [&str; 8] =
    ["P0:", "P1:", "P2:", "P3:", "P_rect_00:", "P_rect_01:", "P_rect_02:", "P_rect_03:"];

/// Why no camera was read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CameraFileError {
    #[error("cannot read {}: {source}; name a YAML file, or write fx,fy,cx,cy or fov:DEGREES", path.display())]
    Unreadable { path: PathBuf, source: std::io::Error },
    #[error(
        "{}: its cameras see differently, and it does not say which took these images; give fx,fy,cx,cy of that one: {}",
        path.display(),
        cameras.join(" or ")
    )]
    SeveralCameras { path: PathBuf, cameras: Vec<String> },
    #[error("{} is no YAML: {source}", path.display())]
    NoYaml { path: PathBuf, source: serde_norway::Error },
    #[error(
        "{} describes no camera: it has neither camera_matrix (ROS), nor P0 (KITTI), nor k, width and height (a message of ROS), nor \
         intrinsics and resolution (Kalibr, EuRoC)",
        .0.display()
    )]
    Unknown(PathBuf),
    #[error("{}: {key} has {found} numbers in place of {expected}", path.display())]
    Numbers { path: PathBuf, key: &'static str, found: usize, expected: &'static str },
    #[error("{}: cameras of the model {model} cannot be declared; pinhole can, with radtan or equidistant", path.display())]
    Model { path: PathBuf, model: String },
    #[error("{}: {source}", path.display())]
    Undeclared { path: PathBuf, source: Undeclared },
    #[error(
        "`{0}` are no numbers of a camera; write fx,fy,cx,cy, then k1,k2,p1,p2[,k3] if there is distortion; or \
         fisheye:fx,fy,cx,cy, then k1,k2,k3,k4 if there is distortion"
    )]
    Arguments(String),
    #[error("`fov:{0}` is no horizontal field of view; write degrees from 1 to 170, as fov:62")]
    FieldOfView(String),
    #[error(
        "the middle of the camera's image, ({cx_px}, {cy_px}) pixels, is far from that of the first image, which has {image_width} x \
         {image_height}; give the calibration of these images"
    )]
    Middle { cx_px: f64, cy_px: f64, image_width: u32, image_height: u32 },
    #[error(
        "the camera is for images of {width} x {height} pixels, but the first has {image_width} x {image_height}; \
         give the calibration of these images"
    )]
    Size { width: u32, height: u32, image_width: u32, image_height: u32 },
}

/// The camera that an argument describes, of images of a size.
pub(crate) fn described_camera(argument: &str, size_px: (u32, u32)) -> Result<Camera, CameraFileError> {
    if let Some(numbers) = argument.strip_prefix("fisheye:") {
        return by_numbers(numbers, size_px, Lens::Fisheye, &[0, 4]);
    }
    if let Some(degrees) = argument.strip_prefix("fov:") {
        return by_field_of_view(degrees, size_px);
    }
    let first = argument.split(',').next().unwrap_or_default();
    if argument.contains(',') && first.trim().parse::<f64>().is_ok() {
        return by_numbers(argument, size_px, Lens::Pinhole, &[0, 4, 5]);
    }
    let camera = read(Path::new(argument), size_px)?;
    let ((width, height), (image_width, image_height)) = (camera.size_px, size_px);
    // Images may have been made smaller, but not cut off.
    let [across, down] =
        [u64::from(width) * u64::from(image_height), u64::from(image_width) * u64::from(height)];
    let one_pixel = u64::from(width.max(height));
    if across.abs_diff(down) > one_pixel {
        return Err(CameraFileError::Size { width, height, image_width, image_height });
    }
    Ok(camera)
}

fn by_numbers(
    text: &str,
    size_px: (u32, u32),
    lens: impl Fn(Intrinsics) -> Lens,
    distortions: &[usize],
) -> Result<Camera, CameraFileError> {
    let wrong = || CameraFileError::Arguments(text.to_owned());
    let numbers =
        text.split(',').map(|number| number.trim().parse::<f64>().ok().filter(|value| value.is_finite()));
    let numbers: Vec<f64> = numbers.collect::<Option<_>>().ok_or_else(wrong)?;
    let Some(([fx_px, fy_px, cx_px, cy_px], distortion)) = numbers.split_first_chunk() else {
        return Err(wrong());
    };
    if !distortions.contains(&distortion.len()) || *fx_px <= 0.0 || *fy_px <= 0.0 {
        return Err(wrong());
    }
    check_middle([*cx_px, *cy_px], size_px)?;
    let intrinsics = Intrinsics {
        fx_px: *fx_px,
        fy_px: *fy_px,
        cx_px: *cx_px,
        cy_px: *cy_px,
        distortion: distortion.to_vec(),
    };
    Ok(Camera { lens: lens(intrinsics), size_px, base_to_camera: None })
}

/// Widest fields of view that a camera without a fisheye's lens has, and narrowest ones, in degrees.
const FIELDS_OF_VIEW_DEG: std::ops::RangeInclusive<f64> = 1.0..=170.0;

/// A camera of square pixels that looks through the middle of its images.
fn by_field_of_view(degrees: &str, size_px: (u32, u32)) -> Result<Camera, CameraFileError> {
    let horizontal_deg = degrees.trim().parse().ok().filter(|degrees| FIELDS_OF_VIEW_DEG.contains(degrees));
    let horizontal_deg: f64 =
        horizontal_deg.ok_or_else(|| CameraFileError::FieldOfView(degrees.to_owned()))?;
    let (width, height) = (f64::from(size_px.0), f64::from(size_px.1));
    let focal_px = width / 2.0 / (horizontal_deg / 2.0).to_radians().tan();
    let intrinsics = Intrinsics {
        fx_px: focal_px,
        fy_px: focal_px,
        cx_px: width / 2.0,
        cy_px: height / 2.0,
        distortion: Vec::new(),
    };
    Ok(Camera { lens: Lens::Pinhole(intrinsics), size_px, base_to_camera: None })
}

/// Numbers do not say of which images they are; those of others show by their middle, which is within an eighth of the
/// image of its own.
fn check_middle(
    [cx_px, cy_px]: [f64; 2],
    (image_width, image_height): (u32, u32),
) -> Result<(), CameraFileError> {
    let is_off = |center_px: f64, size_px: u32| {
        let size_px = f64::from(size_px);
        (center_px - size_px / 2.0).abs() > size_px / 8.0
    };
    if is_off(cx_px, image_width) || is_off(cy_px, image_height) {
        return Err(CameraFileError::Middle { cx_px, cy_px, image_width, image_height });
    }
    Ok(())
}

/// `size_px` is that of the images, where a file does not say it.
fn read(path: &Path, size_px: (u32, u32)) -> Result<Camera, CameraFileError> {
    let text = std::fs::read_to_string(path);
    let text = text.map_err(|source| CameraFileError::Unreadable { path: path.to_owned(), source })?;
    if let Some(camera) = of_kitti(path, &text, size_px)? {
        return Ok(camera);
    }
    let no_yaml = |source| CameraFileError::NoYaml { path: path.to_owned(), source };
    // OpenCV writes a first line that YAML does not have, and `ros2 topic echo` more than one document.
    let yaml = text.strip_prefix("%YAML:1.0").unwrap_or(&text);
    let first = serde_norway::Deserializer::from_str(yaml).next();
    let unknown = || CameraFileError::Unknown(path.to_owned());
    let document = first.ok_or_else(unknown)?;
    let document: Value = serde::Deserialize::deserialize(document).map_err(no_yaml)?;
    let info = Sheet { path, yaml: &document }.camera_info()?.ok_or_else(unknown)?;
    let camera =
        info.declared().map_err(|source| CameraFileError::Undeclared { path: path.to_owned(), source })?;
    if let Some(error_px) = info.approximation_px() {
        // If stderr is closed, the note is lost.
        let _ = writeln!(
            std::io::stderr(),
            "{}: its rational_polynomial is declared as the nearest plumb_bob, which is up to {error_px:.2} pixels from it",
            path.display()
        );
    }
    Ok(camera)
}

/// The camera of KITTI's calib.txt, whose lines are 3 x 4 projections of rectified cameras, row by row; `None` if it is
/// none.
fn of_kitti(path: &Path, text: &str, size_px: (u32, u32)) -> Result<Option<Camera>, CameraFileError> {
    let mut cameras: Vec<[f64; 4]> = Vec::new();
    for line in text.lines() {
        let key = KITTI_CAMERAS.into_iter().find(|key| line.starts_with(key));
        let numbers = line[key.map_or(0, str::len)..].split_whitespace();
        let numbers: Vec<f64> = numbers.map_while(|number| number.parse().ok()).collect();
        match (key, &numbers[..]) {
            (_, &[fx, 0.0, cx, _, 0.0, fy, cy, _, 0.0, 0.0, 1.0, _]) => {
                let camera = [fx, fy, cx, cy];
                if !cameras.contains(&camera) {
                    cameras.push(camera);
                }
            }
            (Some(key), numbers) => {
                let (path, found) = (path.to_owned(), numbers.len());
                return Err(CameraFileError::Numbers { path, key, found, expected: "12" });
            }
            (None, _) => {}
        }
    }
    match cameras[..] {
        [] => Ok(None),
        [[fx_px, fy_px, cx_px, cy_px]] if fx_px > 0.0 && fy_px > 0.0 => {
            check_middle([cx_px, cy_px], size_px)?;
            let lens = Lens::Pinhole(Intrinsics { fx_px, fy_px, cx_px, cy_px, distortion: Vec::new() });
            Ok(Some(Camera { lens, size_px, base_to_camera: None }))
        }
        [_] => Err(CameraFileError::Undeclared { path: path.to_owned(), source: Undeclared::Uncalibrated }),
        _ => {
            let told = cameras.iter().map(|camera| camera.map(|number| number.to_string()).join(","));
            Err(CameraFileError::SeveralCameras { path: path.to_owned(), cameras: told.collect() })
        }
    }
}

/// A file, as far as it is read.
struct Sheet<'a> {
    path: &'a Path,
    yaml: &'a Value,
}

impl Sheet<'_> {
    fn camera_info(&self) -> Result<Option<CameraInfo>, CameraFileError> {
        if let Some(matrix) = self.yaml.get("camera_matrix") {
            let distortion = self.yaml.get("distortion_coefficients");
            return self.of_ros(["image_width", "image_height"], matrix, distortion).map(Some);
        }
        if let Some(matrix) = self.yaml.get("k").or_else(|| self.yaml.get("K")) {
            let distortion = self.yaml.get("d").or_else(|| self.yaml.get("D"));
            return self.of_ros(["width", "height"], matrix, distortion).map(Some);
        }
        match self.yaml.get("cam0") {
            Some(camera) => Sheet { path: self.path, yaml: camera }.of_kalibr(),
            None => self.of_kalibr(),
        }
    }

    /// Of the two forms that ROS has.
    fn of_ros(
        &self,
        size: [&'static str; 2],
        matrix: &Value,
        distortion: Option<&Value>,
    ) -> Result<CameraInfo, CameraFileError> {
        let intrinsics = self.fixed("the camera matrix", &numbers(matrix), "9")?;
        let [width, height] = size.map(|key| self.yaml.get(key).and_then(Value::as_u64).unwrap_or_default());
        let model = self.yaml.get("distortion_model").and_then(Value::as_str).unwrap_or("plumb_bob");
        let size_px = (pixels(width), pixels(height));
        Ok(info(size_px, model, distortion.map(numbers).unwrap_or_default(), intrinsics))
    }

    fn of_kalibr(&self) -> Result<Option<CameraInfo>, CameraFileError> {
        let (Some(intrinsics), Some(resolution)) = (self.yaml.get("intrinsics"), self.yaml.get("resolution"))
        else {
            return Ok(None);
        };
        let model = self.yaml.get("camera_model").and_then(Value::as_str).unwrap_or("pinhole");
        if model != "pinhole" {
            return Err(CameraFileError::Model { path: self.path.to_owned(), model: model.to_owned() });
        }
        let [fx, fy, cx, cy] = self.fixed("intrinsics", &numbers(intrinsics), "4")?;
        let [width, height]: [f64; 2] = self.fixed("resolution", &numbers(resolution), "2")?;
        let distortion = ["distortion_coeffs", "distortion_coefficients"];
        let distortion =
            distortion.iter().find_map(|key| self.yaml.get(key)).map(numbers).unwrap_or_default();
        let model = match self.yaml.get("distortion_model").and_then(Value::as_str) {
            Some("radtan" | "radial-tangential") => "plumb_bob",
            Some("none") | None => "",
            Some(other) => other,
        };
        let matrix = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
        let size_px = (pixels(width.max(0.0) as u64), pixels(height.max(0.0) as u64));
        Ok(Some(info(size_px, model, distortion, matrix)))
    }

    fn fixed<const COUNT: usize>(
        &self,
        key: &'static str,
        numbers: &[f64],
        expected: &'static str,
    ) -> Result<[f64; COUNT], CameraFileError> {
        let found = numbers.len();
        let path = || self.path.to_owned();
        numbers.try_into().map_err(|_| CameraFileError::Numbers { path: path(), key, found, expected })
    }
}

fn info(size_px: (u32, u32), model: &str, distortion: Vec<f64>, intrinsics: [f64; 9]) -> CameraInfo {
    CameraInfo {
        frame_id: String::new(),
        size_px,
        distortion_model: model.to_owned(),
        distortion,
        intrinsics,
        projection: [0.0; 12],
        binning: (0, 0),
        region_px: [0; 4],
    }
}

/// The numbers of a list, or of a matrix's `data`.
fn numbers(value: &Value) -> Vec<f64> {
    let value = match value {
        Value::Tagged(tagged) => &tagged.value,
        other => other,
    };
    let list = value.get("data").unwrap_or(value);
    list.as_sequence().into_iter().flatten().filter_map(Value::as_f64).collect()
}

fn pixels(count: u64) -> u32 {
    u32::try_from(count).unwrap_or_default()
}

// Others take this file into a program of theirs.
#[cfg(test)]
#[path = "camera_file/tests.rs"]
mod tests;
