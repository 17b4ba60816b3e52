"""Places of maps: what they look like, how they are connected, and what people call them."""

from __future__ import annotations

from waypost.connection import Connection, resource
from waypost.v1 import appearance_pb2, label_pb2, map_pb2


class PlaceCalls:
    """Places, by the number that they have in their map."""

    _connection: Connection

    def places(self, map_id: str) -> list[map_pb2.Place]:
        """All places of a map, oldest first, without their words.

        Raises:
            NotFound: If there is no such map.
        """
        request = map_pb2.ListPlacesRequest(map=resource("maps", map_id))
        return list(
            self._connection.pages(self._connection.maps.ListPlaces, request, lambda page: page.places)
        )

    def place(self, map_id: str, place_number: int) -> map_pb2.Place:
        """A place with its words.

        Raises:
            NotFound: If there is no such place.
        """
        request = map_pb2.GetPlaceRequest(name=_place(map_id, place_number))
        found: map_pb2.Place = self._connection.call(self._connection.maps.GetPlace, request)
        return found

    def word_places(self, map_id: str, word: int) -> list[map_pb2.WordPlace]:
        """The places where a word was seen, by number.

        Raises:
            NotFound: If there is no such map.
            InvalidArgument: If the vocabulary has no such word.
        """
        request = map_pb2.ListWordPlacesRequest(map=resource("maps", map_id), word=word)
        return list(
            self._connection.pages(self._connection.maps.ListWordPlaces, request, lambda page: page.places)
        )

    def match_matrix(self, map_id: str, against: str | None = None) -> map_pb2.MatchMatrix:
        """How a map's match matrix is laid out: which of its places look alike.

        Args:
            map_id: The map whose places are the rows.
            against: The map whose places are the columns, of the same model; the map itself if None.

        Raises:
            NotFound: If there is no such map.
            FailedPrecondition: If the maps have different models.
        """
        request = map_pb2.GetMatchMatrixRequest(
            map=resource("maps", map_id), against="" if against is None else resource("maps", against)
        )
        matrix: map_pb2.MatchMatrix = self._connection.call(self._connection.maps.GetMatchMatrix, request)
        return matrix

    def match_matrix_tile(
        self, map_id: str, level: int, row: int, column: int, *, against: str | None = None
    ) -> bytes:
        """A square piece of a match matrix as PNG, 8 bits of grey a cell.

        Args:
            map_id: The map whose places are the rows.
            level: Zoom level: a cell is the largest of 2^level x 2^level pairs of places.
            row: Which tile from above, from 0.
            column: Which tile from the left, from 0.
            against: As in match_matrix.

        Raises:
            InvalidArgument: If the matrix has no such level.
            NotFound: If it has no such tile, or there is no such map.
            FailedPrecondition: If the maps have different models.
        """
        request = map_pb2.GetMatchMatrixTileRequest(
            map=resource("maps", map_id),
            against="" if against is None else resource("maps", against),
            level=level,
            row=row,
            column=column,
        )
        picture: bytes = self._connection.call(self._connection.maps.GetMatchMatrixTile, request).picture
        return picture

    def appearance_graph(self, map_id: str) -> appearance_pb2.AppearanceGraph:
        """Which places can be matched with each other, and the spaces that they form.

        Raises:
            NotFound: If there is no such map.
            FailedPrecondition: If the map is not navigated by appearance.
        """
        request = appearance_pb2.GetAppearanceGraphRequest(map=resource("maps", map_id))
        graph: appearance_pb2.AppearanceGraph = self._connection.call(
            self._connection.appearance.GetAppearanceGraph, request
        )
        return graph

    def labels(self, map_id: str) -> dict[int, str]:
        """The labels of a map, by the numbers of their places.

        Raises:
            NotFound: If there is no such map.
        """
        request = label_pb2.ListLabelsRequest(map=resource("maps", map_id))
        pages = self._connection.pages(self._connection.labels.ListLabels, request, lambda page: page.labels)
        return {_number(label.place): label.label for label in pages}

    def set_label(
        self,
        map_id: str,
        place_number: int,
        label: str,
        scope: label_pb2.LabelScope = label_pb2.LABEL_SCOPE_PLACE,
    ) -> list[int]:
        """Labels a place, or with `LABEL_SCOPE_SPACE` all of its space; gives the numbers of those labelled.

        Raises:
            NotFound: If there is no such place.
            InvalidArgument: If that cannot be a label.
            FailedPrecondition: For a space of a map that is not navigated by appearance.
        """
        request = label_pb2.SetLabelRequest(place=_place(map_id, place_number), label=label, scope=scope)
        answer = self._connection.call(self._connection.labels.SetLabel, request)
        return [_number(set_label.place) for set_label in answer.labels]

    def delete_label(self, map_id: str, place_number: int) -> None:
        """Takes a place's label away.

        Raises:
            NotFound: If it has none.
        """
        request = label_pb2.DeleteLabelRequest(place=_place(map_id, place_number))
        self._connection.call(self._connection.labels.DeleteLabel, request)


def _place(map_id: str, place_number: int) -> str:
    return f"{resource('maps', map_id)}/places/{place_number}"


def _number(place: str) -> int:
    return int(place.rpartition("/")[2])
