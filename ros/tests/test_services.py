"""A robot chooses its map, maps or localizes, and finishes sessions by services that every ROS 2 has."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import caller
import pytest
import ros_types as ros
from caller import Caller, Parameter, ParameterValue
from conftest import COMPRESSED, IMAGES, Bridge, Diagnostics, Stage, drive, met, way
from robot import LOSSLESS, SECOND_NS, Robot, until

FLAGS = ("--services", "--image-topic", COMPRESSED, "--sensor-qos", "reliable", "--camera-info-topic", "none")
FLAGS += ("--most-hz", "0")


@dataclass
class Asking:
    """All that a robot may ask of the bridge."""

    localize: Caller
    start: Caller
    finish: Caller
    set: Caller
    get: Caller
    list: Caller

    @staticmethod
    def of(robot: Robot) -> Asking:
        at = f"{robot.namespace}/waypost"

        def of(name: str, kind: str) -> Caller:
            request, response = getattr(caller, f"{kind}Request"), getattr(caller, f"{kind}Response")
            return Caller(robot, f"{at}/{name}", request, response)

        return Asking(
            of("localize", "SetBool"),
            of("start", "Trigger"),
            of("finish", "Trigger"),
            of("set_parameters", "SetParameters"),
            of("get_parameters", "GetParameters"),
            of("list_parameters", "ListParameters"),
        )

    def parameters(self, **wanted: bool | int | str) -> list[tuple[bool, str]]:
        told = self.set([Parameter(name, ParameterValue.of(value)) for name, value in wanted.items()])
        return [(result.successful, result.reason) for result in told.results]

    def known(self) -> dict[str, Any]:
        names = self.list([], 0).result.names
        return dict(zip(names, (value.value for value in self.get(names).values), strict=True))


@pytest.fixture
def asked(stage: Stage) -> tuple[Robot, Diagnostics, Bridge, Asking]:
    """A robot whose bridge has no map yet."""
    robot = stage.robot()
    told = Diagnostics(robot)
    bridge = stage.bridge(*FLAGS)
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, COMPRESSED, "odom")
    return robot, told, bridge, Asking.of(robot)


def test_a_robot_chooses_its_map_maps_it_and_localizes(
    stage: Stage, asked: tuple[Robot, Diagnostics, Bridge, Asking]
) -> None:
    robot, told, _, asking = asked
    stage.client.create_map("office", "shipped")
    assert asking.known() == {"localize": False, "map": "", "session": ""}
    until(lambda: "no map is chosen; set the parameter `map` by /waypost/set_" in told.message("server"))
    # Frames that come before are of no map.
    drive(robot, range(1, 4))
    until(lambda: told.count("server", "frames while no session was wanted") == 3)

    assert asking.parameters(map="hall", session="monday") == [(True, ""), (True, "")]
    assert asking.known() == {"localize": False, "map": "hall", "session": "monday"}
    drive(robot, range(4, 24))
    finished = asking.finish()
    assert (finished.success, finished.message) == (
        True,
        "maps/hall/sessions/monday is finished; 0 frames could not be sent",
    )
    # All that the robot took before it asked is in the map.
    assert len(stage.client.frames("maps/hall/sessions/monday")) == 20
    until(lambda: "is finished; /waypost/start begins the next" in told.message("server"))
    drive(robot, range(24, 26))
    until(lambda: told.count("server", "frames while no session was wanted") == 5)

    before = stage.client.map("hall")
    localizes = asking.localize(True)
    assert localizes.success, localizes
    assert asking.known()["localize"] is True
    poses = robot.listen("waypost/pose", ros.PoseWithCovarianceStamped)
    # Along the same way once more.
    for second in range(26, 36):
        robot.compressed(second * SECOND_NS, IMAGES[second - 20].read_bytes())
        robot.odometry(second * SECOND_NS, *way(second - 19))
        time.sleep(0.1)
    until(poses)
    assert stage.client.map("hall").frames == before.frames

    # Another map, and growing: in one call, so that nothing is in between.
    assert asking.parameters(map="office", localize=False) == [(True, ""), (True, "")]
    drive(robot, range(36, 46))
    [session] = stage.client.sessions("office")
    until(lambda: len(stage.client.frames(session.name)) == 10)
    again = asking.start()
    assert (again.success, again.message) == (True, f"{session.name} is open")


def test_what_cannot_be_done_is_answered_with_what_mends_it(
    stage: Stage, asked: tuple[Robot, Diagnostics, Bridge, Asking]
) -> None:
    _, told, bridge, asking = asked
    for call in (lambda: asking.localize(True), lambda: asking.start()):
        answer = call()
        assert not answer.success
        assert "no map is chosen; set the parameter `map` by /waypost/set_parameters first" in answer.message
    answer = asking.finish()
    assert (answer.success, answer.message) == (False, "no session is open: nothing is to finish")
    [(is_set, why)] = asking.parameters(map="nowhere")
    assert not is_set
    assert "the server has no map `nowhere`; `waypost map list` names those that it has" in why
    assert asking.parameters(map=7, speed="fast", localize="yes") == [
        (False, "map is a text: the name of a map that the server has"),
        (False, "there is no parameter `speed`; there are localize, map, session"),
        (False, "localize is true or false"),
    ]
    # What the server refuses is answered, and the bridge lives on.
    [_, (is_set, why)] = asking.parameters(session="mon/day", map="hall")
    assert not is_set
    assert "session" in why
    until(lambda: told.level("server") == 2)
    # A name that was refused is not tried again: the server chooses.
    assert asking.known()["session"] == ""
    assert asking.start().success
    stage.server.kill()
    [(is_set, why)] = asking.parameters(map="office")
    assert not is_set
    assert why
    assert bridge.process.poll() is None


def test_each_caller_gets_its_own_answers(
    stage: Stage, asked: tuple[Robot, Diagnostics, Bridge, Asking]
) -> None:
    robot, _, _, asking = asked
    other = Asking.of(robot)
    assert asking.parameters(map="hall") == [(True, "")]
    for count in range(20):
        one = asking.get(["map"] * (count + 1))
        two = other.get(["localize"])
        assert [value.value for value in one.values] == ["hall"] * (count + 1)
        assert [value.value for value in two.values] == [False]
    # They share a topic: answers come to both, and are told apart by how they begin.
    assert {answer.guid for answer in asking.get.others} == {other.get._guid}


def test_a_driven_robot_is_not_told_to_map(stage: Stage) -> None:
    robot = stage.robot("/robot1")
    flags = ("--services", "--localize", "--drive", "--namespace", "robot1")
    stage.bridge("--map", "hall", "--image-topic", COMPRESSED, *flags)
    asking = Asking.of(robot)
    answer = asking.localize(False)
    assert not answer.success
    assert "start it without --drive or --nav2 to map" in answer.message


def test_without_the_flag_nothing_is_served(stage: Stage) -> None:
    robot = stage.robot()
    told = Diagnostics(robot)
    stage.bridge("--map", "hall", "--image-topic", COMPRESSED, "--camera-info-topic", "none")
    asking = Asking.of(robot)
    until(lambda: told.message("server") != "")
    with pytest.raises(AssertionError, match="nobody serves it"):
        asking.start()
