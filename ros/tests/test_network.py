"""Robots on other machines, and connections that break."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import ros_types as ros
from conftest import (
    COMPRESSED,
    DOMAINS,
    PATIENCE_S,
    Diagnostics,
    Server,
    Stage,
    binary,
    drive,
    environment,
    met,
    way,
)
from robot import LOSSLESS, SECOND_NS, until
from test_bad_input import refused

NEAR, FAR = "waypost-near", "waypost-far"
FLAGS = ("--map", "hall", "--session", "drive", "--image-topic", COMPRESSED, "--camera-info-topic", "none")
FLAGS += ("--sensor-qos", "reliable", "--most-hz", "0")


def ip(*arguments: str) -> None:
    ran = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    if ran.returncode != 0:
        raise PermissionError(f"ip {' '.join(arguments)}: {ran.stderr.strip()}")


@pytest.fixture
def two_machines() -> Iterator[None]:
    """Two network namespaces with a cable between them: nothing but the network joins who is in them."""
    if shutil.which("ip") is None:
        pytest.skip("there is no `ip` to make network namespaces with: install iproute2")
    try:
        for name in (NEAR, FAR):
            ip("netns", "add", name)
        ip("link", "add", "cable0", "netns", NEAR, "type", "veth", "peer", "name", "cable1", "netns", FAR)
        for name, cable, address in ((NEAR, "cable0", "10.77.0.1/24"), (FAR, "cable1", "10.77.0.2/24")):
            ip("-n", name, "address", "add", address, "dev", cable)
            ip("-n", name, "link", "set", "lo", "up")
            ip("-n", name, "link", "set", cable, "up")
            ip("-n", name, "route", "add", "224.0.0.0/4", "dev", cable)
    except PermissionError as refused:
        pytest.skip(f"network namespaces may not be made here: {refused}")
    else:
        yield
    finally:
        for name in (NEAR, FAR):
            with contextlib.suppress(PermissionError):
                ip("netns", "delete", name)


def seen_far(tmp_path: Path, domain: str, bridge_flags: tuple[str, ...], robot: tuple[str, ...] = ()) -> str:
    """What a robot on the other machine prints of a bridge on this one."""
    # Nobody answers there: what is shown is that frames come to the bridge.
    command = ["ip", "netns", "exec", NEAR, binary("waypost-ros"), "--domain", domain, *FLAGS]
    command += ["--server", "http://127.0.0.1:1", *bridge_flags]
    log = tmp_path / "bridge.log"
    with log.open("wb") as stderr:
        bridge = subprocess.Popen(command, env=environment(), stderr=stderr)
    try:
        far = ["ip", "netns", "exec", FAR, sys.executable, Path(__file__).with_name("far_robot.py"), domain]
        far += robot
        ran = subprocess.run(
            far, env=environment(), capture_output=True, text=True, timeout=PATIENCE_S, check=False
        )
        return ran.stdout or f"{ran.stderr}\n{log.read_text()}"
    finally:
        bridge.terminate()
        bridge.wait(PATIENCE_S)


@pytest.mark.usefixtures("two_machines")
def test_a_robot_on_another_machine_is_found_by_multicast(tmp_path: Path) -> None:
    assert seen_far(tmp_path, str(next(DOMAINS)), ()) == "10\n"


@pytest.mark.usefixtures("two_machines")
@pytest.mark.parametrize("port", ["", ":first"])
def test_a_robot_on_another_machine_is_found_by_its_name(tmp_path: Path, port: str) -> None:
    domain = next(DOMAINS)
    peer = "10.77.0.2" + port.replace("first", str(7400 + 250 * domain + 10))
    assert seen_far(tmp_path, str(domain), ("--peer", "10.77.0.9", "--peer", peer), ("alone",)) == "10\n"


@pytest.mark.usefixtures("two_machines")
def test_a_robot_that_looks_for_nobody_is_not_found_unless_it_is_named(tmp_path: Path) -> None:
    assert "nobody reads" in seen_far(tmp_path, str(next(DOMAINS)), (), ("alone",))


def test_a_peer_that_cannot_be_found_is_told(tmp_path: Path) -> None:
    for peer, why in (("no.such.host.invalid", ""), ("127.0.0.1:port", "`port` is no port")):
        code, told = refused(tmp_path, "--map", "hall", "--peer", peer)
        assert code == 2
        assert f"the peer `{peer}` cannot be found: {why}" in told
        assert "give a name or an IPv4 address" in told


class Proxy:
    """A way to a server that can be cut while the server lives on."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._ends: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> bool:
        """Breaks all connections, and says whether there were any; new ones are let through."""
        broken = False
        while self._ends:
            with contextlib.suppress(OSError):
                self._ends.pop().shutdown(socket.SHUT_RDWR)
                broken = True
        return broken

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.cut()

    def _accept(self) -> None:
        host, _, port = self._server.address.rpartition(":")
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection((host, int(port)))
                self._ends += [near, far]
                for source, target in ((near, far), (far, near)):
                    threading.Thread(target=self._copy, args=(source, target), daemon=True).start()

    @staticmethod
    def _copy(source: socket.socket, target: socket.socket) -> None:
        with contextlib.suppress(OSError), source, target:
            while chunk := source.recv(1 << 16):
                target.sendall(chunk)
            target.shutdown(socket.SHUT_RDWR)


#: Half of them of DDS, half of gRPC; a thousand take a quarter of an hour.
CUTS = int(os.environ.get("WAYPOST_CUTS", "40"))
#: Between two cuts of DDS.
FRAMES = 4


def test_no_frame_is_lost_or_twice_however_often_connections_break(stage: Stage) -> None:
    proxy = Proxy(stage.server)
    robot = stage.robot()
    told = Diagnostics(robot)
    stage.bridge(*FLAGS, server=f"http://{proxy.address}")
    began, broken, last = time.monotonic(), 0, FRAMES * (CUTS // 2)
    for first in range(1, last + 1, FRAMES):
        # The robot's own programs begin anew.
        robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
        robot.advertise("odom", ros.Odometry, LOSSLESS)
        met(robot, COMPRESSED, "odom")
        # Each time a cut meets the frames in another moment.
        drive(robot, range(first, first + 2), pause_s=0.002 * (first % 20))
        broken += proxy.cut()
        drive(robot, range(first + 2, first + FRAMES), pause_s=0.01)
        upto = first + FRAMES - 1
        until(lambda upto=upto: told.count("images", "received") == upto, what="frames did not come")
        robot.forget(COMPRESSED, "odom")
    until(lambda: told.count("server", "frames answered") == last, 120.0, "frames are missing")
    proxy.close()
    print(
        f"{last // FRAMES} cuts of DDS and {broken} of gRPC in {time.monotonic() - began:.0f} s, {last} frames"
    )
    # A cut while the bridge connects anew meets nothing.
    assert broken >= 0.9 * (CUTS // 2)
    records = stage.client.frames("maps/hall/sessions/drive")
    assert [record.stamp_ns for record in records] == [second * SECOND_NS for second in range(1, last + 1)]
    assert [record.odometry.pose.position_m.x for record in records] == [
        way(second)[0] for second in range(1, last + 1)
    ]
    assert told.count("server", "frames dropped") == 0


def test_frames_beyond_the_buffer_are_dropped_and_counted(stage: Stage) -> None:
    proxy = Proxy(stage.server)
    proxy.close()
    robot = stage.robot()
    told = Diagnostics(robot)
    stage.bridge(*FLAGS, "--buffer-frames", "5", server=f"http://{proxy.address}")
    robot.advertise(COMPRESSED, ros.CompressedImage, LOSSLESS)
    robot.advertise("odom", ros.Odometry, LOSSLESS)
    met(robot, COMPRESSED, "odom")
    drive(robot, range(1, 13))
    until(lambda: told.count("server", "frames dropped") == 7, what=f"{told()}")
    assert told.count("server", "frames waiting") == 5
    assert "no session is open yet" in told.message("server")
