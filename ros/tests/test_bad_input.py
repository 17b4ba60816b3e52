"""What is missing or wrong is told, in the log and in the diagnostics, with what mends it."""

from __future__ import annotations

import signal
import subprocess
import time
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
    binary,
    drive,
    environment,
    met,
)
from robot import DEFAULT, LATCHED, LOSSLESS, OPTICAL, SECOND_NS, SENSOR, Robot, until

FLAGS = ("--map", "hall", "--session", "drive", "--image-topic", COMPRESSED, "--sensor-qos", "reliable")


def heard(stage: Stage, *flags: str) -> tuple[Robot, Diagnostics, Bridge]:
    """A robot each of whose images is heard, of a camera that is not declared."""
    robot = stage.robot()
    told = Diagnostics(robot)
    bridge = stage.bridge(*FLAGS, "--camera-info-topic", "none", "--most-hz", "0", *flags)
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    met(robot, COMPRESSED)
    return robot, told, bridge


def with_images(stage: Stage) -> tuple[Robot, Diagnostics, Bridge]:
    """One without odometry."""
    return heard(stage, "--odometry-topic", "none")


def with_wheels(stage: Stage) -> tuple[Robot, Diagnostics, Bridge]:
    """One with odometry."""
    robot, told, bridge = heard(stage)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, "odom")
    return robot, told, bridge


def test_without_camera_info_nothing_is_sent_and_it_is_said(stage: Stage) -> None:
    robot = stage.robot()
    told = Diagnostics(robot)
    bridge = stage.bridge(*FLAGS)
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, COMPRESSED, "odom")
    drive(robot, range(1, 6))
    until(lambda: told.level("camera") == 2)
    assert "nothing came on /camera/camera_info" in told.message("camera")
    assert "camera_info_topic" in bridge.said()
    assert (told.count("server", "frames waiting"), told.count("server", "frames sent")) == (5, 0)
    robot.camera_info(SIZE_PX, 0.0)
    met(robot, "camera/camera_info")
    robot.camera_info(SIZE_PX, 0.0)
    until(lambda: "it is not calibrated" in told.message("camera"))
    # It comes after all, and nothing is lost.
    robot.camera_info(SIZE_PX, FOCAL_PX)
    robot.mounting()
    until(lambda: told.count("server", "frames answered") == 5)


def test_without_tf_the_camera_is_declared_without_its_place(stage: Stage) -> None:
    robot = stage.robot()
    told = Diagnostics(robot)
    stage.bridge(*FLAGS)
    robot.camera_info(SIZE_PX, FOCAL_PX)
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, COMPRESSED, "odom", "camera/camera_info")
    robot.camera_info(SIZE_PX, FOCAL_PX)
    drive(robot, range(1, 6))
    until(lambda: told.count("server", "frames answered") == 5)
    assert told.level("camera") == 1
    assert "nothing on /tf_static joins base_link and camera_optical" in told.message("camera")
    [session] = stage.client.sessions("hall")
    assert session.camera.pinhole.fx_px == FOCAL_PX
    assert not session.camera.HasField("base_to_camera")


def test_a_gap_in_odometry_makes_frames_without_and_no_poses_up(stage: Stage) -> None:
    robot, told, _ = with_wheels(stage)
    robot.odometry(1 * SECOND_NS, 0.0, 0.0, 0.0)
    for second in (2, 3):
        robot.compressed(second * SECOND_NS, IMAGES[second - 1].read_bytes())
    # Three that agree are believed to come after a pause.
    for tenth in range(40, 43):
        robot.odometry(tenth * SECOND_NS // 10, 1.0, 0.0, 0.0)
    robot.compressed(4 * SECOND_NS, IMAGES[3].read_bytes())
    until(lambda: told.count("server", "frames answered") == 3)
    assert told.count("server", "frames without odometry") == 2
    records = stage.client.frames("maps/hall/sessions/drive")
    assert [record.HasField("odometry") for record in records] == [False, False, True]


@pytest.mark.parametrize("kind", ["type", "qos"])
def test_what_cannot_be_heard_is_named(stage: Stage, kind: str) -> None:
    robot = stage.robot()
    told = Diagnostics(robot)
    flags = ("--map", "hall", "--camera-info-topic", "none", "--odometry-topic", "none")
    if kind == "type":
        bridge = stage.bridge(*flags)
        robot.advertise("camera/image_raw", ros.CompressedImage, DEFAULT)
        expected = (
            "/camera/image_raw is published as sensor_msgs/CompressedImage, and read as sensor_msgs/Image"
        )
    else:
        bridge = stage.bridge(*flags, "--sensor-qos", "reliable")
        robot.advertise("camera/image_raw", ros.Image, SENSOR)
        expected = "set sensor_qos to best-effort"
    until(lambda: expected in told.message("images"), what=f"{told()} {bridge.said()}")
    assert told.level("images") == 2
    assert expected in bridge.said()


def test_images_that_are_none_are_left_out_and_counted(stage: Stage) -> None:
    robot, told, _ = with_images(stage)
    image = IMAGES[0].read_bytes()
    robot.compressed(1 * SECOND_NS, image)
    robot.compressed(1 * SECOND_NS, image)
    robot.compressed(0, image)
    robot.compressed(2 * SECOND_NS, b"GIF89a")
    robot.compressed(2 * SECOND_NS, image)
    until(lambda: told.count("server", "frames answered") == 2)
    until(lambda: told.count("images", "left out") == 3)
    assert told.level("images") == 1
    assert "neither JPEG nor PNG" in told.message("images")


def test_one_wrong_stamp_costs_itself_alone(stage: Stage) -> None:
    robot, told, _ = with_wheels(stage)
    drive(robot, range(1, 9))
    robot.odometry(1_000_000 * SECOND_NS, 0.0, 0.0, 0.0)
    robot.compressed(1_000_000 * SECOND_NS, IMAGES[0].read_bytes())
    drive(robot, range(9, 19))
    until(lambda: told.count("server", "frames answered") == 18, what=f"{told()}")
    records = stage.client.frames("maps/hall/sessions/drive")
    assert [record.stamp_ns // SECOND_NS for record in records] == [*range(1, 19)]
    assert all(record.HasField("odometry") for record in records)
    for part in ("odometry", "images"):
        until(lambda part=part: told.count(part, "left out") == 1)
    # On a slow machine the sensors have been silent for long by now, which is an error of its own.
    drive(robot, range(19, 29), pause_s=0.2)
    for part in ("odometry", "images"):
        until(lambda part=part: told.level(part) == 1, what=f"{told()}")
        assert "does not follow those around it" in told.message(part)


def test_a_clock_that_is_set_back_begins_a_new_session(stage: Stage) -> None:
    robot, told, bridge = with_wheels(stage)
    drive(robot, range(101, 111))
    until(lambda: told.count("server", "frames answered") == 10, what=f"{told()}")
    until(lambda: told.level("map to odom") == 0)
    # A simulation that begins again, twice. Three stamps show that it has; those images are of no session.
    for run in (2, 3):
        drive(robot, range(1, 4))
        until(lambda run=run: bridge.said().count("is open") == run, what=bridge.said())
        # Odometry begins anew with the clock: the last answers placed another.
        until(lambda: "does not have the robot yet" in told.message("map to odom"))
        drive(robot, range(4, 14))
        until(lambda run=run: told.count("server", "frames answered") == 10 * run, what=f"{told()}")
    assert bridge.said().count("the robot's clock was set back") == 2
    sessions = {session.name for session in stage.client.sessions("hall")} - {"maps/hall/sessions/drive"}
    assert len(sessions) == 2
    for session in sessions:
        records = list(stage.client.frames(session))
        assert [record.stamp_ns // SECOND_NS for record in records] == [*range(4, 14)]
        assert all(record.HasField("odometry") for record in records)
    assert told.count("server", "frames refused") == 0


def test_odometry_of_another_clock_is_told(stage: Stage) -> None:
    robot, told, _ = with_wheels(stage)
    for second in range(1, 6):
        robot.odometry((100 + second) * SECOND_NS, 0.0, 0.0, 0.0)
        robot.compressed(second * SECOND_NS, IMAGES[second].read_bytes())
        time.sleep(0.05)
    until(lambda: told.count("server", "frames answered") == 5)
    assert told.level("odometry") == 1
    assert "frames go without odometry: /odom has none within 1 s" in told.message("odometry")


def test_what_waits_is_sent_before_the_bridge_ends(stage: Stage) -> None:
    robot, told, bridge = with_images(stage)
    for second in range(1, 61):
        robot.compressed(second * SECOND_NS, IMAGES[second - 1].read_bytes())
        time.sleep(0.01)
    until(lambda: told.count("images", "received") == 60)
    assert bridge.end(signal.SIGINT) == 0
    assert len(stage.client.frames("maps/hall/sessions/drive")) == 60
    assert "are lost" not in bridge.said()


def test_what_cannot_be_sent_before_the_bridge_ends_is_counted(stage: Stage) -> None:
    robot, told, bridge = with_images(stage)
    robot.compressed(1 * SECOND_NS, IMAGES[0].read_bytes())
    until(lambda: told.count("server", "frames answered") == 1)
    stage.server.kill()
    for second in range(2, 102):
        robot.compressed(second * SECOND_NS, IMAGES[second - 1].read_bytes())
        time.sleep(0.01)
    until(lambda: told.count("images", "received") == 101)
    waiting = told.count("server", "frames waiting")
    assert waiting > 0
    # Nobody answers: a second signal does not wait until that is given up.
    bridge.process.send_signal(signal.SIGTERM)
    until(lambda: "a second signal ends at once" in bridge.said())
    assert bridge.end(signal.SIGTERM) == 0
    assert f"{waiting} frames that were not sent are lost" in bridge.said()


def test_transforms_may_have_a_topic_outside_the_namespace(stage: Stage) -> None:
    robot = stage.robot("/robot1")
    told = Diagnostics(robot)
    flags = (*FLAGS, "--namespace", "robot1", "--tf-static-topic", "/tf_static", "--tf-topic", "/tf")
    stage.bridge(*flags)
    robot.camera_info(SIZE_PX, FOCAL_PX)
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    at = ros.Header(ros.Time.of(SECOND_NS), "base_link")
    mounted = ros.TransformStamped(at, "camera_optical", ros.Transform(ros.Vector3(0.2, 0.0, 0.4), OPTICAL))
    robot.publish("/tf_static", ros.TFMessage([mounted]), LATCHED)
    met(robot, COMPRESSED, "odom", "camera/camera_info", "/tf_static")
    robot.camera_info(SIZE_PX, FOCAL_PX)
    transforms = robot.listen("/tf", ros.TFMessage)
    drive(robot, range(1, 6))
    until(lambda: told.message("camera") == "declared", what=f"{told()}")
    until(transforms)
    [session] = stage.client.sessions("hall")
    assert session.camera.base_to_camera.position_m.z == pytest.approx(0.4)


def refused(tmp_path: Path, *flags: str) -> tuple[int, str]:
    ran = subprocess.run(
        [binary("waypost-ros"), *flags],
        env=environment(),
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    return ran.returncode, ran.stderr


def test_what_does_not_fit_is_refused_at_the_start(tmp_path: Path) -> None:
    assert refused(tmp_path) == (
        2,
        "waypost-ros: no map is named; give --map, or `map` in the file of --params; or --services for a"
        " robot that chooses it\n",
    )
    parameters = tmp_path / "robot.toml"
    parameters.write_text('map = "hall"\nimage_topics = "camera"\n')
    code, told = refused(tmp_path, "--params", str(parameters))
    assert code == 2
    assert "unknown field `image_topics`" in told
    assert "image_topic`" in told
    code, told = refused(tmp_path, "--map", "hall", "--namespace", "robot-1")
    assert code == 2
    assert "`/robot-1/camera/image_raw` is no name of ROS" in told


def test_a_map_that_is_not_there_ends_the_bridge(stage: Stage) -> None:
    bridge = stage.bridge("--map", "nowhere", "--camera-info-topic", "none")
    assert bridge.process.wait(30) == 4
    assert "nowhere" in bridge.said()
    assert "create" in bridge.said()
