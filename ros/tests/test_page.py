"""Each command of the page about ROS 2 that starts the bridge, as it stands there."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import ros_types as ros
from conftest import (
    FOCAL_PX,
    IMAGES,
    PATIENCE_S,
    REPOSITORY,
    SIZE_PX,
    Diagnostics,
    Stage,
    binary,
    environment,
    met,
    way,
)
from PIL import Image as Picture
from robot import LOSSLESS, SECOND_NS, Robot, until
from test_services import Asking

PAGE = (REPOSITORY / "docs" / "guide" / "src" / "ros2.md").read_text()
COMMAND = re.compile(r"^target/release/waypost-ros([^#\n]*)", re.MULTILINE)
#: The robot that a peer plays, for the command that waits for it.
PLAYED = re.compile(r"^PYTHONPATH=(\S+) target/python/bin/python (\S+) \S+/images$", re.MULTILINE)
#: A file that the page writes: its name, and what is in it.
WRITTEN = re.compile(r"^cat > (\S+) <<'TOML'\n(.*?)^TOML$", re.MULTILINE | re.DOTALL)
#: So many of the page's commands there are at least.
LEAST = 8
TAUGHT = 30


def commands() -> list[list[str]]:
    found = [shlex.split(match[1]) for match in COMMAND.finditer(PAGE)]
    assert len(found) >= LEAST, "the page's commands are not found"
    return found


def is_beside_another(command: list[str]) -> bool:
    return command[-1:] == ["&"]


def raw(stamp_ns: int, image: Path) -> ros.Image:
    with Picture.open(image) as seen:
        pixels = list(seen.convert("RGB").tobytes())
    width, height = SIZE_PX
    return ros.Image(
        ros.Header(ros.Time.of(stamp_ns), "camera_optical"), height, width, "rgb8", 0, 3 * width, pixels
    )


def teach(stage: Stage, folder: Path) -> None:
    """The map has a drive by then, along which a robot is found."""
    images = folder / "images"
    images.mkdir()
    for image in IMAGES[:TAUGHT]:
        shutil.copy(image, images)
    command = [binary("waypost"), "--server", f"http://{stage.server.address}", "stream", images]
    subprocess.run(
        [*command, "--map", "hall", "--session", "taught"],
        env=environment(),
        check=True,
        stdout=subprocess.DEVNULL,
    )


def drives(robot: Robot, topics: tuple[str, str, str], told: Diagnostics) -> None:
    """The robot is driven until the server has answered some of its frames."""
    image, camera, odometry = topics
    packed = image.endswith("compressed")
    robot.advertise(image, ros.CompressedImage if packed else ros.Image, LOSSLESS)
    robot.advertise(odometry, ros.Odometry, LOSSLESS)
    robot.camera_info(SIZE_PX, FOCAL_PX, camera)
    robot.mounting()
    met(robot, image, odometry, camera)
    second = 0

    def answered() -> bool:
        nonlocal second
        second += 1
        # With each image, as cameras do: the first one may come before the bridge knows who sends it.
        robot.camera_info(SIZE_PX, FOCAL_PX, camera)
        robot.odometry(second * SECOND_NS, *way(second), odometry)
        shown = IMAGES[second % TAUGHT]
        if packed:
            robot.compressed(second * SECOND_NS, shown.read_bytes(), image)
        else:
            robot.publish(image, raw(second * SECOND_NS, shown), LOSSLESS)
        return told.count("server", "frames answered") >= 3

    until(answered, 30.0, what=f"{told()}")


@pytest.mark.parametrize("flags", [each for each in commands() if not is_beside_another(each)], ids=" ".join)
def test_what_the_page_tells_one_to_run_runs(stage: Stage, tmp_path: Path, flags: list[str]) -> None:
    given = dict(zip(flags, [*flags[1:], ""], strict=True))
    for name, content in WRITTEN.findall(PAGE):
        (tmp_path / name).write_text(content)
        if name in flags:
            flags = [str(tmp_path / name) if flag == name else flag for flag in flags]
            parameters = tomllib.loads(content)
            given |= {f"--{key.replace('_', '-')}": str(value) for key, value in parameters.items()}
    if "--localize" in given:
        teach(stage, tmp_path)
    # The port may be somebody's.
    flags = [re.sub(r"^127\.0\.0\.1:\d+$", "127.0.0.1:0", flag) for flag in flags]
    namespace = given.get("--namespace", "")
    robot = stage.robot(f"/{namespace}" if namespace else "")
    told = Diagnostics(robot)
    bridge = stage.bridge(*flags)
    if "--services" in given:
        until(lambda: "no map is chosen" in told.message("server"))
        asking = Asking.of(robot)
        assert asking.parameters(map="hall") == [(True, "")]
    image = given.get("--image-topic", "camera/image_raw")
    camera = f"{image.removesuffix('/compressed').rpartition('/')[0]}/camera_info"
    drives(robot, (image, camera, given.get("--odometry-topic", "odom")), told)
    if "--drive" in given:
        until(lambda: told.message("navigation") != "", what=bridge.said())
    if "--services" in given:
        assert asking.localize(True).success
        assert asking.finish().success
    if "--foxglove" in given:
        assert "ws://127.0.0.1:" in bridge.said()
    named = given.get("--session", "")
    assert f"{named} is open" in bridge.said()
    assert bridge.end() == 0


def test_a_peer_plays_a_robot(stage: Stage, tmp_path: Path) -> None:
    [flags] = [command[:-1] for command in commands() if is_beside_another(command)]
    [(modules, program)] = PLAYED.findall(PAGE)
    drive = tmp_path / "drive"
    drive.mkdir()
    for image in IMAGES[:10]:
        shutil.copy(image, drive)
    bridge = stage.bridge(*flags)
    playing = {"PYTHONPATH": str(REPOSITORY / modules), "ROS_DOMAIN_ID": str(stage.domain)}
    subprocess.run(
        [sys.executable, REPOSITORY / program, drive],
        env=environment() | playing,
        check=True,
        timeout=PATIENCE_S,
    )

    def frames() -> int:
        return len(list(stage.client.frames("maps/hall/sessions/played")))

    until(lambda: frames() == 10, what=bridge.said())
    assert bridge.end() == 0
