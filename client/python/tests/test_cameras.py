"""Calibration files."""

from __future__ import annotations

from pathlib import Path

import pytest

import waypost

ROS = """\
image_width: 640
image_height: 480
camera_name: head
camera_matrix:
  rows: 3
  cols: 3
  data: [438.78, 0., 305.59, 0., 437.35, 243.33,
    0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.36, 0.09, 0.0004, 1e-04, 0.]
"""
ECHOED = """\
header: {frame_id: camera}
height: 480
width: 640
distortion_model: plumb_bob
d: [0.0, 0.0, 0.0, 0.0, 0.0]
k: [400.0, 0.0, 320.0, 0.0, 401.0, 240.0, 0.0, 0.0, 1.0]
---
height: 1
"""
KALIBR = """\
cam0:
  camera_model: pinhole
  distortion_coeffs: [0.1, 0.2, 0.3, 0.4]
  distortion_model: equidistant
  intrinsics: [461.6, 460.3, 363.2, 248.1]
  resolution: [752, 480]
"""
EUROC = """\
sensor_type: camera
T_BS: {cols: 4, rows: 4, data: [1.0, 0.0]}
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002]
"""
OPENCV = """\
%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 320., 0., 501., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.1, 0.05, 0., 0., 0. ]
"""


def written(folder: Path, text: str) -> Path:
    file = folder / "camera.yaml"
    file.write_text(text)
    return file


@pytest.mark.parametrize(
    ("text", "size", "numbers", "distortion"),
    [
        (ROS, (640, 480), (438.78, 437.35, 305.59, 243.33), (-0.36, 0.09, 0.0004, 1e-4, 0.0)),
        (ECHOED, (640, 480), (400.0, 401.0, 320.0, 240.0), ()),
        (EUROC, (752, 480), (458.654, 457.296, 367.215, 248.375), (-0.28, 0.07, 0.0002, 0.00002)),
        (OPENCV, (640, 480), (500.0, 501.0, 320.0, 240.0), (-0.1, 0.05, 0.0, 0.0, 0.0)),
    ],
)
def test_pinholes_are_read(
    tmp_path: Path,
    text: str,
    size: tuple[int, int],
    numbers: tuple[float, ...],
    distortion: tuple[float, ...],
) -> None:
    camera = waypost.read_camera(written(tmp_path, text))
    lens = camera.pinhole
    assert camera.WhichOneof("model") == "pinhole"
    assert (camera.image_width_px, camera.image_height_px) == size
    assert (lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px) == numbers
    assert tuple(lens.distortion) == distortion


def test_a_fisheye_is_one(tmp_path: Path) -> None:
    camera = waypost.read_camera(written(tmp_path, KALIBR))
    assert camera.WhichOneof("model") == "fisheye"
    assert list(camera.fisheye.distortion) == [0.1, 0.2, 0.3, 0.4]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: 1", "describes no camera"),
        ("- 1", "describes no camera"),
        ("a: [", "is no YAML"),
        (ROS.replace("437.35, ", ""), "camera_matrix has 8 numbers in place of 9"),
        (ROS.replace("438.78", "nan"), "not finite"),
        (ROS.replace("438.78", "wide"), "no list of numbers"),
        (ROS.replace("438.78", "0."), "nobody calibrated"),
        (ROS.replace("image_width: 640\n", ""), "lacks image_width"),
        (ROS.replace("0.09, ", "").replace("1e-04, ", ""), "has 0 or 4 or 5 numbers of distortion, not 3"),
        (ROS.replace("plumb_bob", "thin_prism"), "the model thin_prism cannot be declared"),
        (KALIBR.replace("pinhole", "omni"), "the model omni cannot be declared"),
    ],
)
def test_what_is_no_camera_is_said(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        waypost.read_camera(written(tmp_path, text))


def test_a_server_takes_it(client: waypost.Client, hall: str, tmp_path: Path) -> None:
    camera = waypost.read_camera(written(tmp_path, ROS))
    with client.session(hall, "calibrated", camera=camera):
        record = client.session_record(f"maps/{hall}/sessions/calibrated")
    assert record.camera == camera
