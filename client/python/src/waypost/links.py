"""The threads of a session: one takes frames from the application, one takes what the server says."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Union

import grpc

from waypost.v1 import session_pb2

#: All is answered by then; this is courtesy.
_CLOSING_TIMEOUT_S = 2.0


@dataclass(frozen=True)
class Given:
    """The application gave a frame, or has no more: then with what it raised, if anything."""

    feeder: Feeder
    frame: session_pb2.Frame | None = None
    error: BaseException | None = None


@dataclass(frozen=True)
class Said:
    """The server said something."""

    link: Link
    response: session_pb2.StreamResponse


@dataclass(frozen=True)
class Ended:
    """A link came to its end, by an error if the server gave one."""

    link: Link
    error: Any | None


@dataclass(frozen=True)
class Interrupt:
    """Another thread wants the stream that has this feeder to end."""

    feeder: Feeder


Event = Union[Given, Said, Ended, Interrupt]


class Link:
    """One connection of the session."""

    def __init__(self, stub: Any, events: queue.SimpleQueue[Event]) -> None:
        self._requests: queue.SimpleQueue[session_pb2.StreamRequest | None] = queue.SimpleQueue()
        self._call = stub.Stream(iter(self._requests.get, None))
        self._events = events
        self._reader = threading.Thread(target=self._read, name="waypost-reader", daemon=True)
        self._reader.start()

    def send(self, request: session_pb2.StreamRequest) -> None:
        """Queues a request."""
        self._requests.put(request)

    def finish(self) -> None:
        """Ends the stream from this side and lets the server end it from its own."""
        self._requests.put(None)
        self._reader.join(_CLOSING_TIMEOUT_S)
        self._call.cancel()
        self._reader.join(_CLOSING_TIMEOUT_S)

    def cancel(self) -> None:
        """Ends the stream at once."""
        self._call.cancel()
        # A reader of requests would wait for ever.
        self._requests.put(None)
        self._reader.join(_CLOSING_TIMEOUT_S)

    def _read(self) -> None:
        try:
            for response in self._call:
                self._events.put(Said(self, response))
        except grpc.RpcError as error:
            self._events.put(Ended(self, error))
        else:
            self._events.put(Ended(self, None))


class Feeder:
    """Takes frames from the application in a thread of its own, as many as there is room for."""

    def __init__(
        self, frames: Iterable[session_pb2.Frame], room: int, events: queue.SimpleQueue[Event]
    ) -> None:
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
                self._events.put(Given(self, frame))
        except BaseException as error:
            self._events.put(Given(self, error=error))
        else:
            self._events.put(Given(self))
