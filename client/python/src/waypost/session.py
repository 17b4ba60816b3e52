"""Sessions that outlive their connections.

Three threads share the work, and one queue of events joins them: a feeder takes frames from the application,
a reader takes what the server says, and the application's own thread, while it iterates, decides all else.
"""

from __future__ import annotations

import enum
import queue
import random
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Union

import grpc

from waypost import answers, errors
from waypost.answers import Outcome
from waypost.frames import Frame
from waypost.v1 import geometry_pb2, session_pb2
from waypost.window import Window

#: Opening a large map takes a server seconds.
_OPENING_TIMEOUT_S = 30.0
#: All is answered by then; this is courtesy.
_CLOSING_TIMEOUT_S = 2.0
_FIRST_DELAY_S = 0.1
_LONGEST_DELAY_S = 5.0
#: Ends of a stream that are worth another attempt. UNKNOWN stands for one that was cut off without a status.
_PASSING = frozenset(
    {
        grpc.StatusCode.UNAVAILABLE,
        grpc.StatusCode.RESOURCE_EXHAUSTED,
        grpc.StatusCode.DEADLINE_EXCEEDED,
        grpc.StatusCode.CANCELLED,
        grpc.StatusCode.UNKNOWN,
    }
)


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
    window_frames: int
    patience_s: float

    def __post_init__(self) -> None:
        """Raises `ValueError` if nothing could be under way, or no attempt be made."""
        if self.window_frames < 1:
            raise ValueError("window_frames must be at least 1")
        if not self.patience_s >= 0:
            raise ValueError("patience_s must be 0 or more")


class Session:
    """One run of one robot, being streamed into a map. Made by `Client.session`; not for several threads.

    Every frame given gets exactly one outcome, in the order of giving, through any number of broken
    connections.
    """

    def __init__(self, stub: Any, options: SessionOptions, address: str) -> None:
        self._stub = stub
        self._options = options
        self._address = address
        self._events: queue.SimpleQueue[_Event] = queue.SimpleQueue()
        self._window = Window()
        self._patience = _Patience(options.patience_s)
        self._opened: session_pb2.SessionOpened | None = None
        self._feeder: _Feeder | None = None
        self._link: _Link | None = self._connect()

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
        self._patience.progress()
        feeder = _Feeder(frames, self._options.window_frames, self._events)
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
        """Ends the session's stream; all that was answered is durable, and the session can be resumed."""
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

    def _exchange(self, feeder: _Feeder) -> Iterator[Outcome]:
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
            elif isinstance(event, _Given):
                self._take_frame(event)
            elif event.link is not self._link:
                continue
            elif isinstance(event, _Said):
                postponed = self._take_outcome(event.response)
                if postponed is not None:
                    now = time.monotonic()
                    if release_at is None:
                        release_at = now + self._next_delay(postponed.error.message)
                    release_at = max(release_at, now + (postponed.error.retry_delay_s or 0.0))
            else:
                reason = self._why_broken(event)
                self._window.send_again()
                time.sleep(self._next_delay(reason))

    def _take_frame(self, given: _Given) -> None:
        """Takes a frame, or notes that no more come. What an older stream had left is dropped."""
        if given.feeder is not self._feeder:
            return
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

    def _connect(self) -> _Link:
        """Opens the session, or opens it again, as often as patience allows."""
        while True:
            self._link = _Link(self._stub, self._events)
            self._link.send(session_pb2.StreamRequest(open=self._opening()))
            opened = self._first_response(self._link)
            if isinstance(opened, session_pb2.SessionOpened):
                self._on_opened(opened)
                return self._link
            self._drop_link()
            time.sleep(self._next_delay(opened))

    def _opening(self) -> session_pb2.OpenSession:
        options = self._options
        session_id = self._opened.session.rpartition("/")[2] if self._opened else options.session_id
        return session_pb2.OpenSession(
            map=options.map_name,
            session_id=session_id,
            mode=options.mode.value,
            camera=options.camera,
            words_hash=options.words_hash,
        )

    def _first_response(self, link: _Link) -> session_pb2.SessionOpened | str:
        """What opens the session, or why another attempt has to be made."""
        deadline = time.monotonic() + _OPENING_TIMEOUT_S
        while True:
            event = self._next_event(deadline)
            if event is None:
                return f"the session was not opened within {_OPENING_TIMEOUT_S:.0f} s"
            if isinstance(event, _Given):
                self._take_frame(event)
            elif event.link is not link:
                continue
            elif isinstance(event, _Ended):
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

    def _why_broken(self, event: _Ended) -> str:
        """Why the link broke; raises what ended the session instead if another attempt is of no use."""
        self._drop_link()
        error = event.error
        if error is None:
            return "the server closed the stream"
        if error.code() in _PASSING:
            return error.details() or str(error.code())
        raise errors.from_call(error, self._address)

    def _next_event(self, until: float | None) -> _Event | None:
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


@dataclass(frozen=True)
class _Given:
    """The application gave a frame, or has no more: then with what it raised, if anything."""

    feeder: _Feeder
    frame: session_pb2.Frame | None = None
    error: BaseException | None = None


@dataclass(frozen=True)
class _Said:
    link: _Link
    response: session_pb2.StreamResponse


@dataclass(frozen=True)
class _Ended:
    """A link came to its end, by an error if the server gave one."""

    link: _Link
    error: Any | None


_Event = Union[_Given, _Said, _Ended]


class _Link:
    """One connection of the session."""

    def __init__(self, stub: Any, events: queue.SimpleQueue[_Event]) -> None:
        self._requests: queue.SimpleQueue[session_pb2.StreamRequest | None] = queue.SimpleQueue()
        self._call = stub.Stream(iter(self._requests.get, None))
        self._events = events
        self._reader = threading.Thread(target=self._read, name="waypost-reader", daemon=True)
        self._reader.start()

    def send(self, request: session_pb2.StreamRequest) -> None:
        self._requests.put(request)

    def finish(self) -> None:
        """Ends the stream from this side and lets the server end it from its own."""
        self._requests.put(None)
        self._reader.join(_CLOSING_TIMEOUT_S)
        self._call.cancel()

    def cancel(self) -> None:
        self._call.cancel()
        # Whoever waits for requests would do so for ever.
        self._requests.put(None)

    def _read(self) -> None:
        try:
            for response in self._call:
                self._events.put(_Said(self, response))
        except grpc.RpcError as error:
            self._events.put(_Ended(self, error))
        else:
            self._events.put(_Ended(self, None))


class _Feeder:
    """Takes frames from the application in a thread of its own, as many as there is room for."""

    def __init__(self, frames: Iterable[Frame], room: int, events: queue.SimpleQueue[_Event]) -> None:
        self._frames = frames
        self._slots = threading.Semaphore(room)
        self._events = events
        self._stopped = False
        self._error: BaseException | None = None
        #: Whether no more frames come.
        self.finished = False
        threading.Thread(target=self._feed, name="waypost-feeder", daemon=True).start()

    def free_slot(self) -> None:
        """A frame has its outcome."""
        self._slots.release()

    def end(self, error: BaseException | None) -> None:
        """All frames before the end have been taken."""
        self.finished = True
        self._error = error

    def stop(self) -> None:
        """No more frames are taken, but for one that the application is making just now."""
        self._stopped = True
        self._slots.release()

    def reraise(self) -> None:
        """Raises what the application raised."""
        if self._error is not None:
            raise self._error

    def _feed(self) -> None:
        last: int | None = None
        try:
            frames = iter(self._frames)
            while True:
                # Room first: a camera is asked for an image when it can be sent.
                self._slots.acquire()
                if self._stopped:
                    return
                frame = next(frames, None)
                if frame is None:
                    break
                if last is not None and frame.sequence <= last:
                    raise ValueError(
                        f"frame {frame.sequence} follows frame {last}; number frames so that every number is "
                        "above the last"
                    )
                last = frame.sequence
                self._events.put(_Given(self, frame.to_proto()))
        except BaseException as error:
            self._events.put(_Given(self, error=error))
        else:
            self._events.put(_Given(self))


class _Patience:
    """Delays that double, shortened at random by up to half so that robots do not all come back at once."""

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._delay_s = _FIRST_DELAY_S
        self._trouble_since: float | None = None

    def next_delay_s(self) -> float | None:
        """How long to wait before the next attempt; None if it is time to give up."""
        now = time.monotonic()
        if self._trouble_since is None:
            self._trouble_since = now
        left = self._patience_s - (now - self._trouble_since)
        if left <= 0:
            return None
        delay = min(self._delay_s, _LONGEST_DELAY_S) * random.uniform(0.5, 1.0)
        self._delay_s *= 2
        return min(delay, left)

    def progress(self) -> None:
        """The server did what was asked: the next trouble is a new one."""
        self._delay_s = _FIRST_DELAY_S
        self._trouble_since = None

    def waited_s(self) -> float:
        """Time since the present trouble began."""
        return 0.0 if self._trouble_since is None else time.monotonic() - self._trouble_since
