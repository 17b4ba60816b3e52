"""Sessions that outlive their connections.

Three threads share the work, and one queue of events joins them: a feeder takes frames from the application,
a reader takes what the server says, and the application's own thread, while it iterates, decides all else.
"""

from __future__ import annotations

import enum
import queue
import time
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Callable

from waypost import answers, errors
from waypost.answers import Outcome
from waypost.doubts import OdometryDoubts
from waypost.frames import Frame
from waypost.links import Ended, Event, Feeder, Given, Interrupt, Link, Said
from waypost.reconnection import OPENING_TIMEOUT_S, PASSING, Patience
from waypost.sender import Sender
from waypost.v1 import geometry_pb2, session_pb2
from waypost.window import Window


class Mode(enum.IntEnum):
    """What a session does to its map."""

    #: The map grows by what the session sees.
    MAP = session_pb2.SESSION_MODE_MAP
    #: The map is read and never changed.
    LOCALIZE = session_pb2.SESSION_MODE_LOCALIZE


@dataclass(frozen=True)
class SessionOptions:
    """Which session to open, and how to keep it; see `Client.session`."""

    map_name: str
    session_id: str
    mode: Mode
    camera: geometry_pb2.Camera | None
    words_hash: str
    run_id: str
    window_frames: int
    patience_s: float

    def __post_init__(self) -> None:
        """Raises `ValueError` if nothing could be under way."""
        if self.window_frames < 1:
            raise ValueError("window_frames must be at least 1")
        if self.camera is not None and not isinstance(self.camera, geometry_pb2.Camera):
            raise TypeError(
                f"camera is a {type(self.camera).__name__}, and must be a Camera of waypost.v1.geometry_pb2, "
                "as Camera(field_of_view=FieldOfView(horizontal_rad=1.2)); `waypost stream` reads files"
            )


class Session:
    """One run of one robot, being streamed into a map. Made by `Client.session`; not for several threads.

    Every frame given gets exactly one outcome, in the order of giving, through any number of broken
    connections.
    """

    def __init__(self, stub: Any, options: SessionOptions, address: str) -> None:
        self._stub = stub
        self._options = options
        self._address = address
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._window = Window()
        self._doubts = OdometryDoubts()
        self._patience = Patience(options.patience_s)
        self._opened: session_pb2.SessionOpened | None = None
        self._feeder: Feeder | None = None
        self._sender: Sender | None = None
        self._link: Link | None = self._connect()

    @property
    def name(self) -> str:
        """maps/{map}/sessions/{session}."""
        return self._last_opened.session

    @property
    def model(self) -> str:
        """models/{hash}: the model of the map."""
        return self._last_opened.model

    @property
    def words_hash(self) -> str:
        """What the words of this map are told by: those of another hash mean something else."""
        return self._last_opened.words_hash

    @property
    def last_committed_sequence(self) -> int | None:
        """Last frame that is known to be durable; None in a new session. Send from the next one on."""
        opened = self._last_opened
        committed = opened.last_committed_sequence if opened.HasField("last_committed_sequence") else None
        acknowledged = self._window.last_acknowledged
        return max((s for s in (committed, acknowledged) if s is not None), default=None)

    def message(self, frame: Frame) -> session_pb2.Frame:
        """The frame as it is sent; warns of odometry that seems to be in other units (`OdometryWarning`)."""
        self._doubts.look(frame)
        return frame.to_proto()

    def stream(self, frames: Iterable[Frame]) -> Iterator[Outcome]:
        """Streams frames and yields what became of each, in their order, as it comes.

        `frames` is iterated by a thread of its own, at most `window_frames` ahead of the outcomes, so it may
        wait for a camera. What it raises is raised here, once the frames before have had their outcomes.
        Frames that have none when the iteration is left early may be durable all the same:
        `last_committed_sequence` of the session, opened anew, says so.

        Raises:
            ValueError: If the numbers of frames do not rise, or a frame cannot be sent.
            ServerError: If the server ended the session: `Aborted` when another stream took it over,
                `NotFound` when its map was deleted.
            SessionLost: If the server stayed away, or asked to send a frame again, for too long.
            SessionRewound: If it came back with older data.
        """
        yield from self._stream(self.message(frame) for frame in frames)

    def sender(
        self, on_outcome: Callable[[Outcome], None] | None = None, *, queue_frames: int = 32
    ) -> Sender:
        """For code that is called back with images, as in ROS: `sender.send(frame)`, from any thread.

        Args:
            on_outcome: Called with what became of each frame, in the order of sending, by a thread of the
                sender's own; what it raises ends the sender. If left out, iterate the sender.
            queue_frames: How many frames may be without an outcome before further ones are refused.
        """
        if self._sender is not None and not self._sender.ended:
            raise errors.WaypostError("this session has a sender already: close that one first")
        self._sender = Sender(self, on_outcome, queue_frames)
        return self._sender

    def _stream(self, frames: Iterable[session_pb2.Frame]) -> Generator[Outcome, None, None]:
        if self._feeder is not None:
            raise errors.WaypostError(
                "this session streams already: end that stream or sender first, or open another session"
            )
        self._patience.progress()
        feeder = Feeder(frames, self._options.window_frames, self._events)
        self._feeder = feeder
        try:
            yield from self._exchange(feeder)
        finally:
            feeder.stop()
            self._feeder = None
            if len(self._window) > 0:
                # Their answers must not be taken for those of frames to come.
                self._window.clear()
                self._drop_link()

    def close(self) -> None:
        """Ends the session's stream; all that was answered is durable, and the session can be resumed.

        A sender that is still open gives up what has no outcome.
        """
        if self._sender is not None:
            self._sender.abort()
            self._sender = None
        if self._link is not None:
            self._link.finish()
            self._link = None

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def _last_opened(self) -> session_pb2.SessionOpened:
        if self._opened is None:
            raise errors.ProtocolError("the session was not opened")
        return self._opened

    def _exchange(self, feeder: Feeder) -> Iterator[Outcome]:
        """Sends what is to be sent and takes what comes, until every frame has its outcome."""
        release_at: float | None = None
        while True:
            if self._link is None:
                self._link = self._connect()
                release_at = None
            for frame in self._window.to_send():
                self._link.send(session_pb2.StreamRequest(frame=frame))
            for outcome in self._window.outcomes():
                feeder.free_slot()
                yield outcome
            if feeder.finished and len(self._window) == 0:
                return feeder.reraise()

            releasing = release_at is not None and self._window.only_postponed_left()
            event = self._next_event(release_at if releasing else None)
            if event is None:
                self._window.release_postponed()
                release_at = None
            elif isinstance(event, (Given, Interrupt)):
                self._take_frame(event)
            elif event.link is not self._link:
                continue
            elif isinstance(event, Said):
                postponed = self._take_outcome(event.response)
                if postponed is not None:
                    now = time.monotonic()
                    if release_at is None:
                        release_at = now + self._next_delay(postponed.error.message)
                    release_at = max(release_at, now + (postponed.error.retry_delay_s or 0.0))
            else:
                reason = self._why_broken(event)
                self._window.send_again()
                self._pause(self._next_delay(reason))

    def _take_frame(self, given: Given | Interrupt) -> None:
        """Takes a frame, or notes that no more come. What an older stream had left is dropped."""
        if given.feeder is not self._feeder:
            return
        if isinstance(given, Interrupt):
            raise errors.Interrupted("another thread closed the session")
        if given.frame is not None:
            self._window.push(given.frame)
        else:
            given.feeder.end(given.error)

    def _take_outcome(self, response: session_pb2.StreamResponse) -> answers.Refusal | None:
        """Gives the refusal if the server asks to send a frame again."""
        content = response.WhichOneof("content")
        if content == "answer":
            postponed = self._window.settle(answers.answer(response.answer))
        elif content == "refusal":
            postponed = self._window.settle(answers.refusal(response.refusal))
        else:
            raise errors.ProtocolError(
                f"the server sent {content or 'an empty message'} in place of an answer"
            )
        if postponed is None:
            self._patience.progress()
        return postponed

    def _connect(self) -> Link:
        """Opens the session, or opens it again, as often as patience allows."""
        while True:
            self._link = Link(self._stub, self._events)
            self._link.send(session_pb2.StreamRequest(open=self._opening()))
            opened = self._first_response(self._link)
            if isinstance(opened, session_pb2.SessionOpened):
                self._on_opened(opened)
                return self._link
            self._drop_link()
            self._pause(self._next_delay(opened))

    def _opening(self) -> session_pb2.OpenSession:
        options = self._options
        session_id = self._opened.session.rpartition("/")[2] if self._opened else options.session_id
        return session_pb2.OpenSession(
            map=options.map_name,
            session_id=session_id,
            mode=options.mode.value,
            camera=options.camera,
            words_hash=options.words_hash,
            run_id=options.run_id,
        )

    def _first_response(self, link: Link) -> session_pb2.SessionOpened | str:
        """What opens the session, or why another attempt has to be made."""
        deadline = time.monotonic() + OPENING_TIMEOUT_S
        while True:
            event = self._next_event(deadline)
            if event is None:
                return f"the session was not opened within {OPENING_TIMEOUT_S:.0f} s"
            if isinstance(event, (Given, Interrupt)):
                self._take_frame(event)
            elif event.link is not link:
                continue
            elif isinstance(event, Ended):
                return self._why_broken(event)
            elif event.response.WhichOneof("content") == "opened":
                return event.response.opened
            else:
                raise errors.ProtocolError("the server answered before the session was opened")

    def _on_opened(self, opened: session_pb2.SessionOpened) -> None:
        acknowledged = self._window.last_acknowledged
        committed = opened.last_committed_sequence if opened.HasField("last_committed_sequence") else None
        # What localizes is not durable, and makes a new start at a server that was started anew.
        durable = self._options.mode == Mode.MAP
        if durable and acknowledged is not None and (committed is None or committed < acknowledged):
            known = "no frame at all" if committed is None else f"frame {committed}"
            raise errors.SessionRewound(
                f"the server had acknowledged frame {acknowledged} of this session, but now knows it only up "
                f"to {known}; its data was replaced by older data: restore that, or start a new session"
            )
        self._opened = opened
        if len(self._window) == 0:
            self._patience.progress()

    def _why_broken(self, event: Ended) -> str:
        """Why the link broke; raises what ended the session instead if another attempt is of no use."""
        self._drop_link()
        error = event.error
        if error is None:
            return "the server closed the stream"
        if error.code() in PASSING:
            return error.details() or str(error.code())
        raise errors.from_call(error, self._address)

    def _pause(self, delay_s: float) -> None:
        """Waits; only the application counts meanwhile."""
        until = time.monotonic() + delay_s
        while (event := self._next_event(until)) is not None:
            if isinstance(event, (Given, Interrupt)):
                self._take_frame(event)

    def _interrupt(self) -> None:
        """Ends the present stream, from another thread."""
        feeder = self._feeder
        if feeder is not None:
            self._events.put(Interrupt(feeder))

    def _next_event(self, until: float | None) -> Event | None:
        """None if it is `until`, by the monotonic clock, before anything happens."""
        timeout = None if until is None else max(0.0, until - time.monotonic())
        try:
            return self._events.get(timeout=timeout)
        except queue.Empty:
            return None

    def _next_delay(self, reason: str) -> float:
        delay = self._patience.next_delay_s()
        if delay is None:
            self._drop_link()
            raise errors.SessionLost(
                f"lost the server at {self._address} for {self._patience.waited_s():.0f} s with "
                f"{len(self._window)} frames unacknowledged ({reason}); once it is back, open the same "
                "session again and send them again"
            )
        return delay

    def _drop_link(self) -> None:
        if self._link is not None:
            self._link.cancel()
            self._link = None
