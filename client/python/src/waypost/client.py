"""Calls about models and maps, and the connection they share with sessions."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Callable, TypeVar

import grpc

from waypost import answers, errors
from waypost.answers import LoopClosure, QueryAnswer
from waypost.frames import Image, WordHistogram, WordList, put_content
from waypost.session import Mode, Session, SessionOptions
from waypost.v1 import (
    geometry_pb2,
    map_pb2,
    map_pb2_grpc,
    model_pb2,
    model_pb2_grpc,
    recognition_pb2,
    recognition_pb2_grpc,
    session_pb2_grpc,
)

_CONNECT_TIMEOUT_S = 5.0
#: A page of places is the longest answer: 100 places with 100 frames each, about 2 MiB.
_MAX_ANSWER_BYTES = 16 << 20
_CHUNK_BYTES = 1 << 20
_OPTIONS = [
    ("grpc.max_receive_message_length", _MAX_ANSWER_BYTES),
    # A peer that vanished without a word is noticed after both of these.
    ("grpc.keepalive_time_ms", 10_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    # The channel's own delays, up to two minutes, would outlast the session's patience.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1_000),
    # This one is the time a connection may take.
    ("grpc.min_reconnect_backoff_ms", int(_CONNECT_TIMEOUT_S * 1_000)),
]

T = TypeVar("T")


def connect(
    address: str,
    *,
    token: str | None = None,
    ca: str | Path | bytes | None = None,
    tls: bool = False,
) -> Client:
    """Connects to a server at `HOST:PORT`.

    Args:
        address: Where the server listens for robots.
        token: Secret of a token, for a server that wants one. Without TLS it is sent in the clear.
        ca: Certificate of the authority that signed the server's, as PEM or as the file that holds it. Turns
            TLS on.
        tls: TLS with the authorities that this machine trusts.

    Raises:
        ServerUnreachable: If nobody answers there.
        Unauthenticated: If the server wants a token, or another one.
    """
    if ca is not None or tls:
        authority = ca if ca is None or isinstance(ca, bytes) else Path(ca).read_bytes()
        credentials = grpc.ssl_channel_credentials(root_certificates=authority)
        channel = grpc.secure_channel(address, credentials, options=_OPTIONS)
    else:
        channel = grpc.insecure_channel(address, options=_OPTIONS)
    if token is not None:
        channel = grpc.intercept_channel(channel, _Bearer(token))
    client = Client(channel, address)
    try:
        client._greet()
    except BaseException:
        client.close()
        raise
    return client


class Client:
    """A connection to a server, made by `connect`. It mends itself for the next call when it broke.

    What is not here is in the contract: `waypost.v1.map_pb2_grpc.MapServiceStub(client.channel)` and such.
    """

    def __init__(self, channel: grpc.Channel, address: str) -> None:
        #: Sends the token with every call, if there is one.
        self.channel = channel
        self._address = address
        self._maps = map_pb2_grpc.MapServiceStub(channel)
        self._models = model_pb2_grpc.ModelServiceStub(channel)
        self._recognition = recognition_pb2_grpc.RecognitionServiceStub(channel)
        self._sessions = session_pb2_grpc.SessionServiceStub(channel)

    def session(
        self,
        map_id: str,
        session_id: str = "",
        *,
        mode: Mode = Mode.MAP,
        camera: geometry_pb2.Camera | None = None,
        words_hash: str = "",
        window_frames: int = 8,
        patience_s: float = 60.0,
    ) -> Session:
        """Opens a session, or resumes the one of that name.

        Args:
            map_id: `{map}` or `maps/{map}`.
            session_id: Name of the session within the map; the server makes one up if it is empty.
            mode: Whether the map grows.
            camera: How the robot sees; a session that is resumed keeps the one it began with.
            words_hash: `words_hash` of the model that the robot's words are of; needed to send words.
            window_frames: How many frames may have no outcome before no more are taken.
            patience_s: Time without any progress after which the session is given up.

        Raises:
            ServerError: If the server refuses: `NotFound` for a map that is not there.
            SessionLost: If it could not be reached.
        """
        name = _name("maps", map_id)
        options = SessionOptions(name, session_id, mode, camera, words_hash, window_frames, patience_s)
        return Session(self._sessions, options, self._address)

    def query(
        self,
        map_id: str,
        content: Image | WordHistogram | WordList,
        *,
        words_hash: str = "",
        explained_words: int | None = None,
    ) -> QueryAnswer:
        """Where one image, or one bag of words, was taken, without a session: nothing is remembered.

        Args:
            map_id: `{map}` or `maps/{map}`.
            content: As in `Frame.image` and `Frame.words`.
            words_hash: As in `session`.
            explained_words: Explains the most probable place, with this many words for it and as many against
                it, at most 100. No explanation if left out.

        Raises:
            ServerError: If the server refuses.
        """
        request = recognition_pb2.QueryRequest(
            map=_name("maps", map_id), words_hash=words_hash, explained_words=explained_words
        )
        put_content(request, content)
        response: recognition_pb2.QueryResponse = self._call(self._recognition.Query, request)
        return answers.query_answer(response)

    def maps(self) -> list[map_pb2.Map]:
        """All maps, by name."""
        return list(self._pages(self._maps.ListMaps, map_pb2.ListMapsRequest(), lambda page: page.maps))

    def map(self, map_id: str, *, full: bool = False) -> map_pb2.Map:
        """A map; `full` also with its state hash and its weight, which take time.

        Raises:
            NotFound: If there is no such map.
        """
        view = map_pb2.MAP_VIEW_FULL if full else map_pb2.MAP_VIEW_BASIC
        found: map_pb2.Map = self._call(
            self._maps.GetMap, map_pb2.GetMapRequest(name=_name("maps", map_id), view=view)
        )
        return found

    def create_map(self, map_id: str, model: str, settings: map_pb2.MapSettings | None = None) -> map_pb2.Map:
        """Makes an empty map of a model.

        Args:
            map_id: 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit.
            model: The model's hash, an unambiguous beginning of it, or its display name.
            settings: How the map decides; what is left out has its default.

        Raises:
            AlreadyExists: If there is a map of that name.
            NotFound: If there is no such model.
        """
        request = map_pb2.CreateMapRequest(map_id=map_id, model=model, settings=settings)
        made: map_pb2.Map = self._call(self._maps.CreateMap, request)
        return made

    def delete_map(self, map_id: str) -> None:
        """Deletes a map with all its sessions.

        Raises:
            NotFound: If there is no such map.
        """
        self._call(self._maps.DeleteMap, map_pb2.DeleteMapRequest(name=_name("maps", map_id)))

    def loop_closures(self, map_id: str) -> list[LoopClosure]:
        """All loop closures of a map, oldest first.

        Raises:
            NotFound: If there is no such map.
        """
        request = map_pb2.ListLoopClosuresRequest(map=_name("maps", map_id))
        pages = self._pages(self._maps.ListLoopClosures, request, lambda page: page.loop_closures)
        return [answers.loop_closure(closure) for closure in pages]

    def models(self) -> list[model_pb2.Model]:
        """All models, newest first."""
        request = model_pb2.ListModelsRequest()
        return list(self._pages(self._models.ListModels, request, lambda page: page.models))

    def import_model(self, file: str | Path, display_name: str = "") -> model_pb2.Model:
        """Brings a model file to the server. A model that is there already stays as it is.

        Raises:
            InvalidArgument: If it is no model file, or a damaged one.
        """
        content = Path(file).read_bytes()
        requests = [
            model_pb2.ImportModelRequest(display_name=display_name, chunk=content[at : at + _CHUNK_BYTES])
            for at in range(0, max(len(content), 1), _CHUNK_BYTES)
        ]
        model: model_pb2.Model = self._call(self._models.ImportModel, iter(requests))
        return model

    def close(self) -> None:
        """Closes the connection, and ends the sessions that use it."""
        self.channel.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _greet(self) -> None:
        """Any call that reads: it shows whether there is a server, and whether it takes the token."""
        self._call(self._maps.ListMaps, map_pb2.ListMapsRequest(page_size=1), timeout=_CONNECT_TIMEOUT_S)

    def _call(self, method: Callable[..., Any], request: object, **options: float) -> Any:
        try:
            return method(request, **options)
        except grpc.RpcError as error:
            raise errors.from_call(error, self._address) from None

    def _pages(
        self, method: Callable[..., Any], request: Any, items: Callable[[Any], list[T]]
    ) -> Iterator[T]:
        while True:
            page = self._call(method, request)
            yield from items(page)
            if not page.next_page_token:
                return
            request.page_token = page.next_page_token


class _CallDetails(
    namedtuple(
        "_CallDetails", ("method", "timeout", "metadata", "credentials", "wait_for_ready", "compression")
    ),
    grpc.ClientCallDetails,
):
    """What grpcio wants to see changed as a whole."""


class _Bearer(
    grpc.UnaryUnaryClientInterceptor,  # type: ignore[type-arg]
    grpc.UnaryStreamClientInterceptor,  # type: ignore[type-arg]
    grpc.StreamUnaryClientInterceptor,  # type: ignore[type-arg]
    grpc.StreamStreamClientInterceptor,  # type: ignore[type-arg]
):
    """Sends a token with every call; grpcio's own call credentials refuse to without TLS."""

    def __init__(self, token: str) -> None:
        self._header = ("authorization", f"Bearer {token}")

    def _intercept(self, proceed: Callable[..., Any], details: Any, request: object) -> Any:
        metadata = [*(details.metadata or ()), self._header]
        known = {name: getattr(details, name, None) for name in _CallDetails._fields}
        return proceed(_CallDetails(**{**known, "metadata": metadata}), request)

    intercept_unary_unary = _intercept  # type: ignore[assignment]
    intercept_unary_stream = _intercept  # type: ignore[assignment]
    intercept_stream_unary = _intercept  # type: ignore[assignment]
    intercept_stream_stream = _intercept  # type: ignore[assignment]


def _name(collection: str, name: str) -> str:
    return name if name.startswith(f"{collection}/") else f"{collection}/{name}"
