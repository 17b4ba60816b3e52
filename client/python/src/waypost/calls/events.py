"""What happens in maps, while it happens, and what the server refused."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import TracebackType
from typing import Any

import grpc

from waypost import errors
from waypost.connection import Connection, resource
from waypost.reconnection import PASSING, Patience
from waypost.v1 import event_pb2


class EventCalls:
    """Maps that are watched, and what was refused."""

    _connection: Connection

    def refusals(self) -> list[event_pb2.Refusal]:
        """What the server refused since it began, newest first; the last 1000 are kept.

        Calls, requests, and frames, wheel reports and goals on open streams. For administrators of the
        whole server.

        Raises:
            PermissionDenied: If the token is for less than that.
        """
        request = event_pb2.ListRefusalsRequest()
        return list(
            self._connection.pages(self._connection.events.ListRefusals, request, lambda page: page.refusals)
        )

    def metrics_history(self) -> event_pb2.MetricsHistory:
        """How the server fared over the last hour: its metrics, every 15 seconds."""
        request = event_pb2.GetMetricsHistoryRequest()
        history: event_pb2.MetricsHistory = self._connection.call(
            self._connection.events.GetMetricsHistory, request
        )
        return history

    def watch(self, map_id: str, from_position: int | None = None, *, patience_s: float = 60.0) -> MapEvents:
        """What happens in a map: frames that were decided, and robots that navigate. Close it when done.

        When the connection breaks, it goes on over another one: no frame is missed, and none told twice.

        Args:
            map_id: `{map}` or `maps/{map}`.
            from_position: Frames from this position of the map's log on come first, 0 for all. Left out, only
                frames that are decided from now on.
            patience_s: How long it tries to reach the server again.

        Raises:
            NotFound: While iterating, if there is no such map, or once it is deleted.
            Aborted: While iterating, when sessions were removed from the map, which changes positions.
            ServerUnreachable: While iterating, if the server was away for longer than `patience_s`.
        """
        return MapEvents(self._connection, resource("maps", map_id), from_position, Patience(patience_s))


class MapEvents(Iterator[event_pb2.MapEvent]):
    """What happens in a map, until it is closed."""

    def __init__(
        self, connection: Connection, map_name: str, from_position: int | None, patience: Patience
    ) -> None:
        self._connection = connection
        self._map = map_name
        #: To go on from; None while the server has not said where the log ends.
        self._next_position = from_position
        #: The log that positions are of; empty while the server has not named it.
        self._log = ""
        self._patience = patience
        self._has_begun = False
        self._closed = threading.Event()
        self._call = self._watch()

    def __next__(self) -> event_pb2.MapEvent:
        while True:
            try:
                event: event_pb2.MapEvent = next(self._call)
            except StopIteration:
                self._try_again(None)
            except grpc.RpcError as error:
                self._try_again(error)
            else:
                self._has_begun = True
                self._patience.progress()
                if event.WhichOneof("event") == "started":
                    self._next_position = event.started.next_position
                    self._log = event.started.log
                    continue
                if event.WhichOneof("event") == "frame":
                    self._next_position = event.frame.position + 1
                return event

    def close(self) -> None:
        """Stops watching: who iterates in another thread comes to the end."""
        self._closed.set()
        self._call.cancel()

    def __enter__(self) -> MapEvents:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _watch(self) -> Any:
        request = event_pb2.WatchRequest(map=self._map, from_position=self._next_position, log=self._log)
        return self._connection.events.Watch(request)

    def _try_again(self, error: grpc.RpcError | None) -> None:
        """Watches over another connection, or raises what ended the one before."""
        if self._closed.is_set():
            raise StopIteration from None
        # What was never open is refused at once, as every call.
        passing = error is None or (self._has_begun and error.code() in PASSING)
        delay_s = self._patience.next_delay_s() if passing else None
        if delay_s is None:
            if error is None:
                raise errors.ServerUnreachable(f"{self._connection.address} ends every watch") from None
            raise errors.from_call(error, self._connection.address) from None
        if self._closed.wait(delay_s):
            raise StopIteration from None
        self._call = self._watch()
