"""A robot that drives along the shipped drive, laid out as a straight way: what the example leads."""

from __future__ import annotations

import io
import math
import time

from conftest import IMAGES
from PIL import Image

import waypost

#: From one image of the drive to the next.
STEP_M = 0.5
FIELD_OF_VIEW_RAD = 1.2
#: Longer than a drive takes, even if the robot looks all around once.
DRIVE_S = 240.0


class Robot:
    """Wheels that do as commanded, and a camera that sees the image of the nearest step."""

    def __init__(self, x_m: float = 2 * STEP_M) -> None:
        self.x_m, self.y_m, self.heading_rad = x_m, 0.0, 0.0
        self.driven_m = 0.0
        self._command = (0.0, 0.0)
        self._at_s = time.monotonic()

    def drive(self, forward_m_s: float, turn_rad_s: float) -> None:
        self._move()
        self._command = (forward_m_s, turn_rad_s)

    def odometry(self) -> waypost.Pose2:
        self._move()
        return waypost.Pose2(self.x_m, self.y_m, self.heading_rad)

    def image(self) -> bytes:
        self._move()
        image = IMAGES[min(max(round(self.x_m / STEP_M), 0), len(IMAGES) - 1)].read_bytes()
        return image if abs(self.heading_rad) < 1e-3 else turned(image, self.heading_rad)

    def _move(self) -> None:
        forward_m_s, turn_rad_s = self._command
        passed_s, self._at_s = time.monotonic() - self._at_s, time.monotonic()
        self.heading_rad += turn_rad_s * passed_s
        self.x_m += forward_m_s * passed_s * math.cos(self.heading_rad)
        self.y_m += forward_m_s * passed_s * math.sin(self.heading_rad)
        self.driven_m += abs(forward_m_s) * passed_s


def turned(image: bytes, heading_rad: float) -> bytes:
    """What the camera sees once the robot has turned to the left: the scene moves to the right."""
    seen = Image.open(io.BytesIO(image))
    canvas = Image.new(seen.mode, seen.size)
    canvas.paste(seen, (round(seen.width * math.remainder(heading_rad, math.tau) / FIELD_OF_VIEW_RAD), 0))
    out = io.BytesIO()
    canvas.save(out, "JPEG", quality=90)
    return out.getvalue()


def taught(client: waypost.Client, map_id: str, steps: int = 30) -> None:
    """Makes a map of the first steps of the way."""
    client.create_map(map_id, "shipped")
    with client.session(map_id, "taught") as session:
        frames = (
            waypost.Frame(n + 1, (n + 1) * 10**9, IMAGES[n].read_bytes(), odometry=(n * STEP_M, 0.0, 0.0))
            for n in range(steps)
        )
        for outcome in session.stream(frames):
            assert isinstance(outcome, waypost.Answer)
