"""Where robots go."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Union

from waypost.frames import MAX_IMAGE_BYTES
from waypost.photos import fitting_file
from waypost.poses import Pose2
from waypost.v1 import navigation_pb2

#: A place by its number, a label, a position (x, y) or pose (x, y, heading) in metres and radians, a panorama
#: as JPEG or PNG, or the contract's own message, which can also name the part of the map.
GoalLike = Union[int, str, Sequence[float], Pose2, bytes, navigation_pb2.Goal]


def goal_message(goal: GoalLike) -> navigation_pb2.Goal:
    """A goal as the contract has it.

    >>> goal_message("dock").label, goal_message(7).place_number, goal_message((1, 2)).position.y_m
    ('dock', 7, 2.0)

    Raises:
        ValueError: If it can be none.
    """
    if isinstance(goal, navigation_pb2.Goal):
        return goal
    if isinstance(goal, bool):
        raise ValueError("a goal is a place's number, a label, a position or a panorama, not True or False")
    if isinstance(goal, int):
        if not 0 <= goal < 1 << 32:
            raise ValueError(f"the number of a place is from 0 to 2^32 - 1, not {goal}")
        return navigation_pb2.Goal(place_number=goal)
    if isinstance(goal, str):
        return navigation_pb2.Goal(label=goal)
    if isinstance(goal, bytes):
        image = fitting_file(goal, MAX_IMAGE_BYTES)
        if len(image) > MAX_IMAGE_BYTES:
            raise ValueError(f"the goal's image has {len(image)} bytes, more than {MAX_IMAGE_BYTES}")
        return navigation_pb2.Goal(image=image)
    numbers = (goal.x_m, goal.y_m, goal.heading_rad) if isinstance(goal, Pose2) else tuple(goal)
    if len(numbers) not in (2, 3):
        raise ValueError(f"a position is (x, y) or (x, y, heading), not {len(numbers)} numbers")
    x_m, y_m, *heading = (float(number) for number in numbers)
    position = navigation_pb2.PositionGoal(x_m=x_m, y_m=y_m, heading_rad=heading[0] if heading else None)
    return navigation_pb2.Goal(position=position)
