"""Merges: maps that become one."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Callable

from waypost.connection import Connection, resource
from waypost.v1 import merge_pb2


class MergeCalls:
    """A merge is searched, proposed, and then committed or discarded; a committed one can be undone."""

    _connection: Connection

    def merge_maps(
        self,
        sources: Iterable[str],
        target: str,
        *,
        auto_commit: bool = False,
        min_support: int | None = None,
    ) -> merge_pb2.Merge:
        """Begins to search for the overlap of maps; wait for its `job`, then look at `merge(name)`.

        Args:
            sources: `{map}` or `maps/{map}`, each once; at most 16 beside the target.
            target: The map that they become part of; made from them, the first one first, if there is none.
            auto_commit: Commits as soon as an overlap of every source was found.
            min_support: How many matches must agree with each other, at least 3; 5 if left out.

        Raises:
            NotFound: If there is no such map.
            FailedPrecondition: If their models have different words.
        """
        request = merge_pb2.MergeMapsRequest(
            sources=[resource("maps", source) for source in sources],
            target=resource("maps", target),
            auto_commit=auto_commit,
            min_support=min_support,
        )
        return self._merge(self._connection.merges.MergeMaps, request)

    def merge(self, name: str) -> merge_pb2.Merge:
        """A merge (`merges/{number}`, or its number alone) as it is now.

        Raises:
            NotFound: If there is no such merge.
        """
        request = merge_pb2.GetMergeRequest(name=resource("merges", name))
        return self._merge(self._connection.merges.GetMerge, request)

    def merges(self) -> list[merge_pb2.Merge]:
        """All merges, newest first."""
        request = merge_pb2.ListMergesRequest()
        return list(
            self._connection.pages(self._connection.merges.ListMerges, request, lambda page: page.merges)
        )

    def merge_picture(self, name: str) -> bytes:
        """The maps before and after, as SVG.

        Raises:
            NotFound: If there is no such merge.
            FailedPrecondition: If its search did not finish.
        """
        request = merge_pb2.GetMergePictureRequest(name=resource("merges", name))
        picture: bytes = self._connection.call(self._connection.merges.GetMergePicture, request).picture
        return picture

    def commit_merge(self, name: str) -> merge_pb2.Merge:
        """Carries out a proposed merge: wholly or not at all. Wait for its `job`.

        Raises:
            FailedPrecondition: If it is no proposal.
        """
        request = merge_pb2.CommitMergeRequest(name=resource("merges", name))
        return self._merge(self._connection.merges.CommitMerge, request)

    def discard_merge(self, name: str) -> merge_pb2.Merge:
        """Rejects a proposed merge: the maps stay as they are.

        Raises:
            FailedPrecondition: If it is no proposal.
        """
        request = merge_pb2.DiscardMergeRequest(name=resource("merges", name))
        return self._merge(self._connection.merges.DiscardMerge, request)

    def undo_merge(self, name: str) -> merge_pb2.Merge:
        """Removes from its target what a merge has added. Wait for its `job`.

        Raises:
            FailedPrecondition: If it was not committed, or a robot navigates in the map.
        """
        request = merge_pb2.UndoMergeRequest(name=resource("merges", name))
        return self._merge(self._connection.merges.UndoMerge, request)

    def _merge(self, method: Callable[..., Any], request: object) -> merge_pb2.Merge:
        merge: merge_pb2.Merge = self._connection.call(method, request)
        return merge
