"""What the application asked for, in order, until the server has it and did not refuse it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from waypost.v1 import navigation_pb2

#: More goals than a server refuses in a row. Of more, the oldest are forgotten.
MOST_GOALS = 4


class AskedGoals:
    """Goals and stops that were asked for.

    The server looks a goal up, which takes a moment. It says when it refuses one, and then goes on to the one
    before; it does not say when it takes one.
    """

    def __init__(self, first: navigation_pb2.Goal | None) -> None:
        #: Goals that the server has got since it was stopped and has not refused. It goes by the last.
        self._said: deque[navigation_pb2.Goal] = deque([] if first is None else [first], MOST_GOALS)
        #: What the server may not have got. A stop is the first: what was asked for before no longer counts.
        self._unsaid: list[_Unsaid] = []
        self._last_stamp_ns = 0
        #: With the next goal the server forgets the one that was reached.
        self._has_arrived = False

    def stamped(self, stamp_ns: int) -> None:
        """A report or a frame of this stamp is sent, after all that was asked for so far."""
        self._last_stamp_ns = max(self._last_stamp_ns, stamp_ns)

    def go_to(self, goal: navigation_pb2.Goal) -> navigation_pb2.NavigateRequest:
        """Asks for a goal; gives the request."""
        if self._has_arrived:
            self._said.clear()
        if len(self._unsaid) == MOST_GOALS:
            # A stop stays.
            del self._unsaid[1 if self.is_stopping else 0]
        return self._ask(navigation_pb2.NavigateRequest(goal=goal))

    def stop(self) -> navigation_pb2.NavigateRequest:
        """Asks to stand; gives the request."""
        self._unsaid.clear()
        return self._ask(navigation_pb2.NavigateRequest(stop=navigation_pb2.StopNavigation()))

    def guided(self, guidance: navigation_pb2.Guidance) -> None:
        """The server answered a report or a frame."""
        while self._unsaid and self._unsaid[0].after_stamp_ns < guidance.stamp_ns:
            request = self._unsaid.pop(0).request
            if request.HasField("goal"):
                self._said.append(request.goal)
            else:
                self._said.clear()
        self._has_arrived = guidance.status == navigation_pb2.NAVIGATION_STATUS_ARRIVED

    def refused(self, goal: navigation_pb2.Goal | None) -> None:
        """The server refused a goal; it names none if that is an image."""
        for at, unsaid in enumerate(self._unsaid):
            if unsaid.request.HasField("goal") and _is_same(unsaid.request.goal, goal):
                del self._unsaid[at]
                return
        for at in reversed(range(len(self._said))):
            if _is_same(self._said[at], goal):
                del self._said[at]
                return
        if self._said and _may_stand_for(self._said[-1], goal):
            self._said.pop()

    @property
    def for_opening(self) -> navigation_pb2.Goal | None:
        """What a restarted server is told, which knows of no goal."""
        return self._said[-1] if self._said and not self.is_stopping else None

    @property
    def unsaid(self) -> list[navigation_pb2.NavigateRequest]:
        """What the server may not have got, in order."""
        return [unsaid.request for unsaid in self._unsaid]

    @property
    def is_stopping(self) -> bool:
        """Whether the robot is to stand, and the server may not know it."""
        return bool(self._unsaid) and self._unsaid[0].request.HasField("stop")

    def _ask(self, request: navigation_pb2.NavigateRequest) -> navigation_pb2.NavigateRequest:
        self._unsaid.append(_Unsaid(request, self._last_stamp_ns))
        return request


@dataclass(frozen=True)
class _Unsaid:
    request: navigation_pb2.NavigateRequest
    #: Of the last report or frame before it. Requests are taken in order: with an answer to a later one, it
    #: has arrived.
    after_stamp_ns: int


def _is_same(asked: navigation_pb2.Goal, refused: navigation_pb2.Goal | None) -> bool:
    if refused is None:
        return asked.HasField("image")
    # By their bytes, since a number that is none does not equal itself.
    return asked.SerializeToString(deterministic=True) == refused.SerializeToString(deterministic=True)


def _may_stand_for(asked: navigation_pb2.Goal, refused: navigation_pb2.Goal | None) -> bool:
    """If no way leads to a label, the server names the place that has it."""
    return refused is not None and refused.HasField("place_number") and asked.HasField("label")
