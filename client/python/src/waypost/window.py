"""The frames that have no outcome yet, in the order they were given."""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import grpc

from waypost import answers
from waypost.answers import Outcome
from waypost.errors import InvalidArgument, ProtocolError, ResourceExhausted, Unavailable
from waypost.frames import MAX_IMAGE_BYTES
from waypost.v1 import session_pb2


class _Progress(enum.Enum):
    #: To be sent over the present connection.
    WAITING = enum.auto()
    IN_FLIGHT = enum.auto()
    #: The server asked to send it again later.
    POSTPONED = enum.auto()
    DONE = enum.auto()


@dataclass
class _Entry:
    frame: session_pb2.Frame
    progress: _Progress = _Progress.WAITING
    outcome: Outcome | None = None


class Window:
    """Every frame from when the application gives it until it gets its outcome back."""

    def __init__(self) -> None:
        self._entries: deque[_Entry] = deque()
        #: Last frame that the server answered.
        self.last_acknowledged: int | None = None

    def __len__(self) -> int:
        return len(self._entries)

    def push(self, frame: session_pb2.Frame) -> None:
        """Takes a frame. One that no server would take is refused here."""
        entry = _Entry(frame)
        if len(frame.image) > MAX_IMAGE_BYTES:
            too_long = InvalidArgument(
                grpc.StatusCode.INVALID_ARGUMENT,
                f"the image has {len(frame.image)} bytes, more than {MAX_IMAGE_BYTES}; "
                "make it smaller or compress it harder",
            )
            entry.outcome = answers.Refusal(frame.sequence, self.last_acknowledged, too_long)
            entry.progress = _Progress.DONE
        self._entries.append(entry)

    def to_send(self) -> Iterator[session_pb2.Frame]:
        """The frames to send now, which then count as sent.

        Nothing overtakes a postponed frame: once a later one were durable, it could not be any more.
        """
        for entry in self._entries:
            if entry.progress == _Progress.POSTPONED:
                return
            if entry.progress == _Progress.WAITING:
                entry.progress = _Progress.IN_FLIGHT
                yield entry.frame

    def settle(self, outcome: Outcome) -> answers.Refusal | None:
        """Takes an outcome from the server; gives it back if the frame is to be sent again later.

        Raises:
            ProtocolError: If no frame of that number is under way.
        """
        entry = next((e for e in self._entries if self._awaits(e, outcome.sequence)), None)
        if entry is None:
            raise ProtocolError(f"the server answered frame {outcome.sequence}, which was not sent")
        if isinstance(outcome, answers.Refusal):
            if isinstance(outcome.error, (Unavailable, ResourceExhausted)):
                entry.progress = _Progress.POSTPONED
                return outcome
        else:
            self.last_acknowledged = max(self.last_acknowledged or 0, outcome.sequence)
        entry.progress, entry.outcome = _Progress.DONE, outcome
        return None

    def outcomes(self) -> Iterator[Outcome]:
        """The outcomes of the oldest frames, which then leave the window."""
        while self._entries:
            outcome = self._entries[0].outcome
            if outcome is None:
                return
            self._entries.popleft()
            yield outcome

    def only_postponed_left(self) -> bool:
        """Whether all frames that were sent are settled, and some of them are to be sent again."""
        under_way = {entry.progress for entry in self._entries}
        return _Progress.POSTPONED in under_way and _Progress.IN_FLIGHT not in under_way

    def release_postponed(self) -> None:
        """Postponed frames may go again."""
        self._wait(_Progress.POSTPONED)

    def send_again(self) -> None:
        """The connection broke: everything without an outcome has to go over the next one.

        Also frames that were committed while their answer was lost: those get the stored answer.
        """
        self._wait(_Progress.POSTPONED, _Progress.IN_FLIGHT)

    def clear(self) -> None:
        """Forgets all frames."""
        self._entries.clear()

    def _wait(self, *of: _Progress) -> None:
        for entry in self._entries:
            if entry.progress in of:
                entry.progress = _Progress.WAITING

    @staticmethod
    def _awaits(entry: _Entry, sequence: int) -> bool:
        return entry.frame.sequence == sequence and entry.progress == _Progress.IN_FLIGHT
