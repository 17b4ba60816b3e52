"""`waypost stream` of bags that other programs wrote: each is decided as the folder of the same images."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from conftest import IMAGES, SECOND_NS, Server, answers, binary, decided, environment

import waypost
from waypost.v1 import geometry_pb2

#: They need Python 3.10.
rosbag1 = pytest.importorskip("rosbags.rosbag1")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
mcap_writer = pytest.importorskip("mcap.writer")
mcap_ros2 = pytest.importorskip("mcap_ros2.writer")

TOPIC = "/camera/image/compressed"
FRAME = "camera_optical"
HEADER_TEXT = "builtin_interfaces/Time stamp\nstring frame_id"
RULE = "=" * 80
IMAGE_TEXT = f"""std_msgs/Header header
string format
uint8[] data
{RULE}
MSG: std_msgs/Header
{HEADER_TEXT}
{RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def mcap(path: Path, compression: str) -> Path:
    """By Foxglove's packages, which write the messages, too."""
    path = path.with_suffix(".mcap")
    how = mcap_writer.CompressionType[compression]
    with path.open("wb") as file, mcap_ros2.Writer(file, compression=how) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/CompressedImage", IMAGE_TEXT)
        for second, image in enumerate(IMAGES, 1):
            message = {
                "header": {"stamp": {"sec": second, "nanosec": 0}, "frame_id": FRAME},
                "format": "jpeg",
                "data": image.read_bytes(),
            }
            at = second * SECOND_NS
            writer.write_message(TOPIC, schema, message, log_time=at, publish_time=at, sequence=second)
    return path


def rosbag2_folder(path: Path, storage: str, mode: str) -> Path:
    """As ROS 2 writes it: a folder with metadata."""
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    types = store.types
    writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[storage])
    if mode != "NONE":
        writer.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
    kind = "sensor_msgs/msg/CompressedImage"
    with writer:
        connection = writer.add_connection(TOPIC, kind, typestore=store)
        for second, image in enumerate(IMAGES, 1):
            stamp = types["builtin_interfaces/msg/Time"](sec=second, nanosec=0)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=FRAME)
            message = types[kind](header=header, format="jpeg", data=pixels(image))
            writer.write(connection, second * SECOND_NS, store.serialize_cdr(message, kind))
    return path


def rosbag1_file(path: Path, compression: str) -> Path:
    """As ROS 1 wrote it."""
    path = path.with_suffix(".bag")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    types = store.types
    writer = rosbag1.Writer(path)
    if compression != "NONE":
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
    kind = "sensor_msgs/msg/CompressedImage"
    with writer:
        connection = writer.add_connection(TOPIC, kind, typestore=store)
        for second, image in enumerate(IMAGES, 1):
            stamp = types["builtin_interfaces/msg/Time"](sec=second, nanosec=0)
            header = types["std_msgs/msg/Header"](seq=second, stamp=stamp, frame_id=FRAME)
            message = types[kind](header=header, format="jpeg", data=pixels(image))
            writer.write(connection, second * SECOND_NS, store.serialize_ros1(message, kind))
    return path


def pixels(image: Path) -> Any:
    return np.frombuffer(image.read_bytes(), dtype=np.uint8)


BAGS: dict[str, Callable[[Path], Path]] = {
    "mcap-none": lambda path: mcap(path, "NONE"),
    "mcap-lz4": lambda path: mcap(path, "LZ4"),
    "mcap-zstd": lambda path: mcap(path, "ZSTD"),
    "rosbag2-mcap": lambda path: rosbag2_folder(path, "MCAP", "NONE"),
    "db3-none": lambda path: rosbag2_folder(path, "SQLITE3", "NONE"),
    "db3-by-message": lambda path: rosbag2_folder(path, "SQLITE3", "MESSAGE"),
    "db3-by-file": lambda path: rosbag2_folder(path, "SQLITE3", "FILE"),
    "ros1-none": lambda path: rosbag1_file(path, "NONE"),
    "ros1-bz2": lambda path: rosbag1_file(path, "BZ2"),
    "ros1-lz4": lambda path: rosbag1_file(path, "LZ4"),
}


def called(*arguments: str | Path, server: str) -> subprocess.CompletedProcess[str]:
    command = [binary("waypost"), "--json", *arguments]
    # As a variable: what needs no server refuses the flag.
    variables = {**environment(), "WAYPOST_SERVER": server}
    return subprocess.run(command, env=variables, capture_output=True, text=True, check=False)


def run(*arguments: str | Path, server: str = "http://127.0.0.1:1") -> dict[str, Any]:
    ran = called(*arguments, server=server)
    assert ran.returncode == 0, ran.stderr
    printed: dict[str, Any] = json.loads(ran.stdout)
    return printed


def refused(*arguments: str | Path, server: str = "http://127.0.0.1:1") -> str:
    ran = called(*arguments, server=server)
    assert ran.returncode == 1, ran.stderr
    return ran.stderr


def streamed(server: Server, client: waypost.Client, map_id: str, images: Path) -> list[dict[str, Any]]:
    """The decisions about all frames, but for the names of map and images and what is of the moment."""
    client.create_map(map_id, "shipped")
    summary = run("stream", images, "--map", map_id, "--session", "drive", server=f"http://{server.address}")
    assert (summary["frame_count"], summary["refused"]) == (len(IMAGES), 0)
    rows = json.loads(json.dumps(summary["frames"]).replace(f"maps/{map_id}/", "maps/M/"))
    # A folder's frames bear their files' names.
    names = {"image", "match_note"}
    return [
        {name: value for name, value in row.items() if name not in names and not name.endswith("_ms")}
        for row in rows
    ]


@pytest.fixture(scope="module")
def of_the_folder(server: Server) -> list[dict[str, Any]]:
    with waypost.connect(server.address) as client:
        decisions = streamed(server, client, "folder", IMAGES[0].parent)
    assert any(decision["reason"] == "loop_closure" for decision in decisions)
    return decisions


@pytest.mark.parametrize("name", BAGS)
def test_a_bag_is_decided_as_its_images_are(
    name: str, tmp_path: Path, server: Server, client: waypost.Client, of_the_folder: list[dict[str, Any]]
) -> None:
    bag = BAGS[name](tmp_path / "drive")
    inspected = run("inspect", bag)
    [topic] = inspected["topics"]
    assert (topic["name"], topic["messages"], topic["form"]) == (TOPIC, len(IMAGES), "jpeg")
    assert topic["rate_hz"] == pytest.approx(1.0)
    assert streamed(server, client, name, bag) == of_the_folder


SIZE_PX = (640, 360)
DRIVEN = 40


def robots_bag(
    path: Path, seconds: range, begun_s: int = 0, wheels: Callable[[int], int] = lambda second: second
) -> Path:
    """A drive of a robot with wheels and a calibrated camera, as ROS 2 records it."""
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    kinds = {kind.rsplit("/", 1)[-1]: value for kind, value in store.types.items()}
    vector, quaternion = kinds["Vector3"], kinds["Quaternion"]

    def header(second: int, frame: str) -> Any:
        stamp = kinds["Time"](sec=begun_s + second, nanosec=0)
        return kinds["Header"](stamp=stamp, frame_id=frame)

    def joint(parent: str, child: str, moved: Any, turned: Any) -> Any:
        transform = kinds["Transform"](translation=moved, rotation=turned)
        return kinds["TransformStamped"](header(1, parent), child, transform)

    width, height = SIZE_PX
    camera = kinds["CameraInfo"](
        header=header(1, FRAME),
        height=height,
        width=width,
        distortion_model="plumb_bob",
        d=np.array([0.05, -0.02, 0.0, 0.0, 0.0]),
        k=np.array([520.0, 0.0, 320.0, 0.0, 521.0, 180.0, 0.0, 0.0, 1.0]),
        r=np.eye(3).ravel(),
        p=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=kinds["RegionOfInterest"](0, 0, 0, 0, False),
    )
    still, optical = quaternion(0.0, 0.0, 0.0, 1.0), quaternion(-0.5, 0.5, -0.5, 0.5)
    mount = kinds["TFMessage"](
        [
            joint("base_link", "camera", vector(0.25, 0.0, 0.5), still),
            joint("camera", FRAME, vector(0.0, 0.0, 0.0), optical),
        ]
    )
    writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
    with writer:

        def topic(name: str, kind: str) -> Callable[[int, Any], None]:
            connection = writer.add_connection(name, kind, typestore=store)
            return lambda at, message: writer.write(connection, at, store.serialize_cdr(message, kind))

        topic("/tf_static", "tf2_msgs/msg/TFMessage")(SECOND_NS, mount)
        topic("/camera/camera_info", "sensor_msgs/msg/CameraInfo")(SECOND_NS, camera)
        write_image = topic("/camera/image/compressed", "sensor_msgs/msg/CompressedImage")
        write_odometry = topic("/odom", "nav_msgs/msg/Odometry")
        for second in seconds:
            data = pixels(IMAGES[second - 1])
            image = kinds["CompressedImage"](header(second, FRAME), "jpeg", data)
            write_image(second * SECOND_NS, image)
            pose = kinds["Pose"](kinds["Point"](x_m(second), 0.0, 0.0), still)
            zero = kinds["Twist"](vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0))
            odometry = kinds["Odometry"](
                header(wheels(second), "odom"),
                "base_link",
                kinds["PoseWithCovariance"](pose, np.zeros(36)),
                kinds["TwistWithCovariance"](zero, np.zeros(36)),
            )
            write_odometry(second * SECOND_NS + 1, odometry)
    return path


def x_m(second: int) -> float:
    return 0.25 * second


def robots_camera() -> geometry_pb2.Camera:
    """What the client library would declare of the same robot."""
    width, height = SIZE_PX
    pinhole = geometry_pb2.Pinhole(fx_px=520, fy_px=521, cx_px=320, cy_px=180)
    pinhole.distortion.extend([0.05, -0.02, 0.0, 0.0, 0.0])
    pose = geometry_pb2.Pose(
        position_m=geometry_pb2.Vector3(x=0.25, y=0.0, z=0.5), orientation=geometry_pb2.Quaternion(w=1.0)
    )
    return geometry_pb2.Camera(
        pinhole=pinhole, image_width_px=width, image_height_px=height, base_to_camera=pose
    )


def frames_with_odometry(numbers: range) -> list[waypost.Frame]:
    return [
        waypost.Frame(
            sequence=number,
            stamp_ns=number * SECOND_NS,
            image=IMAGES[number - 1].read_bytes(),
            odometry=waypost.Pose3((x_m(number), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        )
        for number in numbers
    ]


def test_odometry_and_camera_of_a_bag_are_what_a_robot_would_send(
    tmp_path: Path, server: Server, client: waypost.Client
) -> None:
    numbers = range(1, DRIVEN + 1)
    for map_id in ("from-bag", "from-robot"):
        client.create_map(map_id, "shipped")
    at = f"http://{server.address}"
    # Half of it first, as if the stream had been stopped there: the whole goes on from it.
    half, whole = (
        robots_bag(tmp_path / "half", range(1, DRIVEN // 2)),
        robots_bag(tmp_path / "whole", numbers),
    )
    first = run("stream", half, "--map", "from-bag", "--session", "drive", server=at)
    assert (first["resumed_after_sequence"], first["refused"]) == (None, 0)
    rest = run("stream", whole, "--map", "from-bag", "--session", "drive", server=at)
    assert (rest["resumed_after_sequence"], rest["refused"]) == (DRIVEN // 2 - 1, 0)
    assert rest["frame_count"] == DRIVEN
    with client.session("from-robot", "drive", camera=robots_camera()) as session:
        sent = list(session.stream(frames_with_odometry(numbers)))
    assert [outcome.sequence for outcome in sent if isinstance(outcome, waypost.Answer)] == list(numbers)
    # Asked for again, both give what is stored.
    stored = {}
    for map_id in ("from-bag", "from-robot"):
        with client.session(map_id, "drive") as session:
            stored[map_id] = repr([decided(answer) for answer in answers(session, numbers)])
    assert stored["from-bag"].replace("from-bag", "from-robot") == stored["from-robot"]
    # Where the camera was hangs on odometry, the closures and the place of the camera on the robot.
    for of in (["--frame", "odom"], ["--body", "camera"]):
        tracks = {}
        for map_id in ("from-bag", "from-robot"):
            file = tmp_path / f"{map_id}{of[1]}.tum"
            run("map", "trajectory", map_id, "drive", "--out", file, *of, server=at)
            tracks[map_id] = file.read_text()
        assert tracks["from-bag"] == tracks["from-robot"]
        # Frames that the map does not place are in neither.
        assert tracks["from-bag"].count("\n") > DRIVEN * 3 // 4


def test_a_clock_of_odometry_that_goes_wrong_is_told(
    tmp_path: Path, server: Server, client: waypost.Client
) -> None:
    client.create_map("clocks", "shipped")
    at = f"http://{server.address}"

    def told(name: str, wheels: Callable[[int], int]) -> tuple[str, str]:
        bag = robots_bag(tmp_path / name, range(1, 11), begun_s=1000, wheels=wheels)
        [problem] = run("inspect", bag)["problems"]
        ran = called("stream", bag, "--map", "clocks", "--session", name, server=at)
        assert ran.returncode == 0, ran.stderr
        return problem, ran.stderr

    problem, said = told("spike", lambda second: 10**6 if second == 4 else second)
    assert "odometry of /odom: 1 message is left out, number 4: its stamp 1001000000000000" in problem
    # The one before and the one after are two seconds apart.
    assert "1 of 10 frames are sent without odometry: around 1 of them no two poses are at most 1 s" in said
    problem, said = told("back", lambda second: second if second < 6 else second - 500)
    assert "odometry of /odom: its clock was set back by 499.000 s, at message 6" in problem
    assert "5 of 10 frames are sent without odometry: 5 have stamps before or after those of odometry" in said
    assert "odometry, whose clock was set back; places" in said


def test_another_bag_does_not_go_on_in_the_session_of_one(
    tmp_path: Path, server: Server, client: waypost.Client
) -> None:
    client.create_map("resumed", "shipped")
    into = ["--map", "resumed", "--session", "drive"]
    at = f"http://{server.address}"
    first = robots_bag(tmp_path / "first", range(1, 8))
    assert run("stream", first, *into, server=at)["refused"] == 0
    # Another day.
    other = robots_bag(tmp_path / "other", range(1, 12), begun_s=86_400)
    told = refused("stream", other, *into, server=at)
    assert "was begun with another bag: its frame 1 is of 1000000000 ns" in told
    assert "here it is of 86401000000000 ns; give the bag that it was begun with" in told
    # The same times, and other images: as of the other camera of a pair.
    shifted = IMAGES[20:]
    images, IMAGES[:] = list(IMAGES), [*shifted, *IMAGES[:20]]
    try:
        camera = robots_bag(tmp_path / "camera", range(1, 12))
    finally:
        IMAGES[:] = images
    told = refused("stream", camera, *into, server=at)
    assert "was begun with another bag: its frame 7 shows something else" in told
    assert len(list(client.frames("maps/resumed/sessions/drive"))) == 7


def test_a_bag_is_imported_into_a_session_of_its_name(
    tmp_path: Path, server: Server, client: waypost.Client
) -> None:
    client.create_map("imported", "shipped")
    at = f"http://{server.address}"
    bag = robots_bag(tmp_path / "drive", range(1, 8))
    # Twice: it is there once.
    for _ in range(2):
        assert run("import", bag, "--map", "imported", server=at)["refused"] == 0
    [session] = client.sessions("imported")
    assert session.name == f"maps/imported/sessions/{bag.stem.lower()}"
    assert len(list(client.frames(session.name))) == 7


def test_what_does_not_fit_is_refused_with_a_way_out(tmp_path: Path, server: Server) -> None:
    bag = robots_bag(tmp_path / "drive", range(1, 4))
    at = f"http://{server.address}"
    told = refused("stream", bag, "--map", "m", "--odometry", tmp_path / "o.csv", server=at)
    assert "a bag brings its own odometry" in told
    images = IMAGES[0].parent
    told = refused("stream", images, "--map", "m", "--image-topic", "/camera", server=at)
    assert "--image-topic is for bags" in told
    told = refused("stream", bag, "--map", "m", "--image-topic", "/cam", server=at)
    assert "there is no topic /cam; the bag has /camera/camera_info, /camera/image/compressed" in told
    told = refused("inspect", bag, "--image-topic", "/cam", server=at)
    assert "there is no topic /cam" in told
    told = refused("import", images, "--map", "m", server=at)
    assert f"`waypost stream {images} --map m`" in told
    cut = tmp_path / "cut.mcap"
    # These have CRCs.
    whole = mcap(tmp_path / "whole", "NONE").read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    inspected = run("inspect", cut)
    assert any("is cut off at byte" in problem for problem in inspected["problems"])
    damaged = bytearray(whole)
    damaged[len(whole) // 2] ^= 1
    cut.write_bytes(damaged)
    assert "is damaged at byte" in refused("inspect", cut)
