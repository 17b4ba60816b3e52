"""A database of RTAB-Map, by its published schema of 0.21, of a drive as a folder: what the guide imports."""

from __future__ import annotations

import math
import sqlite3
import struct
import zlib
from pathlib import Path

#: The columns that matter; every other one is empty.
TABLES = """
CREATE TABLE Node(id INTEGER NOT NULL, map_id INTEGER NOT NULL, weight INTEGER, stamp FLOAT, pose BLOB,
  ground_truth_pose BLOB, velocity BLOB, label TEXT, gps BLOB, env_sensors BLOB, time_enter DATE,
  PRIMARY KEY (id));
CREATE TABLE Data(id INTEGER NOT NULL, image BLOB, depth BLOB, calibration BLOB, scan BLOB, scan_info BLOB,
  ground_cells BLOB, obstacle_cells BLOB, empty_cells BLOB, user_data BLOB, time_enter DATE,
  PRIMARY KEY (id));
CREATE TABLE Link(from_id INTEGER NOT NULL, to_id INTEGER NOT NULL, type INTEGER NOT NULL,
  information_matrix BLOB NOT NULL, transform BLOB, user_data BLOB);
CREATE TABLE Word(id INTEGER NOT NULL, descriptor_size INTEGER NOT NULL, descriptor BLOB NOT NULL);
CREATE TABLE Info(STM_size INTEGER, parameters TEXT);
CREATE TABLE Admin(version TEXT, opt_ids BLOB, opt_poses BLOB);
"""
#: Of camera.yaml: fx, fy, cx, cy and the images' size.
CAMERA = (251.15, 251.15, 160.0, 120.0)
SIZE_PX = (320, 240)
#: A camera that looks ahead, in its optical frame.
LOOKS_AHEAD = (0, 0, 1, 0, -1, 0, 0, 0, 0, -1, 0, 0)
#: Nodes that are so near by odometry, and so many nodes apart, are linked as loop closures.
NEAR_M = 0.5
APART = 30


def rtabmap(drive: Path, path: Path) -> None:
    """Writes `drive`, which has images and odometry.tum, as a database at `path`."""
    rows = [
        [float(part) for part in line.split()] for line in (drive / "odometry.tum").read_text().splitlines()
    ]
    database = sqlite3.connect(path)
    database.executescript(TABLES)
    for node, (stamp_s, x, y, _, _, _, qz, qw) in enumerate(rows, 1):
        image = (drive / "images" / f"{node:06}.jpg").read_bytes()
        pose = on_the_floor(x, y, 2 * math.atan2(qz, qw))
        database.execute(
            "INSERT INTO Node(id, map_id, stamp, pose) VALUES (?, 0, ?, ?)", (node, 1000 + stamp_s, pose)
        )
        database.execute(
            "INSERT INTO Data(id, image, calibration) VALUES (?, ?, ?)", (node, image, calibration())
        )
        for earlier, row in enumerate(rows[: max(0, node - 1 - APART)], 1):
            if math.hypot(row[1] - x, row[2] - y) < NEAR_M:
                database.execute("INSERT INTO Link VALUES (?, ?, 1, x'00', NULL, NULL)", (node, earlier))
    ids = struct.pack(f"<{len(rows)}i", *range(1, len(rows) + 1))
    poses = b"".join(on_the_floor(x, y, 2 * math.atan2(qz, qw)) for _, x, y, _, _, _, qz, qw in rows)
    database.execute(
        "INSERT INTO Admin VALUES ('0.21.4', ?, ?)",
        (packed(ids, len(rows), 4), packed(poses, 12 * len(rows), 5)),
    )
    database.commit()
    database.close()


def on_the_floor(x_m: float, y_m: float, heading_rad: float) -> bytes:
    """A pose as the upper three rows of its matrix."""
    sine, cosine = math.sin(heading_rad), math.cos(heading_rad)
    return struct.pack("<12f", cosine, -sine, 0, x_m, sine, cosine, 0, y_m, 0, 0, 1, 0)


def calibration() -> bytes:
    """A camera without distortion, with the head that RTAB-Map writes since 0.18."""
    fx, fy, cx, cy = CAMERA
    head = struct.pack("<11i", 0, 21, 4, 0, *SIZE_PX, 9, 0, 0, 0, 12)
    return head + struct.pack("<9d", fx, 0, cx, 0, fy, cy, 0, 0, 1) + struct.pack("<12f", *LOOKS_AHEAD)


def packed(data: bytes, columns: int, kind: int) -> bytes:
    """A matrix as RTAB-Map compresses it: zlib, then rows, columns and OpenCV's type."""
    return zlib.compress(data) + struct.pack("<3i", 1, columns, kind)
