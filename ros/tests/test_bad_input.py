"""What is missing or wrong is told, in the log and in the diagnostics, with what mends it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
import ros_types as ros
from conftest import (
    COMPRESSED,
    FOCAL_PX,
    IMAGES,
    SIZE_PX,
    Diagnostics,
    Stage,
    binary,
    drive,
    environment,
    met,
)
from robot import DEFAULT, LOSSLESS, SECOND_NS, SENSOR, until

FLAGS = ("--map", "hall", "--session", "drive", "--image-topic", COMPRESSED, "--sensor-qos", "reliable")


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
    assert "nothing on tf_static joins base_link and camera_optical" in told.message("camera")
    [session] = stage.client.sessions("hall")
    assert session.camera.pinhole.fx_px == FOCAL_PX
    assert not session.camera.HasField("base_to_camera")


def test_a_gap_in_odometry_makes_frames_without_and_no_poses_up(stage: Stage) -> None:
    robot = stage.robot()
    told = Diagnostics(robot)
    stage.bridge(*FLAGS, "--camera-info-topic", "none", "--most-hz", "0")
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, COMPRESSED, "odom")
    robot.odometry(1 * SECOND_NS, 0.0, 0.0, 0.0)
    for second in (2, 3):
        robot.compressed(second * SECOND_NS, IMAGES[second - 1].read_bytes())
    robot.odometry(4 * SECOND_NS, 1.0, 0.0, 0.0)
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
    robot = stage.robot()
    told = Diagnostics(robot)
    stage.bridge(*FLAGS, "--camera-info-topic", "none", "--odometry-topic", "none", "--most-hz", "0")
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    met(robot, COMPRESSED)
    image = IMAGES[0].read_bytes()
    robot.compressed(1 * SECOND_NS, image)
    robot.compressed(1 * SECOND_NS, image)
    robot.compressed(0, image)
    robot.compressed(2 * SECOND_NS, b"GIF89a")
    robot.compressed(3 * SECOND_NS, image)
    until(lambda: told.count("server", "frames answered") == 2)
    until(lambda: told.count("images", "left out") == 3)
    assert told.level("images") == 1
    assert "neither JPEG nor PNG" in told.message("images")


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
