"""map -> odom, the pose and the path, with the server there and away."""

from __future__ import annotations

import math
import threading
import time

import pytest
import ros_types as ros
from conftest import COMPRESSED, FOCAL_PX, SIZE_PX, Diagnostics, Stage, drive, met, p50_and_p99, tell, way
from robot import LATCHED, LOSSLESS, SECOND_NS, Robot, until

FLAGS = ("--map", "hall", "--session", "drive", "--image-topic", COMPRESSED, "--most-hz", "0")
FLAGS += ("--sensor-qos", "reliable")


class Transforms:
    """What comes on /tf, and when."""

    def __init__(self, robot: Robot) -> None:
        self._take = robot.listen("/tf", ros.TFMessage)
        self.came: list[tuple[float, ros.TransformStamped]] = []
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        robot.endings.append(self.close)

    def _watch(self) -> None:
        while not self._ends.is_set():
            now = time.monotonic()
            self.came += [(now, message.transforms[0]) for message in self._take()]
            time.sleep(0.0005)

    def close(self) -> None:
        self._ends.set()
        self._thread.join()

    def between(self, begin: float, end: float) -> list[tuple[float, ros.TransformStamped]]:
        return [(at, transform) for at, transform in self.came if begin <= at < end]


def taught(stage: Stage, robot: Robot, told: Diagnostics, seconds: range) -> None:
    """The bridge maps a drive."""
    robot.camera_info(SIZE_PX, FOCAL_PX)
    robot.mounting()
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, COMPRESSED, "odom", "camera/camera_info", "/tf_static")
    robot.camera_info(SIZE_PX, FOCAL_PX)
    drive(robot, seconds)
    until(lambda: told.count("server", "frames answered") == len(seconds), what="frames are missing")


def test_map_to_odom_comes_20_times_a_second_while_the_server_is_away(stage: Stage) -> None:
    robot = stage.robot()
    told = Diagnostics(robot)
    stage.bridge(*FLAGS)
    transforms = Transforms(robot)
    taught(stage, robot, told, range(1, 11))
    until(lambda: len(transforms.came) > 5)
    begin = time.monotonic()
    # The server answers, as it does a robot at 5 Hz.
    drive(robot, range(11, 21), pause_s=0.2)
    until(lambda: told.count("server", "frames answered") == 20, what="frames are missing")
    stage.server.kill()
    lost = time.monotonic()
    # The robot drives on, and the frames wait.
    drive(robot, range(21, 31), pause_s=0.4)
    until(lambda: told.level("server") == 2, what="nobody says that the server is away")
    assert "not answered" in told.message("server")
    until(lambda: told.level("map to odom") == 1)
    assert float(told.value("map to odom", "age s")) > 3.0
    end = time.monotonic()
    stage.server.start()
    until(lambda: told.count("server", "frames answered") == 30, what="frames were lost")
    transforms.close()

    away = transforms.between(lost, end)
    for name, since, upto in (("there", begin, lost), ("away", lost, end)):
        came = transforms.between(since, upto)
        gaps_s = [after - before for (before, _), (after, _) in zip(came, came[1:])]
        off_ms = p50_and_p99([1000 * abs(gap - 0.05) for gap in gaps_s])
        tell({f"map_to_odom_{name}_off_ms": off_ms})
        assert len(came) == pytest.approx(20 * (upto - since), abs=4)
        # The target is 10 ms; a machine that is shared has pauses of its own.
        assert off_ms[0] < 10.0
    stamps = [transform.header.stamp.ns for _, transform in transforms.came]
    assert stamps == sorted(set(stamps)), "stamps of transforms have to rise"
    frames = {(transform.header.frame_id, transform.child_frame_id) for _, transform in transforms.came}
    assert frames == {("map", "odom")}
    assert len({str(transform.transform) for _, transform in away}) == 1, "nobody told another"
    records = stage.client.frames("maps/hall/sessions/drive")
    assert [record.stamp_ns for record in records] == [second * SECOND_NS for second in range(1, 31)]


def test_pose_and_path_are_where_map_and_odometry_say(stage: Stage) -> None:
    robot = stage.robot()
    told = Diagnostics(robot)
    poses = robot.listen("waypost/pose", ros.PoseWithCovarianceStamped)
    stage.bridge(*FLAGS, "--position-sigma-m", "0.25")
    transforms = Transforms(robot)
    taught(stage, robot, told, range(1, 21))
    until(lambda: len(transforms.came) > 2)
    came: list[ros.PoseWithCovarianceStamped] = []
    until(lambda: came.extend(poses()) or (came and came[-1].header.stamp.ns == 20 * SECOND_NS))
    last = came[-1]
    assert (last.header.frame_id, last.pose.covariance[0], last.pose.covariance[7]) == ("map", 0.0625, 0.0625)
    x, y, _ = way(20)
    moved = transforms.came[-1][1].transform
    heading = 2 * math.atan2(moved.rotation.z, moved.rotation.w)
    expected = (
        moved.translation.x + math.cos(heading) * x - math.sin(heading) * y,
        moved.translation.y + math.sin(heading) * x + math.cos(heading) * y,
    )
    assert (last.pose.pose.position.x, last.pose.pose.position.y) == pytest.approx(expected, abs=1e-6)
    transforms.close()
    # Whoever comes late gets the path as well.
    paths = robot.listen("waypost/path", ros.Path, LATCHED)
    path = until(paths)[-1]
    assert path.header.frame_id == "map"
    assert len(path.poses) >= 1
    stamps = [pose.header.stamp.ns for pose in path.poses]
    assert stamps == sorted(stamps)


def test_robots_of_many_have_namespaces(stage: Stage) -> None:
    stage.client.create_map("other", "shipped")
    for namespace, map_id in (("robot1", "hall"), ("robot2", "other")):
        flags = ("--image-topic", COMPRESSED, "--camera-info-topic", "none", "--odometry-topic", "none")
        flags += ("--sensor-qos", "reliable")
        stage.bridge("--map", map_id, "--session", "drive", "--namespace", namespace, *flags)
    first, second = stage.robot("/robot1"), stage.robot("/robot2")
    for robot in (first, second):
        robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
        met(robot, COMPRESSED)
    for number in (1, 2, 3):
        first.compressed(number * SECOND_NS, b"\xff\xd8\xff no JPEG")
        second.compressed(number * SECOND_NS, b"\xff\xd8\xff no JPEG")
    diagnostics = first.listen("/diagnostics", ros.DiagnosticArray)
    refused: set[str] = set()

    def both_told() -> bool:
        for message in diagnostics():
            for status in message.status:
                if any(value.key == "frames refused" and value.value == "3" for value in status.values):
                    refused.add(status.hardware_id)
        return refused == {"robot1", "robot2"}

    until(both_told, what="not both told of their frames")
