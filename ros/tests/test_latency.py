"""From an image on DDS to its pose on DDS, beside the client library's own answers."""

from __future__ import annotations

import re
import statistics
import time
from urllib.request import urlopen

import ros_types as ros
import waypost
from conftest import COMPRESSED, IMAGES, PATIENCE_S, Diagnostics, Server, Stage, met, p50_and_p99, tell, way
from robot import LOSSLESS, SECOND_NS, Robot, turned, until

TAUGHT = range(1, 61)
MEASURED = range(2, 53)
#: 10 Hz at most.
PERIOD_S = 0.1


def taught_frame(second: int) -> waypost.Frame:
    x, y, yaw = way(second)
    turn = turned(yaw)
    odometry = waypost.Pose3((x, y, 0.0), (turn.x, turn.y, turn.z, turn.w))
    return waypost.Frame(second, second * SECOND_NS, IMAGES[second - 1].read_bytes(), odometry=odometry)


class OverDds:
    """From when an image is written to when its pose is there."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._poses = robot.listen("waypost/pose", ros.PoseWithCovarianceStamped)

    def ms(self, second: int) -> float:
        self._robot.odometry(second * SECOND_NS, *way(second))
        self._robot.compressed(second * SECOND_NS, IMAGES[second - 1].read_bytes())
        began = time.monotonic()
        while not any(pose.header.stamp.ns == second * SECOND_NS for pose in self._poses()):
            assert time.monotonic() < began + PATIENCE_S, f"no pose of frame {second}"
            time.sleep(0.0002)
        return 1000 * (time.monotonic() - began)


class Computing:
    """What the server says that frames took it, from their arrival to their answers."""

    def __init__(self, server: Server) -> None:
        self._metrics = f"http://{server.http_address}/metrics"
        self._frames, self._ms = self._so_far()

    def of_the_next_ms(self) -> float:
        """Of the one frame since this was asked last."""
        before, before_ms = self._frames, self._ms
        while self._frames == before:
            self._frames, self._ms = self._so_far()
        assert self._frames == before + 1
        return self._ms - before_ms

    def _so_far(self) -> tuple[int, float]:
        with urlopen(self._metrics) as metrics:
            text = metrics.read().decode()
        found = {
            kind: float(value)
            for kind, value in re.findall(
                r'^waypost_frame_duration_seconds_(count|sum)\{stage="total"\} (\S+)$', text, re.MULTILINE
            )
        }
        return int(found.get("count", 0)), 1000 * found.get("sum", 0.0)


def directly_ms(session: waypost.Session, second: int) -> float:
    frame = taught_frame(second)
    began = time.monotonic()
    [answer] = session.stream([frame])
    took_ms = 1000 * (time.monotonic() - began)
    assert isinstance(answer, waypost.Answer)
    return took_ms


def test_the_bridge_adds_little_to_the_server(stage: Stage) -> None:
    with stage.client.session("hall", "taught") as session:
        for outcome in session.stream(taught_frame(second) for second in TAUGHT):
            assert isinstance(outcome, waypost.Answer)
    robot = stage.robot()
    told = Diagnostics(robot)
    flags = ("--image-topic", COMPRESSED, "--camera-info-topic", "none", "--sensor-qos", "reliable")
    stage.bridge("--map", "hall", "--localize", *flags)
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, COMPRESSED, "odom")
    # The first is for finding the robot.
    robot.odometry(SECOND_NS, *way(1))
    robot.compressed(SECOND_NS, IMAGES[0].read_bytes())
    until(lambda: told.count("server", "frames answered") == 1)
    took: dict[str, list[float]] = {name: [] for name in ("dds", "dds_beyond", "client", "client_beyond")}
    robots = OverDds(robot)
    # One after the other, so that a machine that is shared is as busy for both.
    with stage.client.session("hall", "direct", mode=waypost.Mode.LOCALIZE) as session:
        directly_ms(session, 1)
        directly_ms(session, 1)
        computing = Computing(stage.server)
        for second in MEASURED:
            took["dds"].append(robots.ms(second))
            took["dds_beyond"].append(took["dds"][-1] - computing.of_the_next_ms())
            took["client"].append(directly_ms(session, second))
            took["client_beyond"].append(took["client"][-1] - computing.of_the_next_ms())
            time.sleep(PERIOD_S)
    tell({"frames": len(MEASURED)} | {f"{name}_ms": p50_and_p99(each) for name, each in took.items()})
    # The target is 5 ms, on a machine that has nothing else to do.
    assert statistics.median(took["dds_beyond"]) < 30.0
