"""Frames pushed by callbacks, in place of an iterator that is pulled."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from contextlib import closing
from types import TracebackType
from typing import TYPE_CHECKING, Callable

from waypost import errors
from waypost.answers import Outcome
from waypost.frames import Frame
from waypost.inbox import Inbox
from waypost.v1 import session_pb2

if TYPE_CHECKING:
    from waypost.session import Session


class Sender:
    """Takes frames from any thread and never waits, unless asked to. Made by `Session.sender`.

    What became of each frame comes in the order of sending: to `on_outcome`, or by iterating this.
    Left as a context manager, it waits until every frame has its outcome; left by an exception, it does not.

    >>> with client.session("docs", "robot") as session, session.sender() as sender:
    ...     sender.send(waypost.Frame(2, 2, image))
    ...     sender.next_outcome().sequence
    2
    """

    def __init__(
        self, session: Session, on_outcome: Callable[[Outcome], None] | None, queue_frames: int
    ) -> None:
        if queue_frames < 1:
            raise ValueError("queue_frames must be at least 1")
        self._session = session
        self._on_outcome = on_outcome
        self._queue_frames = queue_frames
        self._frames: queue.SimpleQueue[session_pb2.Frame | None] = queue.SimpleQueue()
        self._changed = threading.Condition()
        #: Frames whose outcomes nobody has taken yet.
        self._under_way = 0
        self._last_sequence: int | None = None
        self._finished = False
        #: What `next_outcome` takes from.
        self.outcomes: Inbox[Outcome] = Inbox()
        self._thread = threading.Thread(target=self._pump, name="waypost-sender", daemon=True)
        self._thread.start()

    def send(self, frame: Frame, *, timeout_s: float = 0.0) -> None:
        """Queues a frame for the server.

        Args:
            frame: Its number is above the last one's.
            timeout_s: How long to wait for room.

        Raises:
            QueueFull: If `queue_frames` frames have no outcome yet: this one was not taken, the next may be.
            ValueError: If the number does not rise, or the frame cannot be sent: it was not taken.
            WaypostError: If the session is over, why; or if this was closed.
        """
        message = self._session.message(frame)
        with self._changed:
            self._changed.wait_for(self._has_room_or_ended, timeout_s)
            self.outcomes.reraise()
            if self._finished or self.outcomes.ended:
                raise errors.WaypostError(
                    f"frame {frame.sequence} was not sent: its sender was closed; make another one"
                )
            last = self._last_sequence
            if last is not None and frame.sequence <= last:
                raise ValueError(
                    f"frame {frame.sequence} follows frame {last}; number frames so that every number is "
                    "above the last"
                )
            if self._under_way >= self._queue_frames:
                taken = "" if self._on_outcome else ", or iterate the sender, which makes room too"
                raise errors.QueueFull(
                    f"frame {frame.sequence} was not taken: {self._under_way} frames wait for outcomes; "
                    f"send fewer, give timeout_s to wait, or ask for a longer queue_frames{taken}"
                )
            self._last_sequence = frame.sequence
            self._under_way += 1
            # Under the lock, so that frames go in the order of their numbers.
            self._frames.put(message)

    def finish(self) -> None:
        """Says that no more frames come. The outcomes of those that were sent still do."""
        with self._changed:
            if not self._finished:
                self._finished = True
                self._frames.put(None)

    def close(self) -> None:
        """Waits until every frame has its outcome.

        Raises:
            WaypostError: Why the session ended before, if it did.
        """
        self.finish()
        # A callback cannot wait for itself.
        if threading.current_thread() is not self._thread:
            self._thread.join()
            self.outcomes.reraise()

    def abort(self) -> None:
        """Gives up the frames that have no outcome yet; those that were sent may be durable all the same."""
        self.finish()
        while threading.current_thread() is not self._thread and self._thread.is_alive():
            self._session._interrupt()
            # Again, if its stream had not begun yet.
            self._thread.join(0.1)

    @property
    def ended(self) -> bool:
        """Whether all that it took has its outcome, or the session is over."""
        return self.outcomes.ended

    def next_outcome(self, timeout_s: float | None = None) -> Outcome | None:
        """The next outcome; None after the last one, or if none came in time.

        Raises:
            WaypostError: Why the session ended, if it did.
        """
        outcome = self.outcomes.get(timeout_s)
        if outcome is not None:
            self._make_room()
        return outcome

    def __iter__(self) -> Iterator[Outcome]:
        while (outcome := self.next_outcome()) is not None:
            yield outcome

    def __enter__(self) -> Sender:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        else:
            self.abort()

    def _has_room_or_ended(self) -> bool:
        return self._under_way < self._queue_frames or self._finished or self.outcomes.ended

    def _make_room(self) -> None:
        with self._changed:
            self._under_way -= 1
            self._changed.notify()

    def _pump(self) -> None:
        """The sender's own thread: it iterates the session as an application would."""
        error: BaseException | None = None
        try:
            with closing(self._session._stream(iter(self._frames.get, None))) as stream:
                for outcome in stream:
                    if self._on_outcome is None:
                        self.outcomes.put(outcome)
                    else:
                        self._on_outcome(outcome)
                        self._make_room()
        except errors.Interrupted:
            pass
        except BaseException as raised:
            error = raised
        self.outcomes.end(error)
        # The session's feeder may wait for another frame.
        self._frames.put(None)
        with self._changed:
            self._changed.notify_all()
