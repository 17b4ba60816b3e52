"""What can go wrong, and what to do about it."""

from __future__ import annotations

import grpc
from google.protobuf.message import DecodeError
from google.rpc import error_details_pb2, status_pb2


class WaypostError(Exception):
    """Anything that this package raises on purpose, but for `ValueError` on values that no server takes."""


class ServerUnreachable(WaypostError):
    """Nobody answered at the address, or the connection broke in the middle of a call."""


class ServerError(WaypostError):
    """The server refused. The message is its own: what is wrong and how to mend it."""

    def __init__(self, code: grpc.StatusCode, message: str, retry_delay_s: float | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        #: Seconds after which the server asks to try again, if it said so.
        self.retry_delay_s = retry_delay_s


class InvalidArgument(ServerError):
    """The request is wrong in itself."""


class NotFound(ServerError):
    """There is no such thing."""


class AlreadyExists(ServerError):
    """There is one of that name already."""


class FailedPrecondition(ServerError):
    """It does not fit with how things stand, as words of another vocabulary do not fit with a map."""


class Aborted(ServerError):
    """Another stream took the session over."""


class ResourceExhausted(ServerError):
    """There is more to do than the server has room for; see `retry_delay_s`."""


class Unavailable(ServerError):
    """Not now, but a little later; see `retry_delay_s`."""


class Unauthenticated(ServerError):
    """The server wants a token, or another one."""


class PermissionDenied(ServerError):
    """The token does not allow it."""


class Cancelled(ServerError):
    """Somebody cancelled it."""


class QueueFull(WaypostError):
    """More frames were sent than the server keeps up with; nothing that was taken is lost."""


class Interrupted(WaypostError):
    """Another thread closed the session while this one streamed into it."""


class SessionLost(WaypostError):
    """The server stayed away, or asked to send a frame again, for too long.

    Open the same session once it is back, and send again what is above its `last_committed_sequence`.
    """


class SessionRewound(WaypostError):
    """The server came back without frames that it had acknowledged as durable."""


class ProtocolError(WaypostError):
    """The server answered with something that the contract does not allow."""


_BY_CODE: dict[grpc.StatusCode, type[ServerError]] = {
    grpc.StatusCode.INVALID_ARGUMENT: InvalidArgument,
    grpc.StatusCode.NOT_FOUND: NotFound,
    grpc.StatusCode.ALREADY_EXISTS: AlreadyExists,
    grpc.StatusCode.FAILED_PRECONDITION: FailedPrecondition,
    grpc.StatusCode.ABORTED: Aborted,
    grpc.StatusCode.RESOURCE_EXHAUSTED: ResourceExhausted,
    grpc.StatusCode.UNAVAILABLE: Unavailable,
    grpc.StatusCode.UNAUTHENTICATED: Unauthenticated,
    grpc.StatusCode.PERMISSION_DENIED: PermissionDenied,
    grpc.StatusCode.CANCELLED: Cancelled,
}
#: What gRPC says of a server that speaks HTTP alone.
_NOT_GRPC = ("Received http2 header with status", "Trying to connect an http1.x server")
#: What it says where TLS and plain meet, or a certificate is missing.
_OTHER_TLS = ("TSI_DATA_CORRUPTED", "Ssl handshake failed", "SSL_ERROR", "WRONG_VERSION_NUMBER")
_CODES: dict[int, grpc.StatusCode] = {code.value[0]: code for code in grpc.StatusCode}


def from_status(status: status_pb2.Status) -> ServerError:
    """The error of a status that came as a message."""
    code = _CODES.get(status.code, grpc.StatusCode.UNKNOWN)
    return _BY_CODE.get(code, ServerError)(code, status.message, _retry_delay_s(status))


def from_call(error: grpc.RpcError, address: str) -> WaypostError:
    """The error of a call: the server's own status, or that there was no server to give one."""
    code, message = error.code(), error.details() or ""
    metadata = {item.key: item.value for item in error.trailing_metadata() or ()}
    if any(said in message for said in _NOT_GRPC):
        return ServerUnreachable(
            f"what answers at {address} does not speak gRPC; it may be the server's HTTP port, 7601 unless "
            "set otherwise: give the one for robots, 7600 unless set otherwise"
        )
    if any(said in message for said in _OTHER_TLS):
        return ServerUnreachable(
            f"no connection to {address} ({message}); that server may speak TLS where this is plain, or none "
            "where this is TLS, or ask for a certificate of yours: write https:// or http://, and give ca= "
            "for an authority of your own, client_cert= and client_key= for a certificate of yours"
        )
    # A status that grpcio made up itself has not come with anything over the wire.
    if code == grpc.StatusCode.UNAVAILABLE and not metadata and not _begun(error):
        return ServerUnreachable(
            f"no connection to {address} ({message}); check that waypost-server runs there and that the "
            "address is right: http:// without TLS, https:// with it, and ca= for an authority of your own"
        )
    status = status_pb2.Status()
    details = metadata.get("grpc-status-details-bin")
    if isinstance(details, bytes):
        try:
            status.ParseFromString(details)
        except DecodeError:
            status.Clear()
    return _BY_CODE.get(code, ServerError)(code, message, _retry_delay_s(status))


def _begun(error: grpc.RpcError) -> bool:
    return isinstance(error, grpc.Call) and bool(error.initial_metadata())


def _retry_delay_s(status: status_pb2.Status) -> float | None:
    hint = error_details_pb2.RetryInfo()
    for detail in status.details:
        if detail.Unpack(hint):
            delay: float = hint.retry_delay.ToNanoseconds() / 1e9
            return delay
    return None
