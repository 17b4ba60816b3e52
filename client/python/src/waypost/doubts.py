"""Odometry that seems to be in other units: nothing that a robot does looks like that."""

from __future__ import annotations

import math
import statistics
import warnings
from collections import deque
from typing import TYPE_CHECKING

from waypost.poses import odometry as odometry_message

if TYPE_CHECKING:
    from waypost.frames import Frame

#: Faster than robots and most cars drive: 72 km/h.
_DOUBTFUL_SPEED_M_S = 20.0
#: Faster than robots turn: once around in a second.
_DOUBTFUL_TURN_RAD_S = math.tau
#: Turns as fast as that before anything is said: one alone may be a jump.
_DOUBTFUL_TURNS = 3
#: Headings that are all whole multiples of this were written by people, in degrees.
_ROUND_DEGREES = 15.0
#: Steps whose median speed is judged.
_STEPS = 5


class OdometryWarning(UserWarning):
    """Odometry may be in other units than metres, radians and nanoseconds."""


class OdometryDoubts:
    """Looks at the odometry of a session's frames, and warns once of each unit that seems to be another."""

    def __init__(self) -> None:
        self._before: tuple[int, float, float, float | None] | None = None
        self._speeds_m_s: deque[float] = deque(maxlen=_STEPS)
        self._fast_turns = 0
        self._is_wide = False
        self._all_round = True
        self._said: set[str] = set()

    def look(self, frame: Frame) -> None:
        """Takes in a frame before it is sent."""
        if frame.odometry is None:
            return
        position = odometry_message(frame.odometry, None).pose.position_m
        heading_rad = _plain_heading_rad(frame)
        now = (frame.stamp_ns, position.x, position.y, heading_rad)
        before, self._before = self._before, now
        self._look_along_axes(heading_rad)
        if before is None or frame.stamp_ns <= before[0]:
            return
        seconds = (frame.stamp_ns - before[0]) * 1e-9
        speed_m_s = math.hypot(position.x - before[1], position.y - before[2]) / seconds
        if speed_m_s > 0:
            self._speeds_m_s.append(speed_m_s)
        median_m_s = statistics.median(self._speeds_m_s) if len(self._speeds_m_s) == _STEPS else 0.0
        if median_m_s > _DOUBTFUL_SPEED_M_S:
            self._say(
                "positions",
                f"by its odometry the robot drives {median_m_s:.0f} m/s: are positions in centimetres or "
                "millimetres, and not in metres, or stamps not in nanoseconds?",
            )
        if heading_rad is None or before[3] is None:
            return
        # Radians that go on over a whole turn do not jump back, those that jump back stay within one.
        self._is_wide |= abs(heading_rad) > math.tau
        self._fast_turns += abs(heading_rad - before[3]) / seconds > _DOUBTFUL_TURN_RAD_S
        if self._is_wide and self._fast_turns >= _DOUBTFUL_TURNS:
            self._say(
                "headings",
                "by its odometry the robot turns faster than once around in a second: are headings in "
                "degrees, and not in radians?",
            )

    def _look_along_axes(self, heading_rad: float | None) -> None:
        """A robot that turns by 90 at a time is written down in degrees."""
        if heading_rad is None:
            return
        self._all_round &= heading_rad % _ROUND_DEGREES == 0
        if self._all_round and heading_rad != 0:
            self._say(
                "headings",
                f"the odometry's headings are whole multiples of {_ROUND_DEGREES:g}, as {heading_rad:g} is: "
                "are they in degrees, and not in radians?",
            )

    def _say(self, what: str, message: str) -> None:
        if what not in self._said:
            self._said.add(what)
            warnings.warn(message, OdometryWarning, stacklevel=4)


def _plain_heading_rad(frame: Frame) -> float | None:
    """The heading as it was given; quaternions and matrices have lost whole turns."""
    given = frame.odometry
    heading = getattr(given, "heading_rad", None)
    if heading is None and isinstance(given, (tuple, list)) and len(given) == 3:
        heading = given[2]
    return float(heading) if isinstance(heading, (int, float)) else None
