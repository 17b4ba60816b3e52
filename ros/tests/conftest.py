"""A real server, the bridge, and a robot that another implementation of DDS plays."""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import signal
import statistics
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

if importlib.util.find_spec("cyclonedds") is None:
    pytest.exit("cyclonedds, which plays the robot, is there for Python 3.10 and later: nothing is run", 0)

import ros_types as ros
import waypost
from robot import SECOND_NS, Robot, until

REPOSITORY = Path(__file__).resolve().parents[2]
MODEL = REPOSITORY / "demo" / "model.waypost"
IMAGES = sorted((REPOSITORY / "demo" / "sequence" / "images").glob("*.jpg"))
#: Of the images.
SIZE_PX = (640, 360)
FOCAL_PX = 520.0
#: Far more than a start or a stop takes.
PATIENCE_S = 60.0
COMPRESSED = "camera/image_raw/compressed"
#: Each test has a domain of its own, apart from those of other runs and of robots nearby; not above 101, where a domain's
#: ports are those that Linux gives to anybody.
DOMAINS = (1 + (os.getpid() + number) % 101 for number in itertools.count())


def binary(name: str) -> Path:
    """A program as built from this repository."""
    target = Path(os.environ.get("CARGO_TARGET_DIR") or REPOSITORY / "target") / "release"
    folders = [
        Path(os.environ[name])
        for name in ("WAYPOST_ROS_BINARIES", "WAYPOST_BINARIES")
        if os.environ.get(name)
    ]
    for folder in [*folders, target]:
        if (folder / name).is_file():
            return folder / name
    pytest.exit(f"{name} is missing: run `make build`, or say in WAYPOST_BINARIES where it is", 3)


def tell(figures: dict[str, Any]) -> None:
    """Prints what was measured, and keeps it for who asks for it by a file of theirs, in WAYPOST_FIGURES."""
    print(json.dumps(figures))
    if kept := os.environ.get("WAYPOST_FIGURES"):
        with Path(kept).open("a") as file:
            file.write(f"{json.dumps(figures)}\n")


def p50_and_p99(values: list[float]) -> list[float]:
    return [statistics.median(values), sorted(values)[int(0.99 * len(values))]]


def environment() -> dict[str, str]:
    """This one without settings for Waypost and ROS."""
    ours = ("WAYPOST_", "ROS_", "RUST_LOG", "CYCLONEDDS_")
    return {name: value for name, value in os.environ.items() if not name.startswith(ours)}


@dataclass
class Server:
    """`waypost-server` in a process of its own."""

    data_dir: Path
    address: str = "127.0.0.1:0"
    http_address: str = ""
    process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """On a free port the first time, then on the same."""
        ready, log = self.data_dir.with_suffix(".ready"), self.data_dir.with_suffix(".log")
        ready.unlink(missing_ok=True)
        command: list[str | Path] = [binary("waypost-server"), "--data-dir", self.data_dir]
        command += ["--ready-file", ready, "--grpc-address", self.address, "--http-address", "127.0.0.1:0"]
        with log.open("wb") as stderr:
            self.process = subprocess.Popen(command, env=environment(), stdout=stderr, stderr=stderr)
        deadline = time.monotonic() + PATIENCE_S
        while not ready.exists():
            if self.process.poll() is not None or time.monotonic() > deadline:
                self.kill()
                pytest.fail(f"the server did not start:\n{log.read_text()}")
            time.sleep(0.005)
        told = json.loads(ready.read_text())
        self.address, self.http_address = told["grpc"], told["http"]

    def kill(self) -> None:
        """`kill -9`."""
        if self.process is not None:
            self.process.kill()
            self.process.wait(PATIENCE_S)
            self.process = None


@dataclass
class Bridge:
    """`waypost-ros` in a process of its own, on this machine alone."""

    domain: int
    server: str
    log: Path
    flags: tuple[str, ...]
    process: subprocess.Popen[bytes] = field(init=False)

    def __post_init__(self) -> None:
        command: list[str | Path] = [binary("waypost-ros"), "--domain", str(self.domain)]
        command += ["--network", "127.0.0.1", "--server", self.server, *self.flags]
        with self.log.open("wb") as stderr:
            self.process = subprocess.Popen(command, env=environment(), stderr=stderr)

    def said(self) -> str:
        return self.log.read_text()

    def end(self, how: signal.Signals = signal.SIGTERM) -> int:
        """Its exit code."""
        self.process.send_signal(how)
        return self.process.wait(PATIENCE_S)


@dataclass
class Stage:
    """A robot, the bridge and the server, which find each other without multicast."""

    server: Server
    client: waypost.Client
    folder: Path
    domain: int = field(default_factory=lambda: next(DOMAINS))
    robots: list[Robot] = field(default_factory=list)
    bridges: list[Bridge] = field(default_factory=list)

    def robot(self, namespace: str = "") -> Robot:
        robot = Robot(self.domain, namespace, self.robots[0] if self.robots else None)
        self.robots.append(robot)
        return robot

    def bridge(self, *flags: str, server: str | None = None) -> Bridge:
        log = self.folder / f"bridge{len(self.bridges)}.log"
        bridge = Bridge(self.domain, server or f"http://{self.server.address}", log, flags)
        self.bridges.append(bridge)
        return bridge

    def close(self) -> None:
        for bridge in self.bridges:
            if bridge.process.poll() is None:
                bridge.process.kill()
                bridge.process.wait(PATIENCE_S)
        for robot in self.robots:
            robot.close()


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    """A server of the test's own, which it may kill, that knows the shipped model as `shipped`."""
    server = Server(tmp_path / "data")
    server.start()
    try:
        with waypost.connect(server.address) as client:
            client.import_model(MODEL, "shipped")
        yield server
    finally:
        server.kill()


@pytest.fixture
def stage(server: Server, tmp_path: Path) -> Iterator[Stage]:
    with waypost.connect(server.address) as client:
        client.create_map("hall", "shipped")
        stage = Stage(server, client, tmp_path)
        try:
            yield stage
        finally:
            stage.close()


class Diagnostics:
    """What the bridge says of itself, by the part of it."""

    def __init__(self, robot: Robot) -> None:
        self._listen = robot.listen("/diagnostics", ros.DiagnosticArray)
        self._latest: dict[str, ros.DiagnosticStatus] = {}

    def __call__(self) -> dict[str, ros.DiagnosticStatus]:
        for message in self._listen():
            self._latest = {status.name.removeprefix("waypost: "): status for status in message.status}
        return self._latest

    def forget(self) -> None:
        """What was said before counts no more."""
        self()
        self._latest = {}

    def value(self, part: str, key: str) -> str:
        status = self().get(part)
        values = {value.key: value.value for value in status.values} if status else {}
        return values.get(key, "")

    def count(self, part: str, key: str) -> int:
        return int(self.value(part, key) or 0)

    def message(self, part: str) -> str:
        status = self().get(part)
        return status.message if status else ""

    def level(self, part: str) -> int:
        """0 is well, 1 a warning, 2 an error; -1 if nothing was said."""
        status = self().get(part)
        return -1 if status is None else as_number(status.level)


def as_number(level: Any) -> int:
    """An octet, which Cyclone gives as bytes or as a number."""
    return level[0] if isinstance(level, (bytes, bytearray)) else int(level)


def way(second: int) -> tuple[float, float, float]:
    """x, y and heading of a made-up drive: half a metre a second, gently to the left."""
    return 0.5 * second, 0.01 * second * second, 0.04 * second


def drive(robot: Robot, seconds: range, topic: str = COMPRESSED, pause_s: float = 0.02) -> None:
    """Sends images of the shipped sequence, again and again, with the odometry of a made-up drive."""
    for second in seconds:
        robot.compressed(second * SECOND_NS, IMAGES[(second - 1) % len(IMAGES)].read_bytes(), topic)
        robot.odometry(second * SECOND_NS, *way(second))
        time.sleep(pause_s)


def met(robot: Robot, *topics: str) -> None:
    """Waits until the bridge hears these topics."""
    for topic in topics:
        until(lambda topic=topic: robot.is_heard(topic), what=f"nobody reads {topic}")
    # The robot knows of the bridge before that knows of the robot's topics, and drops what comes until it does.
    time.sleep(1.0)
