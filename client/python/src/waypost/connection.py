"""The connection to a server that calls, sessions and navigations share."""

from __future__ import annotations

import os
import ssl
from collections import namedtuple
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Callable, TypeVar, Union
from urllib.parse import urlsplit

import grpc

from waypost import errors
from waypost.v1 import (
    appearance_pb2_grpc,
    cluster_pb2_grpc,
    correction_pb2_grpc,
    event_pb2_grpc,
    job_pb2_grpc,
    label_pb2_grpc,
    map_pb2_grpc,
    merge_pb2_grpc,
    model_pb2_grpc,
    navigation_pb2_grpc,
    recognition_pb2_grpc,
    session_pb2_grpc,
    token_pb2_grpc,
)

CONNECT_TIMEOUT_S = 5.0
DEFAULT_ADDRESS = "http://127.0.0.1:7600"
#: A page of places is the longest answer: 100 places with 100 frames each, about 2 MiB.
_MAX_ANSWER_BYTES = 16 << 20
_CHUNK_BYTES = 1 << 20
_BEGIN_CERTIFICATE = b"-----BEGIN CERTIFICATE-----"
_OPTIONS = [
    ("grpc.max_receive_message_length", _MAX_ANSWER_BYTES),
    # A peer that vanished without a word is noticed after both of these.
    ("grpc.keepalive_time_ms", 10_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    # The channel's own delays, up to two minutes, would outlast the session's patience.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1_000),
    # A new client tries at once, whatever delay another one of this process is waiting for.
    ("grpc.use_local_subchannel_pool", 1),
    # This one is the time a connection may take.
    ("grpc.min_reconnect_backoff_ms", int(CONNECT_TIMEOUT_S * 1_000)),
]

T = TypeVar("T")
#: PEM, or the file that holds it.
Pem = Union[str, Path, bytes]
#: A file by its name, or one that is open for bytes.
File = Union[str, Path, BinaryIO]


@dataclass(frozen=True)
class Options:
    """Where a server is and how to be let in; see `waypost.connect`."""

    address: str
    token: str | None
    ca: Pem | None
    client_cert: Pem | None
    client_key: Pem | None
    tls: bool

    @staticmethod
    def of(
        address: str | None,
        token: str | None,
        ca: Pem | None,
        client_cert: Pem | None,
        client_key: Pem | None,
        tls: bool,
    ) -> Options:
        """What is left out comes from the environment, by the names that the command line has."""
        return Options(
            address=address if address is not None else _variable("SERVER") or DEFAULT_ADDRESS,
            token=token if token is not None else _variable("TOKEN"),
            ca=ca if ca is not None else _variable("CA"),
            client_cert=client_cert if client_cert is not None else _variable("CLIENT_CERT"),
            client_key=client_key if client_key is not None else _variable("CLIENT_KEY"),
            tls=tls,
        )

    def channel(self) -> grpc.Channel:
        """A channel that connects at its first call.

        Raises:
            ValueError: If address, token or certificates cannot be used.
            OSError: If a certificate cannot be read.
        """
        target, scheme = _target(self.address)
        if (self.client_cert is None) != (self.client_key is None):
            raise ValueError("a certificate and its key go together; give both client_cert and client_key")
        certified = self.ca is not None or self.client_cert is not None
        if scheme == "http" and (certified or self.tls):
            what = "certificates are given" if certified else "TLS is asked for"
            raise ValueError(f"{what}, but {self.address} is not encrypted; write https:// or leave them out")
        if scheme == "https" or certified or self.tls:
            channel = grpc.secure_channel(target, self._credentials(), options=_OPTIONS)
        else:
            channel = grpc.insecure_channel(target, options=_OPTIONS)
        return channel if self.token is None else grpc.intercept_channel(channel, _Bearer(self.token))

    def _credentials(self) -> grpc.ChannelCredentials:
        authorities = _system_authorities() if self.ca is None else _read("ca", self.ca)
        if self.ca is not None and _BEGIN_CERTIFICATE not in (authorities or b""):
            raise ValueError(
                "the authority's certificate (ca) is not in PEM; it must have a part that begins with "
                f"{_BEGIN_CERTIFICATE.decode()}"
            )
        key = None if self.client_key is None else _read("client_key", self.client_key)
        chain = None if self.client_cert is None else _read("client_cert", self.client_cert)
        return grpc.ssl_channel_credentials(authorities, key, chain)


class Connection:
    """A channel with the stubs of all services. It mends itself for the next call when it broke."""

    def __init__(self, options: Options) -> None:
        self.channel = options.channel()
        self.address = options.address
        self.appearance = appearance_pb2_grpc.AppearanceServiceStub(self.channel)
        self.cluster = cluster_pb2_grpc.ClusterServiceStub(self.channel)
        self.events = event_pb2_grpc.EventServiceStub(self.channel)
        self.jobs = job_pb2_grpc.JobServiceStub(self.channel)
        self.labels = label_pb2_grpc.LabelServiceStub(self.channel)
        self.maps = map_pb2_grpc.MapServiceStub(self.channel)
        self.corrections = correction_pb2_grpc.CorrectionServiceStub(self.channel)
        self.merges = merge_pb2_grpc.MergeServiceStub(self.channel)
        self.models = model_pb2_grpc.ModelServiceStub(self.channel)
        self.navigations = navigation_pb2_grpc.NavigationServiceStub(self.channel)
        self.recognition = recognition_pb2_grpc.RecognitionServiceStub(self.channel)
        self.sessions = session_pb2_grpc.SessionServiceStub(self.channel)
        self.tokens = token_pb2_grpc.TokenServiceStub(self.channel)

    def call(self, method: Callable[..., Any], request: object, **options: float) -> Any:
        """One request, one answer."""
        try:
            return method(request, **options)
        except grpc.RpcError as error:
            raise errors.from_call(error, self.address) from None

    def pages(
        self, method: Callable[..., Any], request: Any, items: Callable[[Any], Iterable[T]]
    ) -> Iterator[T]:
        """The items of all pages."""
        while True:
            page = self.call(method, request)
            yield from items(page)
            if not page.next_page_token:
                return
            request.page_token = page.next_page_token

    def upload(self, method: Callable[..., Any], requests: Iterable[Any]) -> Any:
        """Many requests, one answer.

        What `requests` raises is raised here; the server then sees a broken stream, not a shorter one.
        """
        failures: list[BaseException] = []

        def noted() -> Iterator[Any]:
            try:
                yield from requests
            except BaseException as error:
                failures.append(error)
                raise

        try:
            return method(noted())
        except grpc.RpcError as error:
            if failures:
                raise failures[0] from None
            raise errors.from_call(error, self.address) from None

    def download(self, method: Callable[..., Any], request: object, file: File) -> int:
        """Writes the chunks of the answer; gives their length in bytes.

        A file given by name must not exist yet, and is removed again if the download fails.
        """
        if not isinstance(file, (str, Path)):
            return self._write(method(request), file)
        path = Path(file)
        with path.open("xb") as opened:
            try:
                return self._write(method(request), opened)
            except BaseException:
                path.unlink()
                raise

    def _write(self, answers: Any, file: BinaryIO) -> int:
        length_bytes = 0
        try:
            for answer in answers:
                file.write(answer.chunk)
                length_bytes += len(answer.chunk)
        except grpc.RpcError as error:
            raise errors.from_call(error, self.address) from None
        finally:
            answers.cancel()
        return length_bytes


def chunks(file: File) -> Iterator[bytes]:
    """A file in pieces of 1 MiB; at least one, which is empty for an empty file."""
    if isinstance(file, (str, Path)):
        with Path(file).open("rb") as opened:
            yield from chunks(opened)
        return
    chunk = file.read(_CHUNK_BYTES)
    yield chunk
    while chunk:
        chunk = file.read(_CHUNK_BYTES)
        if chunk:
            yield chunk


def resource(collection: str, name: str) -> str:
    """`maps/hall` of `hall` or of itself."""
    return name if name.startswith(f"{collection}/") else f"{collection}/{name}"


def _variable(name: str) -> str | None:
    """An empty variable counts as unset."""
    return os.environ.get(f"WAYPOST_{name}") or None


def _target(address: str) -> tuple[str, str]:
    """Host and port as gRPC wants them, and the scheme if there is one."""
    scheme, separator, _ = address.partition("://")
    try:
        parts = urlsplit(address if separator else f"//{address}")
        port = parts.port or {"http": 80, "https": 443}.get(parts.scheme)
    except ValueError:
        raise _not_an_address(address, "its port is no number from 0 to 65535") from None
    if separator and scheme not in ("http", "https"):
        raise _not_an_address(address, f"the scheme `{scheme}` is not served")
    if not parts.hostname or any(character.isspace() for character in address):
        raise _not_an_address(address, "it names no host")
    if parts.path not in ("", "/") or parts.query or parts.fragment or "@" in parts.netloc:
        raise _not_an_address(address, "it has more than a host and a port")
    if port is None:
        raise _not_an_address(address, "it lacks a port")
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    return f"{host}:{port}", parts.scheme


def _not_an_address(address: str, reason: str) -> ValueError:
    return ValueError(
        f"`{address}` is not the address of a server ({reason}); write it as HOST:PORT, http://HOST:PORT or "
        "https://HOST:PORT"
    )


def _read(option: str, pem: Pem) -> bytes:
    """The PEM that an option names, or is."""
    if isinstance(pem, bytes):
        return pem
    try:
        return Path(pem).read_bytes()
    except OSError as error:
        reason = f"{option} cannot be read ({error.strerror}); name a file in PEM"
        raise OSError(error.errno, reason, str(pem)) from error


def _system_authorities() -> bytes | None:
    """Those that OpenSSL is set up to trust; None for those that gRPC brings along."""
    file = ssl.get_default_verify_paths().cafile
    return None if file is None else Path(file).read_bytes()


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
        secret = token.strip()
        if not secret.isascii() or not secret.isprintable():
            raise ValueError("the token has characters that no token has; copy it again")
        self._header = ("authorization", f"Bearer {secret}")

    def _intercept(self, proceed: Callable[..., Any], details: Any, request: object) -> Any:
        metadata = [*(details.metadata or ()), self._header]
        known = {name: getattr(details, name, None) for name in _CallDetails._fields}
        return proceed(_CallDetails(**{**known, "metadata": metadata}), request)

    intercept_unary_unary = _intercept  # type: ignore[assignment]
    intercept_unary_stream = _intercept  # type: ignore[assignment]
    intercept_stream_unary = _intercept  # type: ignore[assignment]
    intercept_stream_stream = _intercept  # type: ignore[assignment]
