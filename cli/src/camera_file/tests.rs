use super::*;

fn of_file(yaml: &str, size_px: (u32, u32)) -> Result<Camera, CameraFileError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera.yaml");
    std::fs::write(&path, yaml).unwrap();
    described_camera(path.to_str().unwrap(), size_px)
}

fn pinhole(camera: Camera) -> Intrinsics {
    match camera.lens {
        Lens::Pinhole(intrinsics) => intrinsics,
        Lens::Fisheye(intrinsics) => panic!("{intrinsics:?}"),
    }
}

const ROS: &str = "image_width: 640\nimage_height: 480\ncamera_name: head\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
    data: [438.78, 0., 305.59, 0., 437.35, 243.33,\n    0., 0., 1.]\ndistortion_model: plumb_bob\n\
    distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.36, 0.09, 0.0004, 0.0001, 0.]\n";

#[test]
fn calibrations_of_ros_are_read() {
    let camera = of_file(ROS, (320, 240)).unwrap();
    assert_eq!(camera.size_px, (640, 480));
    let lens = pinhole(camera);
    assert_eq!([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px], [438.78, 437.35, 305.59, 243.33]);
    assert_eq!(lens.distortion, [-0.36, 0.09, 0.0004, 0.0001, 0.0]);
    let echoed = "height: 480\nwidth: 640\ndistortion_model: plumb_bob\nd:\n- 0.1\n- 0.2\n- 0.0\n- 0.0\n- 0.0\n\
                  k: [400.0, 0.0, 320.0, 0.0, 401.0, 240.0, 0.0, 0.0, 1.0]\n---\n";
    assert_eq!(pinhole(of_file(echoed, (640, 480)).unwrap()).distortion.len(), 5);
}

#[test]
fn calibrations_of_kalibr_and_euroc_are_read() {
    let kalibr = "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [0.1, 0.2, 0.3, 0.4]\n  \
                  distortion_model: equidistant\n  intrinsics: [461.6, 460.3, 363.2, 248.1]\n  resolution: [752, 480]\n";
    let camera = of_file(kalibr, (752, 480)).unwrap();
    assert!(matches!(&camera.lens, Lens::Fisheye(lens) if lens.fy_px == 460.3), "{camera:?}");
    let euroc = "#Default\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1.0, 0.0]\nresolution: [752, 480]\n\
                 camera_model: pinhole\nintrinsics: [458.654, 457.296, 367.215, 248.375] #fu\n\
                 distortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002]\n";
    assert_eq!(pinhole(of_file(euroc, (752, 480)).unwrap()).distortion.len(), 4);
}

#[test]
fn calibrations_of_kitti_are_read() {
    let p0 = "P0: 718.856 0 607.1928 0 0 718.856 185.2157 0 0 0 1 0\n";
    let p1 = "P1: 718.856 0 607.1928 -386.1448 0 718.856 185.2157 0 0 0 1 0\n";
    let tr = "Tr: 0 -1 0 0.1 0 0 -1 0 1 0 0 0\n";
    let size = (1241, 376);
    for text in [format!("{p0}{p1}{tr}"), format!("{}{}", &p0[4..], &p1[4..])] {
        let camera = of_file(&text, size).unwrap();
        assert_eq!(camera.size_px, size);
        let lens = pinhole(camera);
        let numbers = [lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px];
        assert_eq!(numbers, [718.856, 718.856, 607.1928, 185.2157]);
    }
    let other = p1.replace("718.856", "700").replace("P1:", "P_rect_01:");
    let error = of_file(&format!("{p0}{other}"), size).unwrap_err().to_string();
    assert!(error.contains("718.856,718.856,607.1928,185.2157 or 700,700,"), "{error}");
    let of_others = of_file(p0, (640, 360)).unwrap_err().to_string();
    assert!(of_others.contains("(607.1928, 185.2157) pixels, is far from"), "{of_others}");
    let error = of_file("P0: 718.856 0 x\n", size).unwrap_err().to_string();
    assert!(error.contains("P0: has 2 numbers in place of 12"), "{error}");
    let error = of_file(&p0.replace("718.856", "0"), size).unwrap_err().to_string();
    assert!(error.contains("not calibrated"), "{error}");
}

#[test]
fn numbers_are_a_camera() {
    let lens = pinhole(described_camera("500, 501,320,240,0.1,0,0,0", (640, 480)).unwrap());
    assert_eq!((lens.fy_px, lens.distortion.len()), (501.0, 4));
    let fisheye = described_camera("fisheye:300,300,320,240", (640, 480)).unwrap();
    assert!(matches!(fisheye.lens, Lens::Fisheye(_)));
    for wrong in ["500,501,320", "500,501,320,240,1", "0,501,320,240", "fisheye:1,2,3,x", "500,501,320,nan"] {
        let error = described_camera(wrong, (640, 480)).unwrap_err();
        assert!(matches!(error, CameraFileError::Arguments(_)), "{wrong}: {error}");
    }
}

#[test]
fn a_field_of_view_is_a_camera() {
    let camera = described_camera("fov:90", (640, 480)).unwrap();
    assert_eq!(camera.size_px, (640, 480));
    let lens = pinhole(camera);
    assert!((lens.fx_px - 320.0).abs() < 1e-9 && lens.fy_px == lens.fx_px, "{lens:?}");
    assert_eq!((lens.cx_px, lens.cy_px), (320.0, 240.0));
    for wrong in ["fov:", "fov:0", "fov:180", "fov:1.2rad", "fov:nan"] {
        let error = described_camera(wrong, (640, 480)).unwrap_err();
        assert!(matches!(error, CameraFileError::FieldOfView(_)), "{wrong}: {error}");
    }
}

#[test]
fn what_describes_no_camera_is_said() {
    let size = (640, 480);
    for (yaml, fragment) in [
        ("a: 1\n", "describes no camera"),
        ("", "describes no camera"),
        ("a: [1\n", "is no YAML"),
        ("camera_matrix: {data: [1, 2]}\n", "the camera matrix has 2 numbers in place of 9"),
        ("cam0: {camera_model: omni, intrinsics: [1], resolution: [1, 1]}\n", "the model omni"),
        (&ROS.replace("438.78", "0"), "not calibrated"),
        (&ROS.replace("plumb_bob", "thin_prism"), "thin_prism"),
    ] {
        let error = of_file(yaml, size).unwrap_err().to_string();
        assert!(error.contains(fragment), "{yaml}: {error}");
    }
    let other = of_file(ROS, (1280, 720)).unwrap_err();
    assert!(matches!(other, CameraFileError::Size { width: 640, image_width: 1280, .. }), "{other}");
    let nowhere = described_camera("nowhere.yaml", size).unwrap_err().to_string();
    assert!(nowhere.contains("cannot read nowhere.yaml"), "{nowhere}");
}
