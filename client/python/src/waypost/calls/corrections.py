"""Corrections: what people say of loop closures, against what the map decided."""

from __future__ import annotations

from typing import Any, Callable

from waypost.connection import Connection, resource
from waypost.v1 import correction_pb2, map_pb2


class CorrectionCalls:
    """A loop closure is withdrawn, or one that the map missed confirmed; both can be undone."""

    _connection: Connection

    def withdraw_loop_closure(self, frame: str) -> map_pb2.Correction:
        """Withdraws the loop closure of a frame: links that rested on it are taken out.

        Args:
            frame: maps/{map}/sessions/{session}/frames/{sequence}: the frame that closed the loop.

        Raises:
            NotFound: If there is no such frame.
            FailedPrecondition: If it closed no loop, or its loop closure was withdrawn.
        """
        request = correction_pb2.WithdrawLoopClosureRequest(frame=frame)
        return self._correction(self._connection.corrections.WithdrawLoopClosure, request)

    def confirm_loop_closure(self, frame: str, matched_frame: str) -> map_pb2.Correction:
        """Says that two frames were taken at the same place, which the map has as two: they are linked.

        Args:
            frame: maps/{map}/sessions/{session}/frames/{sequence}: the frame that came in last.
            matched_frame: The earlier frame, of any session of the same map.

        Raises:
            NotFound: If there is no such frame.
            InvalidArgument: If the frames are the wrong way round, or of two maps.
            FailedPrecondition: If the map has them at one place, or has metres and nothing to measure by.
        """
        request = correction_pb2.ConfirmLoopClosureRequest(frame=frame, matched_frame=matched_frame)
        return self._correction(self._connection.corrections.ConfirmLoopClosure, request)

    def undo_correction(self, name: str) -> map_pb2.Correction:
        """Undoes a correction: the map is as if it had not been made.

        Args:
            name: maps/{map}/corrections/{correction}.

        Raises:
            NotFound: If there is none of that name, or it was undone.
            FailedPrecondition: If a later one is about the same session: undo that first.
        """
        request = correction_pb2.UndoCorrectionRequest(name=name)
        return self._correction(self._connection.corrections.UndoCorrection, request)

    def corrections(self, map_id: str) -> list[map_pb2.Correction]:
        """All that people said of the loop closures of a map, oldest first, undone or not.

        Raises:
            NotFound: If there is no such map.
        """
        request = correction_pb2.ListCorrectionsRequest(map=resource("maps", map_id))
        method = self._connection.corrections.ListCorrections
        return list(self._connection.pages(method, request, lambda page: page.corrections))

    def _correction(self, method: Callable[..., Any], request: object) -> map_pb2.Correction:
        correction: map_pb2.Correction = self._connection.call(method, request)
        return correction
