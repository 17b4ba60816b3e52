"""Cameras as calibration tools write them down."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

from waypost.v1 import geometry_pb2

#: How a file calls a lens, and how many numbers of its distortion the contract takes.
_PINHOLE = ("plumb_bob", "radtan", "radial-tangential", "none", "")
_FISHEYE = ("equidistant", "fisheye")
_DISTORTIONS = {"pinhole": (0, 4, 5), "fisheye": (0, 4)}


def read_camera(file: str | os.PathLike[str]) -> geometry_pb2.Camera:
    r"""The camera that a calibration file describes, to be declared by `client.session(…, camera=…)`.

    It reads what ROS's `camera_calibration` writes and `ros2 topic echo` shows of a `CameraInfo`, Kalibr's
    camchain (`cam0` is taken), and EuRoC's `sensor.yaml`. Where the camera sits on the robot is none of these
    files' matter: set `base_to_camera`, or it is taken to look ahead from the robot's middle.

    It needs PyYAML: `pip install PyYAML`, or the package with its extra `calibration`.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "camera.yaml")
    ...     _ = file.write_text(
    ...         "image_width: 640\nimage_height: 480\ndistortion_model: plumb_bob\n"
    ...         "camera_matrix: {data: [438.8, 0, 305.6, 0, 437.4, 243.3, 0, 0, 1]}\n"
    ...         "distortion_coefficients: {data: [-0.36, 0.09, 0, 0, 0]}\n"
    ...     )
    ...     read_camera(file).pinhole.fx_px
    438.8

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it describes no camera that can be declared; the message says what is missing.
        ImportError: If PyYAML is not installed.
    """
    path = Path(file)
    text = path.read_text(encoding="utf-8")
    # OpenCV writes a first line that YAML does not have.
    sheet = _first_document(path, text.removeprefix("%YAML:1.0"))
    camera = _of_ros(path, sheet) or _of_kalibr(path, sheet.get("cam0", sheet))
    if camera is None:
        raise ValueError(
            f"{path} describes no camera: it has neither camera_matrix or k, as ROS writes, nor intrinsics "
            "and resolution, as Kalibr does"
        )
    return camera


def _first_document(path: Path, text: str) -> dict[str, Any]:
    try:
        import yaml
    except ImportError as error:
        raise ImportError("calibration files need PyYAML: pip install PyYAML") from error

    def matrix(loader: Any, node: Any) -> Any:
        return loader.construct_mapping(node, deep=True)

    # Which takes OpenCV's matrices for what they are.
    loader: Any = type("Loader", (yaml.SafeLoader,), {})
    for tag in ("!opencv-matrix", "tag:yaml.org,2002:opencv-matrix"):
        loader.add_constructor(tag, matrix)
    try:
        sheet = next(yaml.load_all(text, loader), None)
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is no YAML: {error}") from error
    return sheet if isinstance(sheet, dict) else {}


def _of_ros(path: Path, sheet: dict[str, Any]) -> geometry_pb2.Camera | None:
    """Of `camera_info` as a file, or as a message."""
    for matrix_name, distortion_name, width, height in (
        ("camera_matrix", "distortion_coefficients", "image_width", "image_height"),
        ("k", "d", "width", "height"),
        ("K", "D", "width", "height"),
    ):
        if matrix_name in sheet:
            matrix = _numbers(path, sheet, matrix_name, 9)
            focal_and_centre = [matrix[0], matrix[4], matrix[2], matrix[5]]
            size = [_size(path, sheet, name) for name in (width, height)]
            model = str(sheet.get("distortion_model", "plumb_bob"))
            return _camera(path, model, focal_and_centre, size, _numbers(path, sheet, distortion_name))
    return None


def _of_kalibr(path: Path, sheet: Any) -> geometry_pb2.Camera | None:
    if not isinstance(sheet, dict) or "intrinsics" not in sheet or "resolution" not in sheet:
        return None
    model = str(sheet.get("camera_model", "pinhole"))
    if model != "pinhole":
        raise ValueError(f"{path}: cameras of the model {model} cannot be declared; pinhole can")
    resolution = _numbers(path, sheet, "resolution", 2)
    distortion = next(
        (name for name in ("distortion_coeffs", "distortion_coefficients") if name in sheet), ""
    )
    return _camera(
        path,
        str(sheet.get("distortion_model", "none")),
        _numbers(path, sheet, "intrinsics", 4),
        [int(side) for side in resolution],
        _numbers(path, sheet, distortion),
    )


def _camera(
    path: Path, model: str, focal_and_centre: list[float], size: list[int], distortion: list[float]
) -> geometry_pb2.Camera:
    lens = "pinhole" if model in _PINHOLE else "fisheye" if model in _FISHEYE else None
    if model == "rational_polynomial" and not any(distortion[5:]):
        # Without its denominator it is the other.
        lens, distortion = "pinhole", distortion[:5]
    if lens is None:
        raise ValueError(
            f"{path}: a lens of the model {model} cannot be declared; plumb_bob (radtan) and equidistant "
            "can: calibrate with one of these"
        )
    if not any(distortion):
        distortion = []
    if len(distortion) not in _DISTORTIONS[lens]:
        expected = " or ".join(str(count) for count in _DISTORTIONS[lens])
        raise ValueError(
            f"{path}: a lens of the model {model} has {expected} numbers of distortion, not {len(distortion)}"
        )
    fx_px, fy_px, cx_px, cy_px = focal_and_centre
    if min(fx_px, fy_px) <= 0 or min(size) <= 0:
        raise ValueError(f"{path} is of a camera that nobody calibrated: its focal lengths or its size are 0")
    camera = geometry_pb2.Camera(image_width_px=size[0], image_height_px=size[1])
    seen = camera.pinhole if lens == "pinhole" else camera.fisheye
    seen.fx_px, seen.fy_px, seen.cx_px, seen.cy_px = fx_px, fy_px, cx_px, cy_px
    seen.distortion.extend(distortion)
    return camera


def _size(path: Path, sheet: dict[str, Any], name: str) -> int:
    side = sheet.get(name)
    if not isinstance(side, int):
        raise ValueError(f"{path} lacks {name}, the size of its images in pixels")
    return side


def _numbers(path: Path, sheet: dict[str, Any], name: str, count: int | None = None) -> list[float]:
    """The numbers of a list, or of a matrix's `data`; none where there is no such entry."""
    entry = sheet.get(name, [])
    listed = entry.get("data", []) if isinstance(entry, dict) else entry
    try:
        # YAML 1.1 takes 1e-05 for a word.
        numbers = [float(number) for number in listed or []]
    except (TypeError, ValueError):
        raise ValueError(f"{path}: {name} is no list of numbers") from None
    if count is not None and len(numbers) != count:
        raise ValueError(f"{path}: {name} has {len(numbers)} numbers in place of {count}")
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"{path}: {name} has numbers that are not finite")
    return numbers
