"""Links that break on a robot: what it was asked to do outlives them. The server is played from a script."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Iterator
from concurrent import futures
from typing import Callable

import grpc
import pytest
from conftest import PATIENCE_S, eventually

import waypost
from waypost.asked import MOST_GOALS, AskedGoals
from waypost.client import lazy
from waypost.v1 import navigation_pb2, navigation_pb2_grpc
from waypost.v1.geometry_pb2 import Camera
from waypost.v1.navigation_pb2 import Goal, NavigateRequest, NavigateResponse

STOP = NavigateRequest(stop=navigation_pb2.StopNavigation())
NOWHERE = Goal(label="nowhere")


class Stream:
    """The server's side of a stream, which the test answers."""

    def __init__(self, requests: Iterator[NavigateRequest]) -> None:
        self.opening = next(requests).open
        self._requests: queue.Queue[NavigateRequest] = queue.Queue()
        threading.Thread(target=self._read, args=(requests,), daemon=True).start()
        self.responses: queue.Queue[NavigateResponse | None] = queue.Queue()

    def asked(self) -> NavigateRequest:
        """The next request."""
        return self._requests.get(timeout=PATIENCE_S)

    def open(self, *, resumed: bool) -> None:
        opened = navigation_pb2.NavigationOpened(navigation="maps/hall/navigations/robot", resumed=resumed)
        self.responses.put(NavigateResponse(opened=opened))

    def guide(self, stamp_ns: int) -> None:
        """Answers a report, or a frame, with a command to drive."""
        command = navigation_pb2.VelocityCommand(forward_m_s=1.0, valid_ns=3600 * 10**9)
        said = navigation_pb2.Guidance(
            stamp_ns=stamp_ns, command=command, status=navigation_pb2.NAVIGATION_STATUS_FOLLOWING
        )
        self.responses.put(NavigateResponse(guidance=said))

    def refuse(self, goal: Goal) -> None:
        self.responses.put(NavigateResponse(goal_refusal=navigation_pb2.GoalRefusal(goal=goal)))

    def cut(self) -> None:
        self.responses.put(None)

    def _read(self, requests: Iterator[NavigateRequest]) -> None:
        # However a stream ends, nothing more comes.
        with contextlib.suppress(Exception):
            for request in requests:
                self._requests.put(request)


class Peer(navigation_pb2_grpc.NavigationServiceServicer):
    def __init__(self) -> None:
        self._streams: queue.Queue[Stream] = queue.Queue()

    def stream(self, *, resumed: bool) -> Stream:
        """The next stream of the robot, opened."""
        stream = self._streams.get(timeout=PATIENCE_S)
        stream.open(resumed=resumed)
        return stream

    def Navigate(  # noqa: N802
        self, requests: Iterator[NavigateRequest], context: grpc.ServicerContext
    ) -> Iterator[NavigateResponse]:
        stream = Stream(requests)
        self._streams.put(stream)
        context.add_callback(stream.cut)
        while (response := stream.responses.get()) is not None:
            yield response


Led = tuple[Peer, Stream, waypost.Navigation]


@pytest.fixture
def led() -> Iterator[Led]:
    """A robot that drives to place 1, and its stream."""
    peer = Peer()
    server = grpc.server(futures.ThreadPoolExecutor(8))
    navigation_pb2_grpc.add_NavigationServiceServicer_to_server(peer, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    with lazy(f"127.0.0.1:{port}") as client, futures.ThreadPoolExecutor(1) as opening:
        starting = opening.submit(client.navigate, "hall", Camera(), goal=1)
        stream = peer.stream(resumed=False)
        with starting.result(PATIENCE_S) as navigation:
            navigation.report(1)
            assert stream.asked().wheels.stamp_ns == 1
            stream.guide(1)
            eventually(lambda: drives(navigation))
            yield peer, stream, navigation
    server.stop(None).wait()


def drives(navigation: waypost.Navigation) -> bool:
    return navigation.command() != waypost.Command()


def has_told(navigation: waypost.Navigation, stamp_ns: int) -> Callable[[], bool]:
    return lambda: navigation.guidance is not None and navigation.guidance.stamp_ns == stamp_ns


def refused(navigation: waypost.Navigation) -> None:
    while not isinstance(event := navigation.next_event(PATIENCE_S), waypost.GoalRefused):
        assert event is not None


@pytest.mark.parametrize("sees", [False, True])
def test_a_stop_that_a_dead_link_swallowed_is_sent_again(led: Led, sees: bool) -> None:
    peer, stream, navigation = led
    if sees:
        # By appearance frames are answered, too; this one not by a server that knows of the stop.
        navigation.see(waypost.Frame(1, 2, b"image"))
    navigation.stop()
    assert not drives(navigation)
    navigation.report(3)
    stream.guide(2 if sees else 1)
    if sees:
        eventually(has_told(navigation, 2))
    assert not drives(navigation)
    stream.cut()

    stream = peer.stream(resumed=True)
    assert not stream.opening.HasField("goal")
    assert stream.asked() == STOP
    eventually(lambda: navigation.report(4))
    assert stream.asked().wheels.stamp_ns == 4
    stream.guide(4)
    eventually(has_told(navigation, 4))
    # What it says now it says in the knowledge of the stop.
    assert drives(navigation)
    stream.cut()

    stream = peer.stream(resumed=True)
    eventually(lambda: navigation.report(5))
    assert stream.asked().wheels.stamp_ns == 5


def test_goals_that_a_dead_link_swallowed_are_sent_again_in_order(led: Led) -> None:
    peer, stream, navigation = led
    navigation.go_to(2)
    navigation.go_to(3)
    stream.cut()
    # While it is away, too.
    navigation.go_to(4)

    stream = peer.stream(resumed=True)
    # Any of the others may yet be refused.
    assert stream.opening.goal == Goal(place_number=1)
    assert [stream.asked().goal.place_number for _ in range(3)] == [2, 3, 4]
    eventually(lambda: navigation.report(2))
    stream.guide(2)
    eventually(has_told(navigation, 2))
    stream.cut()
    assert peer.stream(resumed=False).opening.goal == Goal(place_number=4)


@pytest.mark.parametrize("is_answered_first", [False, True])
def test_a_restarted_server_is_told_the_goal_that_was_not_refused(led: Led, is_answered_first: bool) -> None:
    peer, stream, navigation = led
    wrong = [NOWHERE, Goal(image=b"\xff"), Goal(position=navigation_pb2.PositionGoal(x_m=float("nan")))]
    for goal in wrong:
        navigation.go_to(goal)
        assert stream.asked().HasField("goal")
    if is_answered_first:
        navigation.report(2)
        stream.guide(2)
        eventually(has_told(navigation, 2))
    for goal in wrong:
        stream.refuse(goal)
        refused(navigation)
    stream.cut()
    stream = peer.stream(resumed=False)
    assert stream.opening.goal == Goal(place_number=1)
    # Nothing is sent again.
    eventually(lambda: navigation.report(3))
    assert stream.asked().wheels.stamp_ns == 3


def test_a_refusal_does_not_take_a_later_stop_away(led: Led) -> None:
    peer, stream, navigation = led
    navigation.go_to(NOWHERE)
    navigation.stop()
    stream.refuse(NOWHERE)
    refused(navigation)
    stream.cut()
    stream = peer.stream(resumed=True)
    assert not stream.opening.HasField("goal")
    assert stream.asked() == STOP


def test_a_stop_outlives_the_goals_after_it() -> None:
    goals = AskedGoals(Goal(place_number=1))
    goals.go_to(NOWHERE)
    goals.stop()
    for number in range(100):
        goals.go_to(Goal(place_number=number))
    assert len(goals.unsaid) == MOST_GOALS
    assert goals.unsaid[0] == STOP
    assert goals.unsaid[-1].goal == Goal(place_number=99)
    goals.refused(NOWHERE)
    assert len(goals.unsaid) == MOST_GOALS
    assert goals.is_stopping
    assert goals.for_opening is None


def test_a_label_is_refused_by_its_place_once_the_server_looked_it_up() -> None:
    goals = AskedGoals(Goal(label="dock"))
    goals.go_to(NOWHERE)
    goals.refused(Goal(place_number=4))
    assert goals.for_opening is None
    assert [request.goal for request in goals.unsaid] == [NOWHERE]


def test_a_goal_that_was_reached_is_not_returned_to() -> None:
    goals = AskedGoals(Goal(place_number=1))
    goals.guided(navigation_pb2.Guidance(stamp_ns=1, status=navigation_pb2.NAVIGATION_STATUS_ARRIVED))
    assert goals.for_opening == Goal(place_number=1)
    goals.go_to(NOWHERE)
    goals.refused(NOWHERE)
    assert goals.for_opening is None
