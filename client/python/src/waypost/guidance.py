"""What the server tells a robot that it leads."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import NamedTuple, Union

from waypost import errors
from waypost.answers import Refusal
from waypost.poses import Pose2, planar
from waypost.v1 import navigation_pb2


class Command(NamedTuple):
    """What to drive. `Command()` is to stop."""

    #: Below 0 the robot backs up.
    forward_m_s: float = 0.0
    #: To the left.
    turn_rad_s: float = 0.0


class NavigationStatus(enum.IntEnum):
    """The state of a navigation."""

    #: There is no goal: the robot stands still.
    IDLE = navigation_pb2.NAVIGATION_STATUS_IDLE
    #: It is on its way.
    FOLLOWING = navigation_pb2.NAVIGATION_STATUS_FOLLOWING
    #: On its way, though nothing was recognised for a while.
    SEARCHING = navigation_pb2.NAVIGATION_STATUS_SEARCHING
    #: Its pose is not known: it looks around.
    LOST = navigation_pb2.NAVIGATION_STATUS_LOST
    #: It has reached its goal.
    ARRIVED = navigation_pb2.NAVIGATION_STATUS_ARRIVED
    #: It does not move as commanded, its reflex drives, or no way leads to its goal.
    BLOCKED = navigation_pb2.NAVIGATION_STATUS_BLOCKED


@dataclass(frozen=True)
class Localization:
    """Where a robot is on the map."""

    #: The place that was recognised last.
    place_number: int
    #: The part of the map whose frame the pose is in.
    part: int
    pose: Pose2
    #: Standard deviation of the position in the direction in which it is largest.
    position_sigma_m: float
    #: Standard deviation of the heading.
    heading_sigma_rad: float
    #: From 0 to 1; at 0 the robot is considered lost.
    confidence: float
    #: Time since a place was recognised, by the robot's clock.
    since_recognition_s: float
    #: Way driven since a place was recognised.
    since_recognition_m: float


@dataclass(frozen=True)
class Guidance:
    """A command with the state of the navigation. To drive by, ask `Navigation.command`, which lapses."""

    #: Stamp of the report or panorama that this answers.
    stamp_ns: int
    command: Command
    #: How long the command is valid, from its arrival.
    valid_s: float
    status: NavigationStatus
    #: None while the robot's pose is not known.
    localization: Localization | None
    #: Length of the remaining route; None without a route.
    remaining_m: float | None
    #: Heading that the robot should take, in the map's frame.
    target_heading_rad: float | None
    #: As the contract has it, on a map that is navigated by appearance.
    appearance: navigation_pb2.AppearanceGuidance | None
    #: The reason for the status and how to mend it, where there is something to say.
    detail: str


@dataclass(frozen=True)
class FrameSeen:
    """What a frame showed."""

    sequence: int
    #: `navigation_pb2.FrameSeen.OUTCOME_…` without its beginning, as in "CORRECTED".
    outcome: str
    #: The place that was recognised, if there was one.
    place_number: int | None
    #: Probability of that place.
    probability: float | None


@dataclass(frozen=True)
class WheelsRefused:
    """A report that was not taken. Nothing has changed, and no command follows."""

    stamp_ns: int
    error: errors.ServerError


@dataclass(frozen=True)
class GoalRefused:
    """A goal that was not taken."""

    #: None if it was an image.
    goal: navigation_pb2.Goal | None
    error: errors.ServerError


@dataclass(frozen=True)
class Disconnected:
    """The connection broke; it is being mended. Commands lapse meanwhile."""

    reason: str


@dataclass(frozen=True)
class Reconnected:
    """The connection is back."""

    #: Whether the navigation goes on where it was: not if the server was restarted.
    resumed: bool


#: What the server says besides guidance. A `Refusal` is of a frame.
NavigationEvent = Union[FrameSeen, Refusal, WheelsRefused, GoalRefused, Disconnected, Reconnected]


def guidance(message: navigation_pb2.Guidance) -> Guidance:
    """Guidance from the wire."""
    command = message.command
    return Guidance(
        stamp_ns=message.stamp_ns,
        command=Command(command.forward_m_s, command.turn_rad_s),
        valid_s=command.valid_ns / 1e9,
        status=_status(message.status),
        localization=_localization(message.localization) if message.HasField("localization") else None,
        remaining_m=message.remaining_m if message.HasField("remaining_m") else None,
        target_heading_rad=message.target_heading_rad if message.HasField("target_heading_rad") else None,
        appearance=message.appearance if message.HasField("appearance") else None,
        detail=message.detail,
    )


def frame_seen(message: navigation_pb2.FrameSeen) -> FrameSeen:
    """What a frame showed, from the wire."""
    outcome = navigation_pb2.FrameSeen.Outcome.Name(message.outcome)
    return FrameSeen(
        sequence=message.sequence,
        outcome=outcome[len("OUTCOME_") :],
        place_number=message.place_number if message.HasField("place_number") else None,
        probability=message.probability if message.HasField("probability") else None,
    )


def wheels_refused(message: navigation_pb2.WheelRefusal) -> WheelsRefused:
    """A refused report, from the wire."""
    return WheelsRefused(message.stamp_ns, errors.from_status(message.status))


def goal_refused(message: navigation_pb2.GoalRefusal) -> GoalRefused:
    """A refused goal, from the wire."""
    goal = message.goal if message.HasField("goal") else None
    return GoalRefused(goal, errors.from_status(message.status))


def _localization(message: navigation_pb2.Localization) -> Localization:
    return Localization(
        place_number=message.place_number,
        part=message.part,
        pose=planar(message.pose),
        position_sigma_m=message.position_sigma_m,
        heading_sigma_rad=message.heading_sigma_rad,
        confidence=message.confidence,
        since_recognition_s=message.since_recognition_ns / 1e9,
        since_recognition_m=message.since_recognition_m,
    )


def _status(status: int) -> NavigationStatus:
    try:
        return NavigationStatus(status)
    except ValueError:
        raise errors.ProtocolError(
            f"the server gave the navigation status {status}, which this client does not know; "
            "use a client of the server's version"
        ) from None
