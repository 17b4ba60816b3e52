"""Maps of Spot's GraphNav as g2o, and how a relaxed one compares with their anchored poses.

    python eval/graphnav.py FOLDER... --json

relaxes each by `waypost-eval posegraph`, which has to be on the PATH. A folder has waypoints.csv and edges.csv. Vertices are
numbered by the waypoints' stamps. GraphNav's edges carry no covariance that is known: odometry is taken as good to 5 cm and
1 degree, all else to 10 cm and 2 degrees.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ODOMETRY = "EDGE_SOURCE_ODOMETRY"
MEASURED = ("x", "y", "z", "qx", "qy", "qz", "qw")
#: What made a closure.
SOURCES = {
    "EDGE_SOURCE_SMALL_LOOP_CLOSURE": "small loops",
    "EDGE_SOURCE_FIDUCIAL_LOOP_CLOSURE": "fiducials",
    "EDGE_SOURCE_USER_REQUEST": "the user",
}

#: Ends by their positions, and the row of edges.csv.
Edge = tuple[int, int, dict[str, str]]


def read(folder: Path) -> tuple[list[dict[str, str]], list[Edge]]:
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


def missed(poses: np.ndarray, edges: list[Edge]) -> np.ndarray:
    """How far, in metres, each edge's end is from where the edge measured it."""
    ends = [rotation(poses[start, 3:]).T @ (poses[end, :3] - poses[start, :3]) for start, end, _ in edges]
    measured = [[float(row[key]) for key in MEASURED[:3]] for _, _, row in edges]
    return np.linalg.norm(np.array(ends) - np.array(measured), axis=1)


def compare(folder: Path, relaxed: Path) -> list[dict[str, object]]:
    """For each kind of closure of a map, how well it is met."""
    waypoints, edges = read(folder)
    anchored = np.array([[float(row[f"seed_{key}"]) for key in MEASURED] for row in waypoints])
    lines = (line.split() for line in relaxed.read_text().splitlines() if line.startswith("VERTEX_SE3"))
    vertices = {int(line[1]): [float(part) for part in line[2:]] for line in lines}
    ours = np.array([vertices[number] for number in range(len(waypoints))])
    apart = laid_over(ours[:, :3], anchored[:, :3])
    whole = {
        "map": folder.name,
        "waypoints": len(waypoints),
        "from_anchored_rmse_m": np.sqrt((apart**2).mean()),
        "from_anchored_most_m": apart.max(),
        "odometry_missed_m": mean_and_most(missed(ours, of_source(edges, ODOMETRY))),
    }
    return [
        whole
        | {
            "closures_by": SOURCES[source],
            "closures": len(of_source(edges, source)),
            "missed_by_anchored_m": mean_and_most(missed(anchored, of_source(edges, source))),
            "missed_m": mean_and_most(missed(ours, of_source(edges, source))),
        }
        for source in sorted({row["source"] for _, _, row in edges} - {ODOMETRY})
    ]


def of_source(edges: list[Edge], source: str) -> list[Edge]:
    return [edge for edge in edges if edge[2]["source"] == source]


def mean_and_most(metres: np.ndarray) -> list[float]:
    return [metres.mean(), metres.max()]


def measure(folder: Path, work: Path) -> list[dict[str, object]]:
    """Relaxes a map, and compares."""
    graph, relaxed = work / f"{folder.name}.g2o", work / f"{folder.name}-relaxed.g2o"
    to_g2o(folder, graph)
    relax = ["waypost-eval", "posegraph", str(graph), "--out", str(relaxed)]
    subprocess.run(relax, check=True, stdout=sys.stderr)
    return compare(folder, relaxed)


if __name__ == "__main__":
    folders = [Path(word) for word in sys.argv[1:] if word != "--json"]
    with tempfile.TemporaryDirectory() as work:
        print(json.dumps({"closures": [row for folder in folders for row in measure(folder, Path(work))]}))
