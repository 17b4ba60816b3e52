"""What happens in maps, while it happens."""

from __future__ import annotations

from collections.abc import Iterator
from types import TracebackType
from typing import Any

import grpc

from waypost import errors
from waypost.connection import Connection, resource
from waypost.v1 import event_pb2


class EventCalls:
    """Maps that are watched."""

    _connection: Connection

    def watch(self, map_id: str, from_position: int | None = None) -> MapEvents:
        """What happens in a map: frames that were decided, and robots that navigate. Close it when done.

        Args:
            map_id: `{map}` or `maps/{map}`.
            from_position: Frames from this position of the map's log on come first, 0 for all. Left out, only
                frames that are decided from now on. To go on after a broken connection: one more than the
                last position.

        Raises:
            NotFound: While iterating, if there is no such map, or once it is deleted.
            Aborted: While iterating, when sessions were removed from the map, which changes positions.
        """
        request = event_pb2.WatchRequest(map=resource("maps", map_id), from_position=from_position)
        return MapEvents(self._connection.events.Watch(request), self._connection.address)


class MapEvents(Iterator[event_pb2.MapEvent]):
    """What happens in a map, until it is closed."""

    def __init__(self, call: Any, address: str) -> None:
        self._call = call
        self._address = address

    def __next__(self) -> event_pb2.MapEvent:
        try:
            event: event_pb2.MapEvent = next(self._call)
        except grpc.RpcError as error:
            if self._call.cancelled():
                raise StopIteration from None
            raise errors.from_call(error, self._address) from None
        return event

    def close(self) -> None:
        """Stops watching: who iterates in another thread comes to the end."""
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
