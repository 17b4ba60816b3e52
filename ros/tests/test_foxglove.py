"""Foxglove's app looks on: it reads what it is shown, also when it comes late, and holds up nobody."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import ros_types as ros
from conftest import (
    COMPRESSED,
    FOCAL_PX,
    IMAGES,
    SIZE_PX,
    Bridge,
    Diagnostics,
    Stage,
    drive,
    met,
    way,
)
from robot import LOSSLESS, SECOND_NS, Robot, until
from test_bad_input import refused
from viewer import Shown, Viewer, address_in, stamp_of
from websockets.exceptions import ConnectionClosed, InvalidMessage, InvalidStatus

FLAGS = ("--map", "hall", "--session", "drive", "--image-topic", COMPRESSED, "--sensor-qos", "reliable")
SHOWN = {
    "/camera/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/waypost/markers": "visualization_msgs/msg/MarkerArray",
    "/waypost/match": "std_msgs/msg/Float64",
    "/waypost/most_probable_place": "std_msgs/msg/Float64",
    "/waypost/new_place": "std_msgs/msg/Float64",
    "/waypost/path": "nav_msgs/msg/Path",
    "/waypost/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
}


#: As the bridge has it.
MOST_VIEWERS = 8


@pytest.fixture
def shown(stage: Stage) -> Iterator[tuple[Robot, Bridge, list[Viewer]]]:
    """A robot with a declared camera, and a bridge that lets viewers in."""
    robot = stage.robot()
    bridge = stage.bridge(*FLAGS, "--most-hz", "0", "--foxglove", "127.0.0.1:0")
    robot.camera_info(SIZE_PX, FOCAL_PX)
    robot.mounting()
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, COMPRESSED, "odom", "camera/camera_info", "/tf_static")
    robot.camera_info(SIZE_PX, FOCAL_PX)
    viewers: list[Viewer] = []
    try:
        yield robot, bridge, viewers
    finally:
        for viewer in viewers:
            viewer.close()


def come(bridge: Bridge, viewers: list[Viewer], *topics: str) -> Viewer:
    address = until(lambda: address_in(bridge.said()), what="no address is told")
    viewers.append(Viewer(address))
    viewers[-1].subscribe(*topics)
    return viewers[-1]


def test_all_that_is_shown_can_be_read(shown: tuple[Robot, Bridge, list[Viewer]]) -> None:
    robot, bridge, viewers = shown
    viewer = come(bridge, viewers, *SHOWN)
    assert {topic: channel["schemaName"] for topic, channel in viewer.channels.items()} == SHOWN
    seen: dict[str, list[Shown]] = {topic: [] for topic in SHOWN}
    last = 0
    deadline = time.monotonic() + 60
    # All but what only a closed loop has.
    while not all(found for topic, found in seen.items() if topic != "/waypost/match"):
        missing = sorted(topic for topic, found in seen.items() if not found)
        assert time.monotonic() < deadline, f"{missing} are not shown: {bridge.said()}"
        if last < 40:
            last += 1
            drive(robot, range(last, last + 1))
        while (one := viewer.read(0.05)) is not None:
            seen[one.topic].append(one)

    first = seen["/camera/image_raw/compressed"][0]
    second = stamp_of(first.data) // SECOND_NS
    assert bytes(first.data.data) == IMAGES[second - 1].read_bytes()
    assert (first.data.format, first.data.header.frame_id) == ("jpeg", "camera_optical")
    assert seen["/camera/camera_info"][0].data.k[0] == FOCAL_PX
    odometry = seen["/odom"][-1].data
    assert odometry.pose.pose.position.x == way(stamp_of(odometry) // SECOND_NS)[0]
    # The robot in the map, by two transforms; the camera on the robot, by those that never change.
    told = [transform for one in seen["/tf"] for transform in one.data.transforms]
    joints = {(transform.header.frame_id, transform.child_frame_id) for transform in told}
    assert joints == {("map", "odom"), ("odom", "base_link")}
    static = {transform.child_frame_id for transform in seen["/tf_static"][0].data.transforms}
    assert static == {"camera", "camera_optical"}
    assert seen["/waypost/pose"][0].data.header.frame_id == "map"
    assert {marker.ns for marker in seen["/waypost/markers"][-1].data.markers} >= {"places", "links"}
    assert all(0.0 <= one.data.data <= 1.0 for one in seen["/waypost/new_place"])
    # By the robot's clock, so that transforms are found for what is shown.
    odometry_lag_ns = [one.time_ns - stamp_of(one.data) for one in seen["/odom"]]
    assert all(0 <= lag_ns < SECOND_NS for lag_ns in odometry_lag_ns), odometry_lag_ns


def test_who_comes_late_sees_the_map(shown: tuple[Robot, Bridge, list[Viewer]]) -> None:
    robot, bridge, viewers = shown
    early = come(bridge, viewers, "/waypost/markers", "/waypost/path")
    drive(robot, range(1, 11))
    path = early.until(lambda one: one.topic == "/waypost/path" and len(one.data.poses) > 0)
    markers = early.until(lambda one: one.topic == "/waypost/markers" and len(one.data.markers) > 1)
    # The robot says nothing more, and the map is drawn anew after half a minute.
    began = time.monotonic()
    late = come(bridge, viewers, "/waypost/markers", "/waypost/path", "/tf_static", "/camera/camera_info")
    seen: dict[str, Shown] = {}
    while len(seen) < 4:
        assert time.monotonic() - began < 2.0, f"only {sorted(seen)}"
        one = late.read(0.2)
        if one is not None:
            seen[one.topic] = one
    assert len(seen["/waypost/path"].data.poses) >= len(path.data.poses)
    assert len(seen["/waypost/markers"].data.markers) >= len(markers.data.markers)


def resident_bytes(bridge: Bridge) -> int:
    """What the bridge's process has in memory."""
    status = Path(f"/proc/{bridge.process.pid}/status").read_text()
    [line] = [line for line in status.splitlines() if line.startswith("VmRSS")]
    return int(line.split()[1]) * 1024


def test_a_viewer_that_does_not_read_holds_up_nobody(
    stage: Stage, shown: tuple[Robot, Bridge, list[Viewer]]
) -> None:
    robot, bridge, viewers = shown
    told = Diagnostics(robot)
    # One that asks for all, and then reads nothing.
    slow = come(bridge, viewers, *SHOWN)
    viewer = come(bridge, viewers, "/camera/image_raw/compressed")
    image = IMAGES[0].read_bytes()
    # Behind its end a JPEG may have anything: each is 1 MB.
    large = image + bytes(1_000_000 - len(image))
    # After the first hundred all that may fill up has.
    last, resident = 300, {}
    for second in range(1, last + 1):
        robot.compressed(second * SECOND_NS, large)
        robot.odometry(second * SECOND_NS, *way(second))
        viewer.until(lambda one, second=second: stamp_of(one.data) == second * SECOND_NS, 10.0)
        resident[second] = resident_bytes(bridge)
    until(lambda: told.count("server", "frames answered") == last, 60.0, f"{told()}")
    assert told.count("server", "frames dropped") == 0
    # What waits for the slow one has bounds, and it gets on once it reads.
    grown_bytes = resident[last] - resident[100]
    print(f"{resident[100] / 1e6:.0f} MB after 100 images, {resident[last] / 1e6:.0f} MB after {last}")
    assert grown_bytes < 60e6, grown_bytes
    slow.until(lambda one: one.topic == "/diagnostics" and one.time_ns >= last * SECOND_NS)


def test_no_more_viewers_are_let_in_than_the_bridge_has_room_for(
    shown: tuple[Robot, Bridge, list[Viewer]],
) -> None:
    robot, bridge, viewers = shown
    for _ in range(MOST_VIEWERS):
        come(bridge, viewers, "/diagnostics")
    for _ in range(3):
        with pytest.raises(InvalidStatus) as refused:
            come(bridge, viewers, "/diagnostics")
        response = refused.value.response
        assert response.status_code == 503
        assert b"8 viewers look on already" in response.body
        assert b"close one of them" in response.body
    until(lambda: "is not let in to look on: 8 do already" in bridge.said())
    # Those who are there are shown what comes.
    for viewer in viewers:
        viewer.until(lambda one: one.topic == "/diagnostics")
    # Who leaves makes room for another.
    viewers.pop().close()

    def let_in() -> bool:
        try:
            come(bridge, viewers, "/diagnostics")
        except InvalidStatus:
            return False
        return True

    until(let_in, what="nobody is let in where one has left")


def test_who_says_nothing_takes_nobodys_place(shown: tuple[Robot, Bridge, list[Viewer]]) -> None:
    robot, bridge, viewers = shown
    address = until(lambda: address_in(bridge.said()), what="no address is told")
    host, _, port = address.removeprefix("ws://").rpartition(":")
    with contextlib.ExitStack() as connections:
        for first in (b"", b"GET / HTTP/1.1\r\nHost: a\r\n", b"A" * 100_000) * 3:
            silent = connections.enter_context(socket.create_connection((host, int(port))))
            with contextlib.suppress(OSError):
                silent.sendall(first)

        def let_in() -> bool:
            try:
                come(bridge, viewers, "/diagnostics")
            except (InvalidStatus, InvalidMessage, ConnectionClosed, OSError):
                return False
            return True

        until(let_in, what="those who say nothing have all places")
        viewers[-1].until(lambda one: one.topic == "/diagnostics")


def test_an_address_that_cannot_be_had_is_told(stage: Stage, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        bridge = stage.bridge(*FLAGS, "--foxglove", address)
        assert bridge.process.wait(30) == 1
        assert f"cannot be let in at {address}: " in bridge.said()
        assert "in use" in bridge.said()
    code, told = refused(tmp_path, "--map", "hall", "--foxglove", "localhost")
    assert code == 2
    assert "invalid socket address" in told
    # Unless it is asked for nothing listens.
    bridge = stage.bridge(*FLAGS)
    until(lambda: "listening in domain" in bridge.said())
    assert address_in(bridge.said()) == ""
