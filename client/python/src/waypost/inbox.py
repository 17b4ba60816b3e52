"""What a thread tells the application, until it ends."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator
from typing import Callable, Generic, TypeVar

T = TypeVar("T")


class Inbox(Generic[T]):
    """Items from one thread for others, and at last the error that ended it, if there was one."""

    def __init__(self, longest: int | None = None) -> None:
        self._items: deque[T] = deque()
        self._longest = longest
        self._changed = threading.Condition()
        self._ended = False
        self._error: BaseException | None = None
        #: Called after every change, by the thread that made it.
        self.on_change: Callable[[], None] | None = None

    def put(self, item: T) -> None:
        """Adds an item; dropped if the longest queue waits already."""
        with self._changed:
            if self._longest is None or len(self._items) < self._longest:
                self._items.append(item)
        self.notify()

    def end(self, error: BaseException | None = None) -> None:
        """No more items come. The first end counts."""
        with self._changed:
            if not self._ended:
                self._ended, self._error = True, error
        self.notify()

    def notify(self) -> None:
        """Wakes all threads that wait."""
        with self._changed:
            self._changed.notify_all()
        if self.on_change is not None:
            self.on_change()

    @property
    def ready(self) -> bool:
        """Whether `get` would not wait."""
        return bool(self._items) or self._ended

    @property
    def ended(self) -> bool:
        """Whether no more items come."""
        return self._ended

    def get(self, timeout_s: float | None = None) -> T | None:
        """The next item; None after the last, or if none came in time. Raises the error that ended it."""
        until = None if timeout_s is None else time.monotonic() + timeout_s
        with self._changed:
            while not self._items and not self._ended:
                left = None if until is None else until - time.monotonic()
                if left is not None and left <= 0:
                    return None
                self._changed.wait(left)
            if self._items:
                return self._items.popleft()
        self.reraise()
        return None

    def reraise(self) -> None:
        """Raises the error that ended it, if there was one."""
        if self._error is not None:
            raise self._error

    def __iter__(self) -> Iterator[T]:
        while (item := self.get()) is not None:
            yield item
