"""The client: all calls, sessions and navigations over one connection."""

from __future__ import annotations

from types import TracebackType
from typing import Callable

import grpc

from waypost.calls import (
    ClusterCalls,
    CorrectionCalls,
    EventCalls,
    JobCalls,
    MapCalls,
    MergeCalls,
    ModelCalls,
    NavigationCalls,
    PlaceCalls,
    SessionCalls,
    TokenCalls,
)
from waypost.connection import CONNECT_TIMEOUT_S, Connection, Options, Pem, resource
from waypost.goals import GoalLike, goal_message
from waypost.guidance import Guidance, NavigationEvent
from waypost.navigation import Navigation, NavigationOptions
from waypost.session import Mode, Session, SessionOptions
from waypost.v1 import geometry_pb2, map_pb2, navigation_pb2


def connect(
    address: str | None = None,
    *,
    token: str | None = None,
    ca: Pem | None = None,
    client_cert: Pem | None = None,
    client_key: Pem | None = None,
    tls: bool = False,
) -> Client:
    """Connects to a server. What is left out comes from the environment, as for the command line.

    >>> with connect() as client:
    ...     client.map("docs").name
    'maps/docs'

    Args:
        address: Where the server listens for robots: `http://HOST:PORT`, `https://HOST:PORT`, or `HOST:PORT`,
            which is encrypted if `tls` or any certificate is given. Otherwise WAYPOST_SERVER, or else
            127.0.0.1:7600.
        token: Secret of a token, for a server that wants one. Without TLS it is sent in the clear. Otherwise
            WAYPOST_TOKEN.
        ca: Certificate of the authority that signed the server's, as PEM or as the file that holds it.
            Otherwise WAYPOST_CA, or else the authorities that OpenSSL, or gRPC, trusts on this machine.
        client_cert: This client's certificate, for a server that requires one; PEM or file. Otherwise
            WAYPOST_CLIENT_CERT.
        client_key: The private key of that certificate. Otherwise WAYPOST_CLIENT_KEY.
        tls: TLS also for an address without https://.

    Raises:
        ServerUnreachable: If nobody answers there.
        Unauthenticated: If the server wants a token, or another one.
        ValueError: If address, token or certificates cannot be used.
    """
    client = Client(Options.of(address, token, ca, client_cert, client_key, tls))
    try:
        client.greet()
    except BaseException:
        client.close()
        raise
    return client


def lazy(
    address: str | None = None,
    *,
    token: str | None = None,
    ca: Pem | None = None,
    client_cert: Pem | None = None,
    client_key: Pem | None = None,
    tls: bool = False,
) -> Client:
    """As `connect`, but connects at the first call: for robots that may start before their server.

    Raises:
        ValueError: If address, token or certificates cannot be used.
    """
    return Client(Options.of(address, token, ca, client_cert, client_key, tls))


class Client(
    ClusterCalls,
    CorrectionCalls,
    EventCalls,
    JobCalls,
    MapCalls,
    MergeCalls,
    ModelCalls,
    NavigationCalls,
    PlaceCalls,
    SessionCalls,
    TokenCalls,
):
    """A connection to a server, made by `connect`. It mends itself for the next call when it broke.

    It may be used by several threads. Every method of the contract is here. Answers are messages
    of the contract (`waypost.v1.map_pb2.Map` and such), except for what robots ask often.
    """

    def __init__(self, options: Options) -> None:
        self._connection = Connection(options)

    @property
    def channel(self) -> grpc.Channel:
        """For stubs of one's own, `waypost.v1.map_pb2_grpc.MapServiceStub(client.channel)`.

        It sends the token with every call, if there is one.
        """
        return self._connection.channel

    @property
    def address(self) -> str:
        """The server's address, as it was given."""
        return self._connection.address

    def greet(self) -> None:
        """Any call that reads: it shows whether there is a server, and whether it takes the token.

        Raises:
            ServerUnreachable: If nobody answers within 5 s.
            Unauthenticated: If the server wants a token, or another one.
        """
        request = map_pb2.ListMapsRequest(page_size=1)
        self._connection.call(self._connection.maps.ListMaps, request, timeout=CONNECT_TIMEOUT_S)

    def session(
        self,
        map_id: str,
        session_id: str = "",
        *,
        mode: Mode = Mode.MAP,
        camera: geometry_pb2.Camera | None = None,
        words_hash: str = "",
        run_id: str = "",
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
            run_id: With `Mode.LOCALIZE`: a run of the robot. A session that another run left starts again.
            window_frames: How many frames may have no outcome before no more are taken.
            patience_s: Time without any progress after which the session is given up.

        Raises:
            ServerError: If the server refuses: `NotFound` for a map that is not there.
            SessionLost: If it could not be reached.
        """
        options = SessionOptions(
            resource("maps", map_id), session_id, mode, camera, words_hash, run_id, window_frames, patience_s
        )
        return Session(self._connection.sessions, options, self.address)

    def navigate(
        self,
        map_id: str,
        camera: geometry_pb2.Camera,
        *,
        goal: GoalLike | None = None,
        navigation_id: str = "",
        words_hash: str = "",
        driving: navigation_pb2.DrivingSettings | None = None,
        patience_s: float = 60.0,
        on_event: Callable[[NavigationEvent], None] | None = None,
        on_guidance: Callable[[Guidance], None] | None = None,
    ) -> Navigation:
        """Starts to lead a robot, and waits until the server has opened the navigation.

        Args:
            map_id: `{map}` or `maps/{map}`.
            camera: How the robot sees; its field of view, or a calibration, is needed. On a map that is
                navigated by appearance, a panorama or a hyperbolic mirror.
            goal: A place by its number, a label, a position (x, y) or pose (x, y, heading), a panorama as
                JPEG or PNG, or a `navigation_pb2.Goal`. Without one the robot stands.
            navigation_id: Name of the robot within the map; the server makes one up if it is empty.
            words_hash: As in `session`.
            driving: Speeds and distances to drive by.
            patience_s: Time without a connection after which the navigation is over.
            on_event: Called with each event, by a thread of the navigation's own, in place of `next_event`.
            on_guidance: Called likewise with each guidance. What either raises ends the navigation.

        Raises:
            NotFound: If there is no such map or goal.
            InvalidArgument: If the camera does not say enough.
            FailedPrecondition: If another stream steers this robot, or robots cannot navigate in this map.
            SessionLost: If the server could not be reached.
        """
        options = NavigationOptions(
            map_name=resource("maps", map_id),
            navigation_id=navigation_id,
            camera=camera,
            words_hash=words_hash,
            goal=None if goal is None else goal_message(goal),
            driving=driving,
            patience_s=patience_s,
        )
        return Navigation(self._connection.navigations, options, self.address, on_event, on_guidance)

    def close(self) -> None:
        """Closes the connection, and ends the sessions and navigations that use it."""
        self._connection.channel.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
