"""Maps: lists, files, and what changes a map as a whole."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from waypost import answers
from waypost.answers import LoopClosure
from waypost.connection import Connection, File, chunks, resource
from waypost.errors import AlreadyExists, NotFound
from waypost.v1 import job_pb2, map_pb2


class MapCalls:
    """Maps, by `{map}` or `maps/{map}`."""

    _connection: Connection

    def maps(self) -> list[map_pb2.Map]:
        """All maps, by name."""
        request = map_pb2.ListMapsRequest()
        return list(self._connection.pages(self._connection.maps.ListMaps, request, lambda page: page.maps))

    def map(self, map_id: str, *, full: bool = False) -> map_pb2.Map:
        """A map; `full` also with its state hash and its weight, which take time.

        Raises:
            NotFound: If there is no such map.
        """
        view = map_pb2.MAP_VIEW_FULL if full else map_pb2.MAP_VIEW_BASIC
        request = map_pb2.GetMapRequest(name=resource("maps", map_id), view=view)
        found: map_pb2.Map = self._connection.call(self._connection.maps.GetMap, request)
        return found

    def create_map(
        self, map_id: str, model: str = "", settings: map_pb2.MapSettings | None = None
    ) -> map_pb2.Map:
        """Makes an empty map of a model.

        Args:
            map_id: 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit.
            model: The model's hash, an unambiguous beginning of it, or its display name; if left out, the
                server's only model: the one that ships, until another is trained or imported.
            settings: How the map decides; what is left out has its default.

        Raises:
            AlreadyExists: If there is a map of that name.
            NotFound: If there is no such model.
            InvalidArgument: If no model is named and the server has more than one.
        """
        request = map_pb2.CreateMapRequest(map_id=map_id, model=model, settings=settings)
        made: map_pb2.Map = self._connection.call(self._connection.maps.CreateMap, request)
        return made

    def get_or_create_map(
        self, map_id: str, model: str = "", settings: map_pb2.MapSettings | None = None
    ) -> map_pb2.Map:
        """The map of that name as it is; where there is none, one is made as by `create_map`.

        Raises:
            NotFound: If the map is to be made, and there is no such model.
            InvalidArgument: If it is to be made, no model is named, and the server has more than one.
        """
        try:
            return self.map(map_id)
        except NotFound:
            pass
        try:
            return self.create_map(map_id, model, settings)
        except AlreadyExists:
            # Somebody else was faster.
            return self.map(map_id)

    def delete_map(self, map_id: str) -> None:
        """Deletes a map with all its sessions.

        Raises:
            NotFound: If there is no such map.
        """
        request = map_pb2.DeleteMapRequest(name=resource("maps", map_id))
        self._connection.call(self._connection.maps.DeleteMap, request)

    def loop_closures(self, map_id: str) -> list[LoopClosure]:
        """All loop closures of a map, oldest first.

        Raises:
            NotFound: If there is no such map.
        """
        request = map_pb2.ListLoopClosuresRequest(map=resource("maps", map_id))
        pages = self._connection.pages(
            self._connection.maps.ListLoopClosures, request, lambda page: page.loop_closures
        )
        return [answers.loop_closure(closure) for closure in pages]

    def rebind_map(self, map_id: str, model: str) -> map_pb2.Map:
        """Continues a map with another model of the same words; earlier decisions stay.

        Raises:
            NotFound: If there is no such map or model.
            FailedPrecondition: If the words differ.
        """
        request = map_pb2.RebindMapRequest(name=resource("maps", map_id), model=model)
        rebound: map_pb2.Map = self._connection.call(self._connection.maps.RebindMap, request)
        return rebound

    def rebuild_map(self, map_id: str, model: str, into: str) -> job_pb2.Job:
        """Makes a new map, `into`, from what a map keeps of its frames, with a model of other words.

        Raises:
            NotFound: If there is no such map or model.
            FailedPrecondition: If the map keeps neither images nor descriptors.
        """
        request = map_pb2.RebuildMapRequest(name=resource("maps", map_id), model=model, map_id=_bare(into))
        job: job_pb2.Job = self._connection.call(self._connection.maps.RebuildMap, request)
        return job

    def repair_map(self, map_id: str, into: str, copy: str = "") -> job_pb2.Job:
        """Makes a new map, `into`, from what is left of a damaged one. The job's last stage tells the losses.

        Args:
            map_id: The damaged map; it stays as it is.
            into: Name of the new map.
            copy: The map as it was earlier, imported from a snapshot: what is damaged is taken from it.

        Raises:
            NotFound: If there is no such map.
            FailedPrecondition: If no damage was found in the map, or the copy is none of it.
        """
        source = resource("maps", copy) if copy else ""
        request = map_pb2.RepairMapRequest(name=resource("maps", map_id), map_id=_bare(into), copy=source)
        job: job_pb2.Job = self._connection.call(self._connection.maps.RepairMap, request)
        return job

    def compact_map(self, map_id: str) -> job_pb2.Job:
        """Forgets how a map came to be what it is, and wipes deleted data from the disk: no way back.

        Raises:
            NotFound: If there is no such map.
        """
        request = map_pb2.CompactMapRequest(name=resource("maps", map_id))
        job: job_pb2.Job = self._connection.call(self._connection.maps.CompactMap, request)
        return job

    def trim_map(
        self,
        map_id: str,
        max_places: int,
        mode: map_pb2.TrimMapRequest.Mode = map_pb2.TrimMapRequest.MODE_PREVIEW,
    ) -> map_pb2.TrimMapResponse:
        """Which places can be dropped until at most `max_places` remain; `MODE_APPLY` drops them, for good.

        Raises:
            NotFound: If there is no such map.
            FailedPrecondition: While a robot navigates in the map.
        """
        request = map_pb2.TrimMapRequest(name=resource("maps", map_id), max_places=max_places, mode=mode)
        trimmed: map_pb2.TrimMapResponse = self._connection.call(self._connection.maps.TrimMap, request)
        return trimmed

    def export_map(self, map_id: str, file: File) -> int:
        """Writes a snapshot of a map with its model; gives its length in bytes.

        It is streamed: the map may be larger than memory. Robots may stream into it meanwhile.

        Args:
            map_id: The map.
            file: A file that is open for bytes, or the name of one that is not there yet.

        Raises:
            NotFound: If there is no such map.
            FileExistsError: If there is a file of that name.
            ResourceExhausted: During too many other exports.
        """
        request = map_pb2.ExportMapRequest(name=resource("maps", map_id))
        return self._connection.download(self._connection.maps.ExportMap, request, file)

    def import_map(self, file: File, map_id: str = "") -> job_pb2.Job:
        """Uploads a snapshot as a new map; gives the job that checks and stores it.

        Args:
            file: The snapshot, which is streamed.
            map_id: The new map's name; the one in the file if left out.

        Raises:
            AlreadyExists: If a map has that name.
            InvalidArgument: If the file is no snapshot, or a damaged one.
        """

        def requests() -> Iterator[map_pb2.ImportMapRequest]:
            # Sent even for an empty file, which the server then refuses.
            yield map_pb2.ImportMapRequest(map_id=_bare(map_id) or None)
            for chunk in chunks(file):
                yield map_pb2.ImportMapRequest(chunk=chunk)

        job: job_pb2.Job = self._connection.upload(self._connection.maps.ImportMap, requests())
        return job

    def export_poses(
        self,
        name: str,
        file: File,
        format: map_pb2.ExportPosesRequest.Format | str,  # noqa: A002
        *,
        frame: map_pb2.ExportPosesRequest.Frame | str = map_pb2.ExportPosesRequest.FRAME_UNSPECIFIED,
        body: map_pb2.ExportPosesRequest.Body | str = map_pb2.ExportPosesRequest.BODY_UNSPECIFIED,
    ) -> int:
        """Writes poses as text: a session's trajectory or a map's pose graph; gives the length in bytes.

        Args:
            name: maps/{map}/sessions/{session}; maps/{map} for "g2o".
            file: As in `export_map`.
            format: "tum", "kitti" or "g2o"; or a `Format` of `map_pb2.ExportPosesRequest`.
            frame: "map", corrected by loop closures (the default), or "odom"; or a `Frame`.
            body: "base" (the default) or "camera"; or a `Body`.

        Raises:
            ValueError: If there is no such format, frame or body.
            NotFound: If there is no such session or map.
            FailedPrecondition: If it has no such poses.
        """
        kinds = map_pb2.ExportPosesRequest
        request = map_pb2.ExportPosesRequest(
            name=name,
            format=_choice("format", kinds.Format, format),
            frame=_choice("frame", kinds.Frame, frame),
            body=_choice("body", kinds.Body, body),
        )
        return self._connection.download(self._connection.maps.ExportPoses, request, file)


def _choice(of: str, choices: Any, chosen: int | str) -> Any:
    """The number of a choice that is given by its name in the contract or the end of it, as in "tum"."""
    if not isinstance(chosen, str):
        return chosen
    prefix = f"{of}_".upper()
    name = prefix + chosen.upper().removeprefix(prefix)
    names = [known for known in choices.keys() if not known.endswith("_UNSPECIFIED")]  # noqa: SIM118
    if name not in names:
        known = ", ".join(known.removeprefix(prefix).lower() for known in names)
        raise ValueError(f"there is no {of} {chosen!r}; give one of {known}")
    return choices.Value(name)


def _bare(map_id: str) -> str:
    return map_id[len("maps/") :] if map_id.startswith("maps/") else map_id
