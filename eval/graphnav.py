"""Maps of Spot's GraphNav as g2o, and how a relaxed one compares with their anchored poses.

    python eval/graphnav.py to-g2o FOLDER OUT.g2o
    python eval/graphnav.py compare FOLDER RELAXED.g2o

FOLDER has waypoints.csv and edges.csv. Vertices are numbered by the waypoints' stamps. GraphNav's edges carry
no covariance that is known: odometry is taken as good to 5 cm and 1 degree, all else to 10 cm and 2 degrees.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

ODOMETRY = "EDGE_SOURCE_ODOMETRY"
MEASURED = ("x", "y", "z", "qx", "qy", "qz", "qw")


def read(folder: Path) -> tuple[list[dict[str, str]], list[tuple[int, int, dict[str, str]]]]:
    """Waypoints by their stamps, and edges by the positions of their ends."""
    with (folder / "waypoints.csv").open() as file:
        waypoints = sorted(csv.DictReader(file), key=lambda row: int(row["stamp_ns"]))
    number = {row["index"]: position for position, row in enumerate(waypoints)}
    with (folder / "edges.csv").open() as file:
        return waypoints, [(number[row["from"]], number[row["to"]], row) for row in csv.DictReader(file)]


def information(source: str) -> str:
    """The upper triangle, of x, y, z and the vector of the quaternion, which is half an angle."""
    sigma_m, sigma_deg = (0.05, 1.0) if source == ODOMETRY else (0.1, 2.0)
    diagonal = [sigma_m**-2] * 3 + [4 * np.radians(sigma_deg) ** -2] * 3
    return " ".join(
        f"{diagonal[row] if row == column else 0}" for row in range(6) for column in range(row, 6)
    )


def to_g2o(folder: Path, out: Path) -> None:
    edges = (
        f"EDGE_SE3:QUAT {start} {end} {' '.join(row[key] for key in MEASURED)} {information(row['source'])}\n"
        for start, end, row in read(folder)[1]
    )
    out.write_text("".join(edges))


def rotation(quaternion: np.ndarray) -> np.ndarray:
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def laid_over(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """How far each position is from its counterpart, after the best rigid motion (Kabsch, 1976)."""
    ours, theirs = ours - ours.mean(0), theirs - theirs.mean(0)
    left, _, right = np.linalg.svd(theirs.T @ ours)
    turn = left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right
    return np.linalg.norm(ours @ turn.T - theirs, axis=1)


def missed(poses: np.ndarray, edges: list[tuple[int, int, dict[str, str]]]) -> np.ndarray:
    """How far, in metres, each edge's end is from where the edge measured it."""
    ends = [rotation(poses[start, 3:]).T @ (poses[end, :3] - poses[start, :3]) for start, end, _ in edges]
    measured = [[float(row[key]) for key in MEASURED[:3]] for _, _, row in edges]
    return np.linalg.norm(np.array(ends) - np.array(measured), axis=1)


def compare(folder: Path, relaxed: Path) -> None:
    waypoints, edges = read(folder)
    anchored = np.array([[float(row[f"seed_{key}"]) for key in MEASURED] for row in waypoints])
    lines = (line.split() for line in relaxed.read_text().splitlines() if line.startswith("VERTEX_SE3"))
    vertices = {int(line[1]): [float(part) for part in line[2:]] for line in lines}
    ours = np.array([vertices[number] for number in range(len(waypoints))])
    apart = laid_over(ours[:, :3], anchored[:, :3])
    print(
        f"{folder.name}: {len(waypoints)} waypoints, {np.sqrt((apart**2).mean()):.3f} m apart (RMSE), "
        f"{apart.max():.3f} m at most"
    )
    for source in sorted({row["source"] for _, _, row in edges}):
        kept = [edge for edge in edges if edge[2]["source"] == source]
        by_them, by_us = missed(anchored, kept), missed(ours, kept)
        print(
            f"  {source} {len(kept)}: missed by anchored {by_them.mean():.3f} (max {by_them.max():.3f}) m, "
            f"by ours {by_us.mean():.3f} (max {by_us.max():.3f}) m"
        )


if __name__ == "__main__":
    {"to-g2o": to_g2o, "compare": compare}[sys.argv[1]](Path(sys.argv[2]), Path(sys.argv[3]))
