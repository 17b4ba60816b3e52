"""A robot that is taught and led through DDS alone.

Its wheels are exact and its world is a row of recorded frames: it shows that the bridge, the server and the
wheels work together, and nothing of how well one drives in a real building.
"""

from __future__ import annotations

import io
import math
import signal
import threading
import time
from collections.abc import Iterator

import pytest
import ros_types as ros
from conftest import COMPRESSED, IMAGES, SIZE_PX, Diagnostics, Stage, met
from PIL import Image as Picture
from robot import DEFAULT, LATCHED, LOSSLESS, SECOND_NS, Robot, turned, until
from waypost.v1 import label_pb2

#: From one image of the drive to the next.
STEP_M = 0.5
FIELD_OF_VIEW_RAD = 1.2
FOCAL_PX = SIZE_PX[0] / 2 / math.tan(FIELD_OF_VIEW_RAD / 2)
TAUGHT = 20
#: A place of the taught way; and how far along it is to be reached.
DOCK, DOCK_M = 4, 4.5
#: Longer than a drive takes, even if the robot looks all around once.
DRIVE_S = 180.0
FLAGS = ("--map", "hall", "--image-topic", COMPRESSED, "--sensor-qos", "reliable")


class Wheels:
    """Wheels that do as cmd_vel says, and a camera that sees the image of the nearest step."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.x_m, self.y_m, self.heading_rad = 2 * STEP_M, 0.0, 0.0
        self.commands: list[tuple[float, float, float]] = []
        self.tells_odometry = threading.Event()
        self.tells_odometry.set()
        self._ends = threading.Event()
        self._take = robot.listen("cmd_vel", ros.Twist)
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._ends.set()
        self._thread.join()

    def drives(self) -> bool:
        return bool(self.commands) and self.commands[-1][1] > 0.05

    def stands(self) -> bool:
        return bool(self.commands) and self.commands[-1][1:] == (0.0, 0.0)

    def _run(self) -> None:
        cycle, before = 0, time.monotonic()
        while not self._ends.is_set():
            now = time.monotonic()
            self.commands += [(now, twist.linear.x, twist.angular.z) for twist in self._take()]
            self._move(now - before)
            before = now
            stamp_ns = time.monotonic_ns()
            # The image first, so that it does not wait for the next reading.
            if cycle % 8 == 0:
                self.robot.compressed(stamp_ns, self.image())
            if self.tells_odometry.is_set():
                self.robot.odometry(stamp_ns, self.x_m, self.y_m, self.heading_rad)
            cycle += 1
            time.sleep(0.03)

    def _move(self, passed_s: float) -> None:
        if not self.commands:
            return
        _, forward_m_s, turn_rad_s = self.commands[-1]
        self.heading_rad += turn_rad_s * passed_s
        self.x_m += forward_m_s * passed_s * math.cos(self.heading_rad)
        self.y_m += forward_m_s * passed_s * math.sin(self.heading_rad)

    def image(self) -> bytes:
        image = IMAGES[min(max(round(self.x_m / STEP_M), 0), len(IMAGES) - 1)].read_bytes()
        if abs(self.heading_rad) < 1e-3:
            return image
        # Once the robot has turned to the left, the scene is further to the right.
        seen = Picture.open(io.BytesIO(image))
        canvas = Picture.new(seen.mode, seen.size)
        shift = round(seen.width * math.remainder(self.heading_rad, math.tau) / FIELD_OF_VIEW_RAD)
        canvas.paste(seen, (shift, 0))
        out = io.BytesIO()
        canvas.save(out, "JPEG", quality=90)
        return out.getvalue()


def declare(robot: Robot) -> None:
    robot.camera_info(SIZE_PX, FOCAL_PX)
    robot.mounting()
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, COMPRESSED, "odom", "camera/camera_info", "/tf_static")
    robot.camera_info(SIZE_PX, FOCAL_PX)


def taught(stage: Stage, robot: Robot, told: Diagnostics) -> None:
    """Drives the way once over DDS, with a bridge that ends, and names the dock."""
    teaching = stage.bridge(*FLAGS, "--session", "taught", "--most-hz", "0")
    declare(robot)
    for step in range(TAUGHT):
        robot.compressed((step + 1) * SECOND_NS, IMAGES[step].read_bytes())
        robot.odometry((step + 1) * SECOND_NS, step * STEP_M, 0.0, 0.0)
        time.sleep(0.05)
    until(lambda: told.count("server", "frames answered") == TAUGHT, what=f"frames are missing: {told()}")
    assert teaching.end() == 0
    assert stage.client.set_label("hall", DOCK, "dock", label_pb2.LABEL_SCOPE_PLACE) == [DOCK]
    until(lambda: not robot.is_heard("odom"))
    told.forget()


@pytest.fixture
def led(stage: Stage) -> Iterator[tuple[Wheels, Diagnostics]]:
    """A robot on a way that it was taught over DDS, with a bridge that takes goals."""
    robot = stage.robot()
    told = Diagnostics(robot)
    taught(stage, robot, told)
    bridge = stage.bridge(*FLAGS, "--localize", "--drive", "--speed-m-s", "0.5")
    wheels = Wheels(robot)
    declare(robot)
    wheels.start()
    try:
        until(lambda: told.message("navigation") != "", what=f"no navigation: {bridge.said()}")
        yield wheels, told
    finally:
        wheels.close()


def go_to(wheels: Wheels, name: str) -> None:
    wheels.robot.advertise("waypost/goal", ros.String, DEFAULT)
    met(wheels.robot, "waypost/goal")
    wheels.robot.publish("waypost/goal", ros.String(name))


def test_a_robot_is_led_to_a_label_and_to_a_pose(stage: Stage, led: tuple[Wheels, Diagnostics]) -> None:
    wheels, told = led
    robot = wheels.robot
    go_to(wheels, "dock")
    until(lambda: told.value("navigation", "status") == "arrived", DRIVE_S, f"{told()} {wheels.x_m}")
    assert wheels.x_m == pytest.approx(DOCK_M, abs=1.0)
    assert abs(wheels.y_m) < 0.5
    until(wheels.stands)
    count = len(wheels.commands)
    time.sleep(1.5)
    # The wheels are free for others, after a few stops.
    assert len(wheels.commands) - count <= 12

    target = ros.PoseStamped(ros.Header(ros.Time(), "odom"), ros.Pose(ros.Point(7.0, 0.0, 0.0), turned(0.0)))
    robot.advertise("goal_pose", ros.PoseStamped, DEFAULT)
    met(robot, "goal_pose")
    robot.publish("goal_pose", target)
    until(lambda: "`odom` is not taken" in told.message("navigation"))
    target.header.frame_id = "map"
    robot.publish("goal_pose", target)

    # Until it sets out, the dock is where it has arrived.
    def there() -> bool:
        return wheels.x_m > 6.0 and told.value("navigation", "status") == "arrived"

    until(there, DRIVE_S, f"{told()} {wheels.x_m}")
    assert wheels.x_m == pytest.approx(7.0, abs=1.0)
    assert abs(wheels.y_m) < 0.5

    markers = robot.listen("waypost/markers", ros.MarkerArray, LATCHED)
    array = until(markers)[-1]
    drawn = {marker.ns: marker for marker in array.markers}
    assert len(drawn["places"].points) > 5
    assert drawn["places"].header.frame_id == "map"
    assert drawn["labels"].text == "dock"
    assert len(drawn["links"].points) > 5


def test_the_robot_stands_when_anything_is_missing(stage: Stage, led: tuple[Wheels, Diagnostics]) -> None:
    wheels, told = led
    last = max(int(place.name.rsplit("/", 1)[1]) for place in stage.client.places("hall"))
    go_to(wheels, "1000")
    until(lambda: "the map has no place 1000" in told.message("navigation"))
    go_to(wheels, str(last))
    until(wheels.drives, DRIVE_S, f"{told()}")

    wheels.tells_odometry.clear()
    gone = time.monotonic()
    until(wheels.stands, 5.0, "it drives on without odometry")
    without_odometry_s = time.monotonic() - gone
    assert without_odometry_s < 1.0
    wheels.tells_odometry.set()
    until(wheels.drives, DRIVE_S, f"it does not go on: {told()}")

    stage.server.kill()
    gone = time.monotonic()
    until(wheels.stands, 5.0, "it drives on without the server")
    without_server_s = time.monotonic() - gone
    assert without_server_s < 1.0
    stage.server.start()
    until(wheels.drives, DRIVE_S, f"it does not go on: {told()}")

    bridge = stage.bridges[-1]
    assert bridge.end(signal.SIGINT) == 0
    until(wheels.stands, 1.0, "it drives on without the bridge")
    print(f"stood {without_odometry_s:.2f} s after odometry, {without_server_s:.2f} s after the server")


def test_one_wrong_stamp_does_not_stop_a_drive(stage: Stage, led: tuple[Wheels, Diagnostics]) -> None:
    wheels, told = led
    go_to(wheels, "dock")
    until(wheels.drives, DRIVE_S, f"{told()}")
    wheels.robot.odometry(time.monotonic_ns() + 1_000_000 * SECOND_NS, 0.0, 0.0, 0.0)
    until(lambda: told.value("navigation", "status") == "arrived", DRIVE_S, f"{told()} {wheels.x_m}")
    assert wheels.x_m == pytest.approx(DOCK_M, abs=1.0)
    assert told.count("odometry", "left out") == 1
    assert "odometry is refused" not in stage.bridges[-1].said()
