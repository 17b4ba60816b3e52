"""Client of Waypost, the server that tells robots where they have been before.

>>> import waypost
>>> with waypost.connect() as client:  # at WAYPOST_SERVER
...     made = client.create_map("docs", "shipped")
...     with client.session("docs", "robot") as session:
...         frame = waypost.Frame(1, 1, image, odometry=(0, 0, 0))
...         [(outcome.sequence, outcome.reason.name) for outcome in session.stream([frame])]
[(1, 'NEW_PLACE')]
"""

from waypost.answers import (
    Answer,
    FrameReference,
    Geometry,
    LoopClosure,
    MapPose,
    Match,
    Outcome,
    Placement,
    QueryAnswer,
    Reason,
    Refusal,
    Similarity,
    Timings,
)
from waypost.calls import JobProgress, MapEvents
from waypost.cameras import read_camera
from waypost.client import Client, connect, lazy
from waypost.doubts import OdometryWarning
from waypost.errors import (
    Aborted,
    AlreadyExists,
    Cancelled,
    FailedPrecondition,
    InvalidArgument,
    NotFound,
    PermissionDenied,
    ProtocolError,
    QueueFull,
    ResourceExhausted,
    ServerError,
    ServerUnreachable,
    SessionLost,
    SessionRewound,
    Unauthenticated,
    Unavailable,
    WaypostError,
)
from waypost.frames import MAX_IMAGE_BYTES, Frame, WordHistogram, WordList
from waypost.goals import GoalLike
from waypost.guidance import (
    Command,
    Disconnected,
    FrameSeen,
    GoalRefused,
    Guidance,
    Localization,
    NavigationEvent,
    NavigationStatus,
    Reconnected,
    WheelsRefused,
)
from waypost.navigation import Navigation
from waypost.photos import image_files
from waypost.png import png
from waypost.poses import Pose2, Pose3
from waypost.sender import Sender
from waypost.session import Mode, Session

__all__ = [
    "MAX_IMAGE_BYTES",
    "Aborted",
    "AlreadyExists",
    "Answer",
    "Cancelled",
    "Client",
    "Command",
    "Disconnected",
    "FailedPrecondition",
    "Frame",
    "FrameReference",
    "FrameSeen",
    "Geometry",
    "GoalLike",
    "GoalRefused",
    "Guidance",
    "InvalidArgument",
    "JobProgress",
    "Localization",
    "LoopClosure",
    "MapEvents",
    "MapPose",
    "Match",
    "Mode",
    "Navigation",
    "NavigationEvent",
    "NavigationStatus",
    "NotFound",
    "OdometryWarning",
    "Outcome",
    "PermissionDenied",
    "Placement",
    "Pose2",
    "Pose3",
    "ProtocolError",
    "QueryAnswer",
    "QueueFull",
    "Reason",
    "Reconnected",
    "Refusal",
    "ResourceExhausted",
    "Sender",
    "ServerError",
    "ServerUnreachable",
    "Session",
    "SessionLost",
    "SessionRewound",
    "Similarity",
    "Timings",
    "Unauthenticated",
    "Unavailable",
    "WaypostError",
    "WheelsRefused",
    "WordHistogram",
    "WordList",
    "connect",
    "image_files",
    "lazy",
    "png",
    "read_camera",
]
