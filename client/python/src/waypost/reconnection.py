"""When to try again, and when to give up."""

from __future__ import annotations

import random
import time

import grpc

#: Opening a large map takes a server seconds.
OPENING_TIMEOUT_S = 30.0
_FIRST_DELAY_S = 0.1
_LONGEST_DELAY_S = 5.0
#: Ends of a stream that are worth another attempt. UNKNOWN stands for one that was cut off without a status.
PASSING = frozenset(
    {
        grpc.StatusCode.UNAVAILABLE,
        grpc.StatusCode.RESOURCE_EXHAUSTED,
        grpc.StatusCode.DEADLINE_EXCEEDED,
        grpc.StatusCode.CANCELLED,
        grpc.StatusCode.UNKNOWN,
    }
)


class Patience:
    """Delays that double, shortened at random by up to half so that robots do not all come back at once."""

    def __init__(self, patience_s: float) -> None:
        if not patience_s >= 0:
            raise ValueError("patience_s must be 0 or more")
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

    @property
    def in_trouble(self) -> bool:
        """Whether there was a failure since the last progress."""
        return self._trouble_since is not None

    def waited_s(self) -> float:
        """Time since the present trouble began."""
        return 0.0 if self._trouble_since is None else time.monotonic() - self._trouble_since
