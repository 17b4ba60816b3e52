"""Poses by REP-103: right-handed, x forward, y left, z up; metres and radians."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from waypost.v1 import geometry_pb2

#: How far a matrix may be from a rotation: single precision, and some steps of computing.
_ROTATION_TOLERANCE = 1e-4


@dataclass(frozen=True)
class Pose2:
    """A pose of a robot on the floor."""

    x_m: float
    y_m: float
    #: From the x axis towards the y axis.
    heading_rad: float


@dataclass(frozen=True)
class Pose3:
    """A pose in space."""

    position_m: tuple[float, float, float]
    #: A unit quaternion (x, y, z, w); (0, 0, 0, 1) is no rotation.
    orientation_xyzw: tuple[float, float, float, float]

    @staticmethod
    def from_matrix(matrix: npt.ArrayLike) -> Pose3:
        """The pose of a homogeneous 4 x 4 matrix.

        >>> Pose3.from_matrix([[1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 1, 4], [0, 0, 0, 1]]).position_m
        (2.0, 3.0, 4.0)

        Raises:
            ValueError: If it is not a rotation and a translation.
        """
        pose = np.asarray(matrix, dtype=np.float64)
        if pose.shape != (4, 4):
            raise ValueError(
                f"a pose must be (x, y, heading) or a 4 x 4 matrix, not numbers of shape {pose.shape}"
            )
        rotation = pose[:3, :3]
        is_rotation = (
            bool(np.isfinite(pose).all())
            and np.allclose(rotation @ rotation.T, np.eye(3), atol=_ROTATION_TOLERANCE)
            and np.linalg.det(rotation) > 0
        )
        if not is_rotation or not np.array_equal(pose[3], (0, 0, 0, 1)):
            raise ValueError(
                "the matrix is not a rotation and a translation with (0, 0, 0, 1) as its last row"
            )
        x, y, z = (float(value) for value in pose[:3, 3])
        return Pose3((x, y, z), _quaternion(rotation))


def odometry(
    pose: Pose2 | Pose3 | npt.ArrayLike, covariance: npt.ArrayLike | None = None
) -> geometry_pb2.Odometry:
    """The message of a pose, of (x, y, heading), or of a 4 x 4 matrix.

    Raises:
        ValueError: If it is none of these, or the covariance is not 6 x 6.
    """
    if not isinstance(pose, (Pose2, Pose3)):
        numbers = np.asarray(pose, dtype=np.float64)
        pose = Pose2(*numbers.tolist()) if numbers.shape == (3,) else Pose3.from_matrix(numbers)
    if isinstance(pose, Pose2):
        half = pose.heading_rad / 2
        pose = Pose3((pose.x_m, pose.y_m, 0.0), (0.0, 0.0, math.sin(half), math.cos(half)))
    (px, py, pz), (qx, qy, qz, qw) = pose.position_m, pose.orientation_xyzw
    message = geometry_pb2.Odometry(
        pose=geometry_pb2.Pose(
            position_m=geometry_pb2.Vector3(x=px, y=py, z=pz),
            orientation=geometry_pb2.Quaternion(x=qx, y=qy, z=qz, w=qw),
        )
    )
    if covariance is not None:
        numbers = np.asarray(covariance, dtype=np.float64)
        if numbers.shape != (6, 6):
            raise ValueError(f"a covariance must be 6 x 6, not of shape {numbers.shape}")
        message.covariance.extend(numbers.ravel().tolist())
    return message


def planar(message: geometry_pb2.Pose) -> Pose2:
    """A pose from the wire, seen from above."""
    orientation = message.orientation
    heading = 2 * math.atan2(orientation.z, orientation.w)
    return Pose2(message.position_m.x, message.position_m.y, math.remainder(heading, 2 * math.pi))


def _quaternion(rotation: npt.NDArray[np.float64]) -> tuple[float, float, float, float]:
    """The eigenvector of the largest eigenvalue of Bar-Itzhack's symmetric matrix: no special cases.

    It is the quaternion nearest to a matrix that is a rotation but for rounding.
    """
    ((xx, xy, xz), (yx, yy, yz), (zx, zy, zz)) = rotation.tolist()
    symmetric = np.array(
        [
            [xx - yy - zz, xy + yx, xz + zx, zy - yz],
            [xy + yx, yy - xx - zz, yz + zy, xz - zx],
            [xz + zx, yz + zy, zz - xx - yy, yx - xy],
            [zy - yz, xz - zx, yx - xy, xx + yy + zz],
        ]
    )
    _, vectors = np.linalg.eigh(symmetric / 3)
    x, y, z, w = (float(value) for value in vectors[:, -1])
    return (x, y, z, w) if w >= 0 else (-x, -y, -z, -w)
