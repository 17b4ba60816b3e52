"""What the server says. Every field of the contract has its place here."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Union

import numpy as np
import numpy.typing as npt

from waypost import errors
from waypost.poses import Pose2, planar
from waypost.v1 import map_pb2, recognition_pb2, session_pb2


class Reason(enum.IntEnum):
    """Why a frame was decided as it was.

    While localizing nothing is created: then NEW_PLACE, BELOW_THRESHOLD and GEOMETRY_REFUSED come without a
    place.
    """

    #: Somewhere new was the most probable: a place was created.
    NEW_PLACE = session_pb2.REASON_NEW_PLACE
    #: The place the session is at, or has just left.
    SAME_PLACE = session_pb2.REASON_SAME_PLACE
    #: Another place, at or above the map's threshold.
    LOOP_CLOSURE = session_pb2.REASON_LOOP_CLOSURE
    #: Another place was the most probable, but below the threshold: a place was created.
    BELOW_THRESHOLD = session_pb2.REASON_BELOW_THRESHOLD
    #: Too few different words to say anything: nothing was created or learnt.
    TOO_FEW_WORDS = session_pb2.REASON_TOO_FEW_WORDS
    #: A known place was above the threshold, but geometry refused it: a place was created.
    GEOMETRY_REFUSED = session_pb2.REASON_GEOMETRY_REFUSED


@dataclass(frozen=True)
class FrameReference:
    """A frame by its session and sequence number."""

    #: maps/{map}/sessions/{session}
    session: str
    sequence: int
    stamp_ns: int
    #: What its robot calls it; empty if nothing.
    note: str = ""


@dataclass(frozen=True)
class Similarity:
    """x_current = s R x_earlier + t about the centres of the images."""

    #: Angle of R, from x to the right towards y down.
    rotation_rad: float
    #: ln s: above 0 if the current view is nearer.
    ln_scale: float
    #: t to the right, in widths of the image.
    x_widths: float
    #: t down, in widths of the image.
    y_widths: float


@dataclass(frozen=True)
class Placement:
    """Where a robot was, seen from where a robot was at an earlier frame, by features of known depth."""

    #: base_link at the frame in base_link at the earlier one; None if the features contradict each other:
    #: then the robot is not there.
    pose: Pose2 | None
    #: 3 x 3, row by row, of what may be wrong along the pose's own x and y and about its heading, in m^2 and
    #: rad^2. Empty without a pose.
    covariance: tuple[float, ...]
    #: Features of known depth that agree with the pose.
    inliers: int


@dataclass(frozen=True)
class Geometry:
    """Two views compared by where their features are."""

    #: Features that look alike.
    matches: int
    #: Those that one motion explains.
    inliers: int
    #: Evidence of this and the session's last frames for the place.
    evidence_inliers: float
    #: The motion, if it was looked for in the image plane and one was found.
    similarity: Similarity | None
    #: That both frames show the same place, by words and geometry together.
    probability: float = 0.0
    #: Where features of known depth put the robot; None if they say nothing: camera or odometry are not
    #: known, or the robot had not moved far enough to see depths.
    placement: Placement | None = None
    #: What the best look-alike is expected to show over the same frames, in inliers.
    look_alike_inliers: float = 0.0


@dataclass(frozen=True)
class Match:
    """An earlier frame of a place."""

    place_number: int
    posterior: float
    frame: FrameReference
    #: ln [posterior / (1 - posterior)], nats: tells apart what rounds to 1.
    log_odds: float
    #: What geometry found between the two frames; None where it was not asked.
    geometry: Geometry | None = None


@dataclass(frozen=True)
class Timings:
    """Where a frame's time went at the server."""

    extract_ms: float
    quantize_ms: float
    likelihood_ms: float
    new_place_ms: float
    filter_ms: float
    #: How far features are, by the robot's way, and comparing the frame with earlier ones.
    verification_ms: float
    #: Waiting for other frames of the map, and for the commit.
    commit_ms: float
    total_ms: float


@dataclass(frozen=True)
class MapPose:
    """Where a robot is, by its wheels and the places that it recognised (REP-105)."""

    #: The lowest place of the part of the map whose frame this is in.
    part: int
    #: base_link in it.
    robot: Pose2
    #: The session's odom frame in it: a pose by odometry, composed onto this, is one on the map.
    map_to_odom: Pose2


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to a frame. While the map grows, the frame is durable by then."""

    sequence: int
    #: Last frame of the session that is durable; 0 as well while there is none.
    last_committed_sequence: int
    reason: Reason
    #: The place that the frame belongs to; None if too little was seen to decide.
    place_number: int | None
    #: Posterior probability of what was decided: of the place, or of a new one.
    posterior: float
    #: Probability of being somewhere new.
    new_place_posterior: float
    #: The most probable places, most probable first; at most 10.
    places: npt.NDArray[np.uint32]
    #: Their posteriors.
    posteriors: npt.NDArray[np.float64]
    #: For LOOP_CLOSURE, BELOW_THRESHOLD and GEOMETRY_REFUSED: the place and frame that matched.
    match: Match | None
    #: The best candidate for a loop closure, whatever was decided: among the places known from before the
    #: guard, the frame of the most probable one that matches best; with geometry, of the one with the most
    #: evidence.
    best_candidate: Match | None
    #: Different words seen.
    words: int
    #: None in an answer from the store.
    timings: Timings | None
    #: The frame had been committed before; this is the stored answer.
    resent: bool
    #: Where the robot is on the map; None without odometry, and in an answer from the store.
    map_pose: MapPose | None = None

    @property
    def loop_closure(self) -> Match | None:
        """The place and frame that matched, if the frame closes a loop."""
        return self.match if self.reason is Reason.LOOP_CLOSURE else None


@dataclass(frozen=True)
class Refusal:
    """A frame that was not taken: nothing has changed, and the stream goes on."""

    sequence: int
    #: None before the first frame is durable.
    last_committed_sequence: int | None
    #: What is wrong and how to mend it; for those who would rather `raise` it.
    error: errors.ServerError
    #: So that every outcome can be asked for its loop closure.
    loop_closure: None = None


#: What became of a frame.
Outcome = Union[Answer, Refusal]


@dataclass(frozen=True, eq=False)
class QueryAnswer:
    """Where an image or a bag of words was taken, every place being as likely beforehand."""

    #: The most probable places, most probable first; at most 10.
    places: npt.NDArray[np.uint32]
    #: Their posteriors.
    posteriors: npt.NDArray[np.float64]
    new_place_posterior: float
    #: Of the most probable place, the frame that matches best; None if the map is empty or too few words were
    #: seen.
    match: Match | None
    #: Whether the match reaches the map's threshold, and is more probable than a new place.
    accepted: bool
    #: Different words seen.
    words: int
    #: As the contract has it, if asked for and there is a place.
    place_explanation: recognition_pb2.PlaceExplanation | None


@dataclass(frozen=True)
class LoopClosure:
    """A frame that was found to be at a place seen before."""

    frame: FrameReference
    matched_frame: FrameReference
    place_number: int
    posterior: float
    #: That both frames show the same place, by words and geometry together; None where nothing was verified.
    probability: float | None = None
    #: Who withdrew it, and when; None while it stands.
    correction: map_pb2.Correction | None = None


def answer(message: session_pb2.FrameAnswer) -> Answer:
    """An answer from the wire."""
    return Answer(
        sequence=message.sequence,
        last_committed_sequence=message.last_committed_sequence,
        reason=_reason(message.reason),
        place_number=message.place_number if message.HasField("place_number") else None,
        posterior=message.posterior,
        new_place_posterior=message.new_place_posterior,
        places=np.array([place.place_number for place in message.places], dtype=np.uint32),
        posteriors=np.array([place.posterior for place in message.places], dtype=np.float64),
        match=_match(message.match) if message.HasField("match") else None,
        best_candidate=_match(message.best_candidate) if message.HasField("best_candidate") else None,
        words=message.words,
        timings=_timings(message.timings) if message.HasField("timings") else None,
        resent=message.resent,
        map_pose=map_pose(message.map_pose) if message.HasField("map_pose") else None,
    )


def map_pose(message: session_pb2.MapPose) -> MapPose:
    """A pose on the map from the wire."""
    return MapPose(
        part=message.part,
        robot=planar(message.robot),
        map_to_odom=planar(message.map_to_odom),
    )


def refusal(message: session_pb2.FrameRefusal) -> Refusal:
    """A refusal from the wire."""
    committed = message.HasField("last_committed_sequence")
    return Refusal(
        sequence=message.sequence,
        last_committed_sequence=message.last_committed_sequence if committed else None,
        error=errors.from_status(message.status),
    )


def query_answer(message: recognition_pb2.QueryResponse) -> QueryAnswer:
    """The answer to a query from the wire."""
    return QueryAnswer(
        places=np.array([place.place_number for place in message.places], dtype=np.uint32),
        posteriors=np.array([place.posterior for place in message.places], dtype=np.float64),
        new_place_posterior=message.new_place_posterior,
        match=_match(message.match) if message.HasField("match") else None,
        accepted=message.accepted,
        words=message.words,
        place_explanation=message.place_explanation if message.HasField("place_explanation") else None,
    )


def loop_closure(message: map_pb2.LoopClosure) -> LoopClosure:
    """A loop closure from the wire."""
    return LoopClosure(
        frame=_frame_reference(message.frame),
        matched_frame=_frame_reference(message.matched_frame),
        place_number=message.place_number,
        posterior=message.posterior,
        probability=message.probability if message.HasField("probability") else None,
        correction=message.correction if message.HasField("correction") else None,
    )


def _reason(reason: int) -> Reason:
    try:
        return Reason(reason)
    except ValueError:
        raise errors.ProtocolError(
            f"the server gave the reason {reason}, which this client does not know; "
            "use a client of the server's version"
        ) from None


def _match(message: recognition_pb2.Match) -> Match:
    return Match(
        place_number=message.place_number,
        posterior=message.posterior,
        frame=_frame_reference(message.frame),
        log_odds=message.log_odds,
        geometry=_geometry(message.geometry) if message.HasField("geometry") else None,
    )


def _geometry(message: recognition_pb2.Geometry) -> Geometry:
    similarity = message.similarity if message.HasField("similarity") else None
    return Geometry(
        matches=message.matches,
        inliers=message.inliers,
        evidence_inliers=message.evidence_inliers,
        similarity=_similarity(similarity) if similarity is not None else None,
        probability=message.probability,
        placement=_placement(message.placement) if message.HasField("placement") else None,
        look_alike_inliers=message.look_alike_inliers,
    )


def _placement(message: recognition_pb2.Placement) -> Placement:
    return Placement(
        pose=planar(message.pose) if message.HasField("pose") else None,
        covariance=tuple(message.covariance),
        inliers=message.inliers,
    )


def _similarity(message: recognition_pb2.Similarity) -> Similarity:
    return Similarity(message.rotation_rad, message.ln_scale, message.x_widths, message.y_widths)


def _frame_reference(message: map_pb2.FrameReference) -> FrameReference:
    return FrameReference(message.session, message.sequence, message.stamp_ns, message.note)


def _timings(message: session_pb2.Timings) -> Timings:
    return Timings(
        extract_ms=message.extract_ms,
        quantize_ms=message.quantize_ms,
        likelihood_ms=message.likelihood_ms,
        new_place_ms=message.new_place_ms,
        filter_ms=message.filter_ms,
        verification_ms=message.verification_ms,
        commit_ms=message.commit_ms,
        total_ms=message.total_ms,
    )
