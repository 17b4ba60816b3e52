"""A robot that is led along a taught way, by a real server, through all that can go wrong."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Callable

import pytest
from conftest import IMAGES, MODEL, PATIENCE_S, REPOSITORY, Proxy, Server, eventually, our_threads
from robot import DRIVE_S, Robot, taught

import waypost
from waypost.goals import GoalLike
from waypost.v1 import label_pb2
from waypost.v1.geometry_pb2 import Camera, FieldOfView
from waypost.v1.navigation_pb2 import DrivingSettings, Navigation

CAMERA = Camera(field_of_view=FieldOfView(horizontal_rad=1.2))
FAST = DrivingSettings(speed_m_s=1.0)
EXAMPLE = REPOSITORY / "client" / "python" / "examples" / "navigate.py"
#: A place of the taught way, and how far along it is.
GOAL, GOAL_M = 4, 4.5


@pytest.fixture(scope="module")
def guide(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server whose map `hall` is taught; the test that kills it starts it again."""
    server = Server(tmp_path_factory.mktemp("guide") / "data")
    server.start()
    try:
        with waypost.connect(server.address) as client:
            client.import_model(MODEL, "shipped")
            taught(client, "hall", 20)
            assert client.set_label("hall", GOAL, "dock", label_pb2.LABEL_SCOPE_PLACE) == [GOAL]
        yield server
    finally:
        server.kill()


@pytest.fixture
def client(guide: Server) -> Iterator[waypost.Client]:
    with waypost.connect(guide.address) as client:
        yield client


class Drive:
    """A robot with its navigation, one step at a time."""

    def __init__(self, navigation: waypost.Navigation) -> None:
        self.navigation = navigation
        self.robot = Robot()
        self.events: list[waypost.NavigationEvent] = []
        self._cycle = 0

    def until(self, is_so: Callable[[], bool]) -> None:
        """Drives until something is so."""
        deadline = time.monotonic() + DRIVE_S
        while not is_so():
            assert time.monotonic() < deadline, (self.navigation.guidance, self.events[-20:])
            now_ns, odometry = time.monotonic_ns(), self.robot.odometry()
            self.navigation.report(now_ns, odometry)
            if self._cycle % 8 == 0:
                frame = waypost.Frame(self._cycle + 1, now_ns, self.robot.image(), odometry=odometry)
                self.navigation.see(frame)
            self._cycle += 1
            self.robot.drive(*self.navigation.command())
            while (event := self.navigation.next_event(0.0)) is not None:
                self.events.append(event)
            time.sleep(0.03)

    def drives(self) -> bool:
        return self.navigation.command().forward_m_s > 0

    def has(self, status: waypost.NavigationStatus) -> bool:
        guidance = self.navigation.guidance
        return guidance is not None and guidance.status == status

    def told(self, kind: type) -> bool:
        return any(isinstance(event, kind) for event in self.events)


def is_dock(navigation: Navigation) -> bool:
    """Whether the robot goes there; the server may tell the label or the place that has it."""
    return navigation.goal.label == "dock" or navigation.goal.place_number == GOAL


def test_the_example_leads_a_robot_and_fits_in_thirty_lines(guide: Server) -> None:
    assert sum(1 for line in EXAMPLE.read_text().splitlines() if line.strip()) <= 30
    environment = {name: value for name, value in os.environ.items() if not name.startswith("WAYPOST_")}
    environment["PYTHONPATH"] = str(Path(__file__).parent)
    environment["WAYPOST_SERVER"] = f"http://{guide.address}"
    command = [sys.executable, str(EXAMPLE), "hall", "dock"]
    shown = subprocess.run(
        command, env=environment, stdout=subprocess.PIPE, text=True, check=True, timeout=DRIVE_S
    ).stdout
    assert "outcome='FOUND'" in shown
    assert "NavigationStatus.ARRIVED" in shown.splitlines()[-1]


def test_commands_lapse_when_the_server_falls_silent(client: waypost.Client, guide: Server) -> None:
    with client.navigate("hall", CAMERA, goal="dock", driving=FAST) as navigation:
        drive = Drive(navigation)
        drive.until(drive.drives)
        guide.freeze()
        try:
            # The connection stands, and nobody says anything: nothing but the clock can stop the robot.
            eventually(lambda: navigation.command() == waypost.Command())
            silent = navigation.guidance
            assert silent is not None
            assert silent.valid_s == pytest.approx(0.5)
            assert navigation.next_guidance(timeout_s=0.1) is None
            assert navigation.command() == waypost.Command()
        finally:
            guide.thaw()
        drive.until(drive.drives)
        assert not drive.told(waypost.Disconnected)
    assert navigation.command() == waypost.Command()
    with pytest.raises(waypost.WaypostError, match="was closed"):
        navigation.report(time.monotonic_ns(), (0, 0, 0))
    eventually(lambda: not our_threads())


def test_a_run_goes_on_over_another_connection(guide: Server) -> None:
    proxy = Proxy(guide)
    with (
        waypost.connect(proxy.address) as client,
        client.navigate("hall", CAMERA, goal=GOAL, driving=FAST) as navigation,
    ):
        name = navigation.name
        drive = Drive(navigation)
        drive.until(drive.drives)
        proxy.cut()
        drive.until(lambda: drive.told(waypost.Reconnected))
        assert waypost.Reconnected(resumed=True) in drive.events
        assert navigation.name == name
        drive.until(lambda: drive.has(waypost.NavigationStatus.ARRIVED))
        assert drive.robot.x_m == pytest.approx(GOAL_M, abs=1.0)
    proxy.close()


def test_a_run_goes_on_at_a_server_that_was_killed(client: waypost.Client, guide: Server) -> None:
    # So slow that it stands where it was found, and is found there again.
    slow = DrivingSettings(speed_m_s=0.2)
    with client.navigate("hall", CAMERA, goal=8, driving=slow) as navigation:
        drive = Drive(navigation)
        drive.until(drive.drives)
        guide.kill()
        drive.until(lambda: drive.told(waypost.Disconnected))
        eventually(lambda: navigation.command() == waypost.Command())
        # What is asked for meanwhile is what it goes for afterwards.
        navigation.go_to("dock")
        guide.start()
        drive.until(lambda: drive.told(waypost.Reconnected))
        assert waypost.Reconnected(resumed=False) in drive.events
        drive.until(drive.drives)
        assert drive.has(waypost.NavigationStatus.FOLLOWING)
        assert is_dock(client.navigation(navigation.name))


def test_a_restarted_server_leads_to_the_goal_that_was_not_refused(
    client: waypost.Client, guide: Server
) -> None:
    with client.navigate("hall", CAMERA, goal="dock") as navigation:
        navigation.go_to("nowhere")
        assert isinstance(navigation.next_event(PATIENCE_S), waypost.GoalRefused)
        guide.kill()
        guide.start()
        assert isinstance(navigation.next_event(PATIENCE_S), waypost.Disconnected)
        assert navigation.next_event(PATIENCE_S) == waypost.Reconnected(resumed=False)
        assert is_dock(client.navigation(navigation.name))


def test_a_server_that_stays_away_ends_it(client: waypost.Client, guide: Server) -> None:
    with client.navigate("hall", CAMERA, goal="dock", patience_s=1.0) as navigation:
        guide.kill()
        try:
            with pytest.raises(waypost.SessionLost, match="the robot stands"):
                list(navigation)
            assert navigation.command() == waypost.Command()
            with pytest.raises(waypost.SessionLost):
                navigation.report(time.monotonic_ns(), (0, 0, 0))
            with pytest.raises(waypost.SessionLost):
                navigation.go_to(1)
            with pytest.raises(waypost.SessionLost):
                client.navigate("hall", CAMERA, patience_s=0.2)
        finally:
            guide.start()


def test_goals_and_who_else_may_set_them(client: waypost.Client) -> None:
    events: list[waypost.NavigationEvent] = []
    said: list[waypost.Guidance] = []
    callbacks = {"on_event": events.append, "on_guidance": said.append}
    with client.navigate("hall", CAMERA, navigation_id="robot", **callbacks) as navigation:  # type: ignore[arg-type]
        assert navigation.name == "maps/hall/navigations/robot"
        navigation.report(time.monotonic_ns(), (0, 0, 0))
        eventually(lambda: said)
        assert said[0].status == waypost.NavigationStatus.IDLE
        navigation.go_to("dock")
        eventually(lambda: is_dock(client.navigation(navigation.name)))
        navigation.go_to((2.0, 0.0))
        eventually(lambda: client.navigation(navigation.name).goal.position.x_m == 2.0)
        navigation.go_to(3)
        eventually(lambda: client.navigation(navigation.name).goal.place_number == 3)
        navigation.stop()
        eventually(lambda: not client.navigation(navigation.name).HasField("goal"))
        assert is_dock(client.set_goal(navigation.name, "dock"))
        assert not client.cancel_goal(navigation.name).HasField("goal")
        assert [found.name for found in client.navigations("hall") if found.connected] == [navigation.name]
        navigation.go_to("nowhere")
        eventually(lambda: events)
        assert isinstance(events[0], waypost.GoalRefused)
        assert "nowhere" in str(events[0].error)
        with pytest.raises(waypost.ServerError, match="nowhere"):
            client.set_goal(navigation.name, "nowhere")
        navigation.report(time.monotonic_ns(), (float("nan"), 0, 0))
        eventually(lambda: any(isinstance(event, waypost.WheelsRefused) for event in events))
        # Another run of the same name is another robot.
        with pytest.raises(waypost.FailedPrecondition):
            client.navigate("hall", CAMERA, navigation_id="robot")
    route = client.plan_route("hall", 1, "dock")
    assert [point.place_number for point in route.waypoints] == [1, 2, 3, GOAL]


def test_what_cannot_be_led_is_refused(client: waypost.Client) -> None:
    with pytest.raises(waypost.NotFound, match="cellar"):
        client.navigate("cellar", CAMERA)
    with pytest.raises(waypost.InvalidArgument, match="camera"):
        client.navigate("hall", Camera())
    no_goals: list[GoalLike] = [True, -1, (1.0,), (1.0, 2.0, 3.0, 4.0), bytes(waypost.MAX_IMAGE_BYTES + 1)]
    for goal in no_goals:
        with pytest.raises(ValueError, match=r"goal|place|position"):
            client.navigate("hall", CAMERA, goal=goal)
    with client.navigate("hall", CAMERA) as navigation:
        huge = waypost.Frame(1, 1, bytes(waypost.MAX_IMAGE_BYTES + 1), odometry=(0, 0, 0))
        with pytest.raises(ValueError, match="make it smaller"):
            navigation.see(huge)
        with pytest.raises(ValueError, match="heading"):
            navigation.report(1, (1.0, 2.0))
        navigation.see(waypost.Frame(1, time.monotonic_ns(), IMAGES[0].read_bytes()))
        refusal = navigation.next_event(PATIENCE_S)
        assert isinstance(refusal, waypost.Refusal)
        assert "odometry" in str(refusal.error)


def test_what_a_callback_raises_stops_the_robot(client: waypost.Client) -> None:
    def broken(guidance: waypost.Guidance) -> None:
        raise RuntimeError("the motors are off")

    with client.navigate("hall", CAMERA, goal="dock", on_guidance=broken) as navigation:
        navigation.report(time.monotonic_ns(), (0, 0, 0))
        with pytest.raises(RuntimeError, match="motors"):
            navigation.next_event(PATIENCE_S)
        assert navigation.command() == waypost.Command()
