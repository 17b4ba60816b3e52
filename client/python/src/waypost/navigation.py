"""Navigation: the server leads a robot along a map.

The application reports odometry and sends frames; a thread talks to the server and reconnects when the
connection breaks. A command is valid for half a second; after that `Navigation.command` is a stop, so that a
robot without a server stands still.
"""

from __future__ import annotations

import threading
import time
import uuid
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Callable

import grpc
import numpy.typing as npt

from waypost import answers, errors, guidance
from waypost.asked import AskedGoals
from waypost.frames import MAX_IMAGE_BYTES, Frame
from waypost.goals import GoalLike, goal_message
from waypost.guidance import Command, Disconnected, Guidance, NavigationEvent, Reconnected
from waypost.inbox import Inbox
from waypost.poses import Pose2, Pose3, odometry
from waypost.reconnection import OPENING_TIMEOUT_S, PASSING, Patience
from waypost.v1 import geometry_pb2, navigation_pb2

#: Reports and frames that wait to be sent. More would be too old to be of use to a moving robot.
_MESSAGES_AHEAD = 64
#: Events that wait for the application; later ones are dropped.
_EVENTS_AHEAD = 1024
_CLOSING_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class NavigationOptions:
    """Which robot to lead, and how; see `Client.navigate`."""

    map_name: str
    navigation_id: str
    camera: geometry_pb2.Camera
    words_hash: str
    goal: navigation_pb2.Goal | None
    driving: navigation_pb2.DrivingSettings | None
    patience_s: float


class Navigation:
    """A navigation in progress. Made by `Client.navigate`; it may be used by several threads.

    When it is closed, or over, `command` is a stop.
    """

    def __init__(
        self,
        stub: Any,
        options: NavigationOptions,
        address: str,
        on_event: Callable[[NavigationEvent], None] | None = None,
        on_guidance: Callable[[Guidance], None] | None = None,
    ) -> None:
        self._stub = stub
        self._options = options
        self._address = address
        self._on_guidance = on_guidance
        #: What `next_event` takes from; its `on_change` is called after guidance too.
        self.events: Inbox[NavigationEvent] = Inbox(_EVENTS_AHEAD)
        self._tell = on_event or self.events.put
        # By this the server tells a robot that reconnects from another one of the same name.
        self._run_id = f"run-{uuid.uuid4().hex[:16]}"
        self._patience = Patience(options.patience_s)
        #: Guards all below; notified when guidance comes, and at the end.
        self._changed = threading.Condition()
        self._opened: navigation_pb2.NavigationOpened | None = None
        self._link: _Link | None = None
        self._asked = AskedGoals(options.goal)
        self._guidance: Guidance | None = None
        self._command = _LastCommand()
        self._closing = threading.Event()
        self._first = threading.Event()
        self._thread = threading.Thread(target=self._run, name="waypost-navigation", daemon=True)
        self._thread.start()
        self._wait_until_opened()

    @property
    def name(self) -> str:
        """maps/{map}/navigations/{navigation}."""
        return "" if self._opened is None else self._opened.navigation

    @property
    def words_hash(self) -> str:
        """Identifies the words of this map: those of another hash mean something else."""
        return "" if self._opened is None else self._opened.words_hash

    @property
    def guidance(self) -> Guidance | None:
        """The latest guidance; None before the first report was answered."""
        return self._guidance

    def command(self) -> Command:
        """What to drive now: the last command while it is valid, and a stop as soon as it is not.

        Call it in every cycle of the motor controller.
        """
        with self._changed:
            # The server may give commands that it would not give if it knew of a stop.
            return Command() if self._asked.is_stopping else self._command.obey()

    def report(
        self,
        stamp_ns: int,
        pose: Pose2 | Pose3 | npt.ArrayLike | None = None,
        *,
        covariance: npt.ArrayLike | None = None,
        reflex: bool = False,
    ) -> bool:
        """Reports odometry, 10 to 50 times a second; the server answers with the next command.

        Args:
            stamp_ns: When it was read, by the robot's own steady clock: above 0, and rising.
            pose: As in `Frame.odometry`; None for a robot without odometry, which navigates by appearance.
            covariance: As in `Frame.odometry_covariance`.
            reflex: Whether a reflex of the robot, such as an emergency stop, drives in place of the commands.

        Returns:
            Whether it was sent; without a connection it is dropped, as it would come too late.

        Raises:
            WaypostError: If the navigation is over, why.
            ValueError: If the pose cannot be sent.
        """
        wheels = navigation_pb2.WheelReport(
            stamp_ns=stamp_ns,
            odometry=None if pose is None else odometry(pose, covariance),
            reflex=reflex,
        )
        with self._changed:
            self._asked.stamped(stamp_ns)
            obeyed = self._command.obeyed
            if obeyed is not None:
                wheels.obeyed_number = obeyed
            return self._send(navigation_pb2.NavigateRequest(wheels=wheels))

    def see(self, frame: Frame) -> bool:
        """Sends a frame; a `FrameSeen` says what it showed.

        With odometry about twice a second; by appearance a panorama four times a second, which the server
        answers with a command.

        Returns:
            Whether it was sent; without a connection it is dropped.

        Raises:
            WaypostError: If the navigation is over, why.
            ValueError: If the frame cannot be sent.
        """
        message = frame.to_proto()
        if len(message.image) > MAX_IMAGE_BYTES:
            raise ValueError(
                f"the image has {len(message.image)} bytes, more than {MAX_IMAGE_BYTES}; make it smaller or "
                "compress it harder"
            )
        with self._changed:
            self._asked.stamped(message.stamp_ns)
            return self._send(navigation_pb2.NavigateRequest(frame=message))

    def go_to(self, goal: GoalLike) -> None:
        """Sets another goal, see `Client.navigate`; also while the connection is being mended.

        Raises:
            WaypostError: If the navigation is over, why.
        """
        message = goal_message(goal)
        self._ask(lambda: self._asked.go_to(message))

    def stop(self) -> None:
        """Gives up the goal: the robot stops.

        Raises:
            WaypostError: If the navigation is over, why.
        """
        self._ask(self._asked.stop)

    def next_guidance(self, timeout_s: float | None = None) -> Guidance | None:
        """Waits for guidance that comes after this call; None if it did not come in time.

        Raises:
            WaypostError: If the navigation is over, why.
        """
        with self._changed:
            before = self._guidance
            self._changed.wait_for(lambda: self._guidance is not before or self.events.ended, timeout_s)
            self._check()
            return self._guidance if self._guidance is not before else None

    def next_event(self, timeout_s: float | None = None) -> NavigationEvent | None:
        """The next event; None if it did not come in time, or this was closed. At most 1024 wait to be taken.

        Raises:
            WaypostError: If the navigation is over, why: `Aborted` if the same run opened another stream,
                `SessionLost` if the server did not come back.
        """
        return self.events.get(timeout_s)

    def __iter__(self) -> Iterator[NavigationEvent]:
        """Events until the navigation is closed."""
        return iter(self.events)

    def close(self) -> None:
        """Ends the navigation: the robot must stop."""
        self._closing.set()
        with self._changed:
            self._command.forget()
            if self._link is not None:
                self._link.cancel()
        if threading.current_thread() is not self._thread:
            self._thread.join(_CLOSING_TIMEOUT_S)

    def __enter__(self) -> Navigation:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _check(self) -> None:
        """Raises why the navigation is over, if it is."""
        self.events.reraise()
        if self._closing.is_set():
            raise errors.WaypostError("this navigation was closed; start another one with Client.navigate")

    def _wait_until_opened(self) -> None:
        try:
            self._first.wait()
        except BaseException:
            self.close()
            raise
        self.events.reraise()

    def _send(self, request: navigation_pb2.NavigateRequest) -> bool:
        self._check()
        return self._link is not None and self._link.offer(request)

    def _ask(self, ask: Callable[[], navigation_pb2.NavigateRequest]) -> None:
        with self._changed:
            self._check()
            request = ask()
            if self._link is not None:
                self._link.put(request)

    def _run(self) -> None:
        """The navigation's own thread: connect, talk, wait, and again."""
        error: BaseException | None = None
        try:
            while not self._closing.is_set():
                reason = self._converse()
                if self._closing.is_set():
                    break
                if not self._patience.in_trouble and self._opened is not None:
                    self._tell(Disconnected(reason))
                self._closing.wait(self._next_delay(reason))
        except BaseException as raised:
            error = raised
        with self._changed:
            self._command.forget()
            self.events.end(None if self._closing.is_set() else error)
            self._changed.notify_all()
        self._first.set()

    def _converse(self) -> str:
        """One connection; gives why it ended if another attempt may help, and raises if not."""
        link = _Link(self._stub, navigation_pb2.NavigateRequest(open=self._opening()))
        # A call that nobody answers would be waited for without end.
        too_late = threading.Timer(OPENING_TIMEOUT_S, link.cancel)
        too_late.daemon = True
        too_late.start()
        try:
            for response in link.call:
                too_late.cancel()
                self._on_response(response, link)
            return "the server closed the stream"
        except grpc.RpcError as error:
            if error.code() not in PASSING:
                raise errors.from_call(error, self._address) from None
            return error.details() or str(error.code())
        finally:
            too_late.cancel()
            with self._changed:
                self._link = None
            link.cancel()

    def _opening(self) -> navigation_pb2.OpenNavigation:
        options = self._options
        with self._changed:
            goal = self._asked.for_opening
        return navigation_pb2.OpenNavigation(
            map=options.map_name,
            navigation_id=self.name.rpartition("/")[2] or options.navigation_id,
            run_id=self._run_id,
            camera=options.camera,
            words_hash=options.words_hash,
            goal=goal,
            driving=options.driving or navigation_pb2.DrivingSettings(),
        )

    def _on_response(self, response: navigation_pb2.NavigateResponse, link: _Link) -> None:
        content = response.WhichOneof("content")
        if content == "opened":
            self._on_opened(response.opened, link)
        elif self._link is not link:
            raise errors.ProtocolError("the server answered before the navigation was opened")
        elif content == "guidance":
            self._on_guided(response.guidance)
        elif content == "seen":
            self._tell(guidance.frame_seen(response.seen))
        elif content == "refusal":
            self._tell(answers.refusal(response.refusal))
        elif content == "wheel_refusal":
            self._tell(guidance.wheels_refused(response.wheel_refusal))
        elif content == "goal_refusal":
            refused = guidance.goal_refused(response.goal_refusal)
            with self._changed:
                self._asked.refused(refused.goal)
            self._tell(refused)

    def _on_opened(self, opened: navigation_pb2.NavigationOpened, link: _Link) -> None:
        if self._link is link:
            raise errors.ProtocolError("the server opened the navigation twice")
        self._patience.progress()
        with self._changed:
            again = self._opened is not None
            self._opened = opened
            for request in self._asked.unsaid:
                link.put(request)
            self._link = link
        if again:
            self._tell(Reconnected(opened.resumed))
        self._first.set()

    def _on_guided(self, message: navigation_pb2.Guidance) -> None:
        said = guidance.guidance(message)
        with self._changed:
            if message.HasField("command") and not self._closing.is_set():
                self._command.set(message.command)
            self._asked.guided(message)
            self._guidance = said
            self._changed.notify_all()
        self.events.notify()
        if self._on_guidance is not None:
            self._on_guidance(said)

    def _next_delay(self, reason: str) -> float:
        delay = self._patience.next_delay_s()
        if delay is None:
            raise errors.SessionLost(
                f"lost the server at {self._address} for {self._patience.waited_s():.0f} s ({reason}); the "
                "robot stands: once the server is back, start the navigation again"
            )
        return delay


class _LastCommand:
    """The last command, and when it came."""

    def __init__(self) -> None:
        self._command: navigation_pb2.VelocityCommand | None = None
        self._lapses_at = 0.0
        #: Number of the last one that the application read.
        self.obeyed: int | None = None

    def set(self, command: navigation_pb2.VelocityCommand) -> None:
        """Keeps a command that has just arrived."""
        self._command = command
        self._lapses_at = time.monotonic() + command.valid_ns / 1e9

    def obey(self) -> Command:
        """The command if it is still valid, which then counts as obeyed; otherwise a stop."""
        if self._command is None or time.monotonic() >= self._lapses_at:
            return Command()
        self.obeyed = self._command.number
        return Command(self._command.forward_m_s, self._command.turn_rad_s)

    def forget(self) -> None:
        """From now on, a stop."""
        self._command = None


class _Link:
    """One connection, and what waits to be sent over it."""

    def __init__(self, stub: Any, opening: navigation_pb2.NavigateRequest) -> None:
        self._requests: deque[navigation_pb2.NavigateRequest] = deque([opening])
        self._changed = threading.Condition()
        self._ended = False
        self.call = stub.Navigate(iter(self._next, None))

    def offer(self, request: navigation_pb2.NavigateRequest) -> bool:
        """Queues a request, unless too many wait already: late ones are of no use."""
        with self._changed:
            if self._ended or len(self._requests) >= _MESSAGES_AHEAD:
                return False
            self._requests.append(request)
            self._changed.notify()
            return True

    def put(self, request: navigation_pb2.NavigateRequest) -> None:
        """Queues a request that must not be left out."""
        with self._changed:
            self._requests.append(request)
            self._changed.notify()

    def cancel(self) -> None:
        """Ends the stream at once."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self.call.cancel()

    def _next(self) -> navigation_pb2.NavigateRequest | None:
        with self._changed:
            self._changed.wait_for(lambda: self._requests or self._ended)
            return None if self._ended else self._requests.popleft()
