"""Client of Waypost, the server that tells robots where they have been before."""

from waypost.answers import (
    Answer,
    FrameReference,
    LoopClosure,
    Match,
    Outcome,
    QueryAnswer,
    Reason,
    Refusal,
    Timings,
)
from waypost.client import Client, connect
from waypost.errors import (
    Aborted,
    AlreadyExists,
    FailedPrecondition,
    InvalidArgument,
    NotFound,
    PermissionDenied,
    ProtocolError,
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
from waypost.png import png
from waypost.poses import Pose2, Pose3
from waypost.session import Mode, Session

__all__ = [
    "MAX_IMAGE_BYTES",
    "Aborted",
    "AlreadyExists",
    "Answer",
    "Client",
    "FailedPrecondition",
    "Frame",
    "FrameReference",
    "InvalidArgument",
    "LoopClosure",
    "Match",
    "Mode",
    "NotFound",
    "Outcome",
    "PermissionDenied",
    "Pose2",
    "Pose3",
    "ProtocolError",
    "QueryAnswer",
    "Reason",
    "Refusal",
    "ResourceExhausted",
    "ServerError",
    "ServerUnreachable",
    "Session",
    "SessionLost",
    "SessionRewound",
    "Timings",
    "Unauthenticated",
    "Unavailable",
    "WaypostError",
    "WordHistogram",
    "WordList",
    "connect",
    "png",
]
