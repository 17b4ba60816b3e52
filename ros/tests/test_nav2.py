"""Goals by name are handed to Nav2, which drives; the bridge tells what becomes of them."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import ros_types as ros
from conftest import Bridge, Diagnostics, Stage, met
from nav2 import ABORTED, SUCCEEDED, Nav2
from robot import DEFAULT, Robot, until
from test_bad_input import refused
from test_driving import FLAGS, STEP_M, Wheels, declare, taught

#: Places of the taught way.
DOCK, DESK = 4, 8


@pytest.fixture
def handed(stage: Stage) -> Iterator[tuple[Wheels, Diagnostics, Bridge]]:
    """A robot on a way that it was taught, whose bridge hands goals to Nav2."""
    robot = stage.robot()
    told = Diagnostics(robot)
    taught(stage, robot, told)
    stage.client.set_label("hall", DESK, "desk")
    bridge = stage.bridge(*FLAGS, "--localize", "--nav2")
    wheels = Wheels(robot)
    declare(robot)
    wheels.start()
    robot.advertise("waypost/goal", ros.String, DEFAULT)
    met(robot, "waypost/goal")
    try:
        until(lambda: told.message("map to odom").startswith("in part"), what=f"{told()} {bridge.said()}")
        yield wheels, told, bridge
    finally:
        wheels.close()


def go_to(robot: Robot, name: str) -> None:
    robot.publish("waypost/goal", ros.String(name))


def begun(robot: Robot, nav2: Nav2, name: str) -> bytes:
    """Nav2 has taken a goal, and whoever sent it waits for its result."""
    before = len(nav2.goals)
    go_to(robot, name)
    until(lambda: len(nav2.turn().goals) > before, what=f"no goal {name} came")
    until(lambda: nav2.latest in nav2.turn().waiting, what="nobody asks what becomes of it")
    return nav2.latest


def test_goals_by_name_are_driven_by_nav2(stage: Stage, handed: tuple[Wheels, Diagnostics, Bridge]) -> None:
    wheels, told, bridge = handed
    robot = wheels.robot
    nav2 = Nav2(robot)
    goal = begun(robot, nav2, "desk")
    sent = nav2.goals[0]
    [place] = [place for place in stage.client.places("hall") if place.name.endswith(f"/places/{DESK}")]
    assert (sent.pose.header.frame_id, sent.pose.header.stamp, sent.behavior_tree) == ("map", ros.Time(), "")
    at = place.pose.pose.position_m
    assert (sent.pose.pose.position.x, sent.pose.pose.position.y) == (at.x, at.y)
    assert at.x > DESK * STEP_M
    until(lambda: told.value("navigation", "status") == "following")
    nav2.drive(goal, 3.25)
    until(lambda: told.value("navigation", "remaining m") == "3.25", what=f"{told()}")
    # Of somebody else's goal.
    nav2.drive(bytes(16), 99.0)
    time.sleep(1.5)
    assert told.value("navigation", "remaining m") == "3.25"
    nav2.end(goal, SUCCEEDED)
    until(lambda: told.value("navigation", "status") == "arrived")

    goal = begun(robot, nav2, str(DOCK))
    go_to(robot, "")
    until(lambda: nav2.turn().cancelled == [goal], what="it is not cancelled")
    until(lambda: told.value("navigation", "status") == "idle")

    first = begun(robot, nav2, "desk")
    second = begun(robot, nav2, "dock")
    assert first != second
    # Nav2 gives up the one before; that says nothing of the one now.
    nav2.end(first, ABORTED, 0, "preempted")
    nav2.drive(second, 1.5)
    until(lambda: told.value("navigation", "remaining m") == "1.50")
    nav2.end(second, ABORTED, 9002, "no transform")
    until(lambda: told.message("navigation") == "Nav2 gave up with code 9002: no transform", what=f"{told()}")
    assert told.level("navigation") == 1

    goal = begun(robot, nav2, "desk")
    # Whoever ends the bridge wants nobody to drive on.
    bridge.process.send_signal(signal.SIGTERM)
    until(lambda: goal in nav2.turn().cancelled, what="the last goal is not cancelled")
    assert bridge.process.wait(20) == 0
    # The wheels are Nav2's.
    assert wheels.commands == []


def test_what_nav2_does_not_take_is_told(handed: tuple[Wheels, Diagnostics, Bridge]) -> None:
    wheels, told, _ = handed
    robot = wheels.robot
    go_to(robot, "cellar")
    until(lambda: "has no place that is called `cellar`" in told.message("navigation"), what=f"{told()}")
    go_to(robot, "desk")
    expected = "nobody serves /navigate_to_pose/_action/send_goal; start it, in this domain and namespace"
    until(lambda: told.message("navigation") == expected, what=f"{told()}")
    assert told.level("navigation") == 2
    nav2 = Nav2(robot, accepts=False)
    go_to(robot, "desk")
    until(lambda: nav2.turn() and "Nav2 refuses the goal" in told.message("navigation"), what=f"{told()}")
    nav2.accepts = True
    begun(robot, nav2, "desk")
    until(lambda: told.value("navigation", "status") == "following")
    assert told.level("navigation") == 0
    nav2.leave()
    until(lambda: "Nav2 has gone while it drove" in told.message("navigation"), what=f"{told()}")


def test_only_one_drives(tmp_path: Path) -> None:
    code, said = refused(tmp_path, "--map", "hall", "--localize", "--drive", "--nav2")
    assert code == 2
    assert "cannot be used with" in said
    parameters = tmp_path / "robot.toml"
    parameters.write_text('map = "hall"\nlocalize = true\nnav2 = true\n')
    code, said = refused(tmp_path, "--params", str(parameters), "--drive")
    assert (code, said) == (
        2,
        "waypost-ros: --drive and --nav2 would both drive the robot; leave out one\n",
    )
    code, said = refused(tmp_path, "--map", "hall", "--nav2")
    assert code == 2
    assert "give --localize" in said
