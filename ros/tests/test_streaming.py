"""What a robot sends over DDS is decided as if it were streamed directly."""

from __future__ import annotations

import io
import subprocess
import time

import ros_types as ros
import waypost
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
    way,
)
from PIL import Image as Picture
from robot import LOSSLESS, SECOND_NS, turned, until
from waypost.v1 import geometry_pb2, session_pb2

#: Nothing is lost on the way, so that a test may count.
FLAGS = ("--map", "hall", "--session", "drive", "--image-topic", COMPRESSED, "--most-hz", "0")
FLAGS += ("--sensor-qos", "reliable")


def decided(stage: Stage, map_id: str) -> list[str]:
    """All frames of a map's drive, but for what is of the moment and the names of map and files."""

    def bare(record: session_pb2.FrameRecord) -> str:
        record.note = ""
        record.answer.ClearField("timings")
        for match in (record.answer.match, record.answer.best_candidate):
            match.frame.note = ""
        return str(record).replace(f"maps/{map_id}/", "maps/M/")

    return [bare(record) for record in stage.client.frames(f"maps/{map_id}/sessions/drive")]


def test_the_demo_is_decided_as_its_folder_is(stage: Stage) -> None:
    robot = stage.robot()
    told = Diagnostics(robot)
    stage.bridge(*FLAGS, "--camera-info-topic", "none", "--odometry-topic", "none")
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    met(robot, COMPRESSED)
    for second, image in enumerate(IMAGES, 1):
        robot.compressed(second * SECOND_NS, image.read_bytes())
        time.sleep(0.02)
    until(
        lambda: told.count("server", "frames answered") == len(IMAGES),
        timeout_s=90.0,
        what="frames are missing",
    )
    stage.client.create_map("direct", "shipped")
    command = [binary("waypost"), "--server", f"http://{stage.server.address}", "stream", IMAGES[0].parent]
    command += ["--map", "direct", "--session", "drive"]
    subprocess.run(command, env=environment(), check=True, stdout=subprocess.DEVNULL)
    over_dds = decided(stage, "hall")
    assert len(over_dds) == len(IMAGES)
    assert over_dds == decided(stage, "direct")
    assert told.count("server", "loop closures") > 0


def test_odometry_and_camera_are_what_a_client_would_send(stage: Stage) -> None:
    seconds = range(1, 41)
    robot = stage.robot()
    told = Diagnostics(robot)
    stage.bridge(*FLAGS)
    robot.camera_info(SIZE_PX, FOCAL_PX)
    robot.mounting()
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, COMPRESSED, "odom", "camera/camera_info", "/tf_static")
    # A driver says it again and again.
    robot.camera_info(SIZE_PX, FOCAL_PX)
    drive(robot, seconds)
    until(lambda: told.count("server", "frames answered") == len(seconds), what="frames are missing")
    assert told.count("server", "frames without odometry") == 0
    stage.client.create_map("direct", "shipped")
    with stage.client.session("direct", "drive", camera=camera()) as session:
        outcomes = list(session.stream(frame(second) for second in seconds))
    assert all(isinstance(outcome, waypost.Answer) for outcome in outcomes)
    over_dds, directly = (
        stage.client.session_record(f"maps/{map_id}/sessions/drive") for map_id in ("hall", "direct")
    )
    assert str(over_dds.camera) == str(directly.camera)
    assert over_dds.camera.base_to_camera.position_m.z == 0.5
    assert decided(stage, "hall") == decided(stage, "direct")


def camera() -> geometry_pb2.Camera:
    """What the client library would declare of the same robot."""
    width, height = SIZE_PX
    pinhole = geometry_pb2.Pinhole(fx_px=FOCAL_PX, fy_px=FOCAL_PX, cx_px=width / 2, cy_px=height / 2)
    pinhole.distortion.extend([0.0] * 5)
    pose = geometry_pb2.Pose(
        position_m=geometry_pb2.Vector3(x=0.25, y=0.0, z=0.5), orientation=geometry_pb2.Quaternion(w=1.0)
    )
    return geometry_pb2.Camera(
        pinhole=pinhole, image_width_px=width, image_height_px=height, base_to_camera=pose
    )


def frame(second: int) -> waypost.Frame:
    x, y, yaw = way(second)
    turn = turned(yaw)
    odometry = waypost.Pose3((x, y, 0.0), (turn.x, turn.y, turn.z, turn.w))
    image = IMAGES[second - 1].read_bytes()
    return waypost.Frame(sequence=second, stamp_ns=second * SECOND_NS, image=image, odometry=odometry)


def test_raw_pixels_of_a_best_effort_driver_arrive(stage: Stage) -> None:
    robot = stage.robot()
    told = Diagnostics(robot)
    stage.bridge("--map", "hall", "--camera-info-topic", "none", "--odometry-topic", "none", "--most-hz", "0")
    robot.advertise("camera/image_raw", ros.Image)
    met(robot, "camera/image_raw")
    for second in range(1, 11):
        picture = Picture.open(io.BytesIO(IMAGES[second - 1].read_bytes())).convert("RGB")
        header = ros.Header(ros.Time.of(second * SECOND_NS), "camera_optical")
        width, height = picture.size
        pixels = list(picture.tobytes())
        robot.publish("camera/image_raw", ros.Image(header, height, width, "rgb8", 0, 3 * width, pixels))
        time.sleep(0.05)
    # Best effort may lose what the system's buffers cannot hold; most have to come.
    until(lambda: told.count("server", "frames answered") >= 5, what="hardly a frame came")
    assert told.count("server", "frames refused") == 0


def test_a_bridge_that_is_started_again_goes_on(stage: Stage) -> None:
    robot = stage.robot()
    told = Diagnostics(robot)
    for first, last in ((1, 10), (11, 20)):
        bridge = stage.bridge(*FLAGS, "--camera-info-topic", "none")
        robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
        robot.advertise("odom", ros.Odometry, LOSSLESS)
        met(robot, COMPRESSED, "odom")
        drive(robot, range(first, last + 1))
        until(
            lambda: told.count("server", "frames answered") == 10,
            timeout_s=90.0,
            what="frames are missing",
        )
        assert bridge.end() == 0, bridge.said()
        # A farewell that is lost, as on a busy machine, is made up for by the end of its lease.
        until(
            lambda: not robot.is_heard(COMPRESSED),
            timeout_s=150.0,
            what="the bridge is not believed to be gone",
        )
        robot.forget(COMPRESSED, "odom")
        told.forget()
    records = stage.client.frames("maps/hall/sessions/drive")
    assert [record.stamp_ns for record in records] == [second * SECOND_NS for second in range(1, 21)]
