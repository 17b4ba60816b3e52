"""From numpy to the contract and back."""

from __future__ import annotations

import dataclasses
import io
import math

import numpy as np
import numpy.typing as npt
import pytest
from conftest import frame
from google.protobuf.message import Message
from PIL import Image

import waypost
from waypost import answers, frames
from waypost.v1 import geometry_pb2, map_pb2, recognition_pb2, session_pb2


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (48, 64), (1, 1, 3), (48, 64, 3)])
def test_pixels_come_out_of_the_png_as_they_went_in(shape: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(7).integers(0, 256, shape, dtype=np.uint8)
    decoded = Image.open(io.BytesIO(waypost.png(pixels)))
    assert decoded.mode == ("L" if len(shape) == 2 else "RGB")
    np.testing.assert_array_equal(np.asarray(decoded), pixels)
    # Also a view that is not contiguous.
    decoded = Image.open(io.BytesIO(waypost.png(pixels[::-1, ::-1])))
    np.testing.assert_array_equal(np.asarray(decoded), pixels[::-1, ::-1])


@pytest.mark.parametrize(
    "pixels",
    [
        np.zeros((4, 4), np.uint16),
        np.zeros((4, 4), np.float32),
        np.zeros((4, 4, 4), np.uint8),
        np.zeros((4, 4, 3, 1), np.uint8),
        np.zeros((4, 4, 3, 3), np.uint8),
        np.zeros(4, np.uint8),
        np.zeros((0, 4), np.uint8),
    ],
)
def test_other_arrays_are_no_image(pixels: npt.NDArray[np.generic]) -> None:
    with pytest.raises(ValueError, match="must be uint8"):
        waypost.png(pixels)


def test_the_server_sees_pixels_as_it_sees_a_png(client: waypost.Client, hall: str) -> None:
    """The server decodes an image and the array of its pixels to the same words."""
    encoded = io.BytesIO()
    photo = Image.open(io.BytesIO(image_of(frame(1))))
    photo.save(encoded, "PNG")
    with client.session(hall, "file") as session:
        [file] = session.stream([frame(1, image=encoded.getvalue())])
    with client.session(hall, "array") as session:
        [array] = session.stream([frame(1, image=np.asarray(photo))])
    assert isinstance(file, waypost.Answer)
    assert isinstance(array, waypost.Answer)
    assert array.words == file.words > 50


def image_of(frame: waypost.Frame) -> bytes:
    assert isinstance(frame.image, bytes)
    return frame.image


def sent_odometry(odometry: object) -> geometry_pb2.Odometry:
    return waypost.Frame(1, 1, b"x", odometry=odometry).to_proto().odometry  # type: ignore[arg-type]


def matrix(pose: geometry_pb2.Pose) -> npt.NDArray[np.float64]:
    """The 4 x 4 matrix of a message, by the textbook's formula."""
    q, p = pose.orientation, pose.position_m
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), p.x],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), p.y],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), p.z],
            [0, 0, 0, 1],
        ]
    )


def test_odometry_in_the_plane() -> None:
    expected = np.array([[0, -1, 0, 1.5], [1, 0, 0, -2], [0, 0, 1, 0], [0, 0, 0, 1]])
    for odometry in [
        (1.5, -2, math.pi / 2),
        np.array([1.5, -2, math.pi / 2]),
        waypost.Pose2(1.5, -2, math.pi / 2),
        expected,
        waypost.Pose3.from_matrix(expected),
    ]:
        np.testing.assert_allclose(matrix(sent_odometry(odometry).pose), expected, atol=1e-12)


def test_any_rotation_survives_as_a_quaternion() -> None:
    random = np.random.default_rng(3)
    half_turns = [np.diag(signs).astype(float) for signs in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
    rotations = [np.eye(3), *half_turns]
    while len(rotations) < 200:
        orthogonal, _ = np.linalg.qr(random.normal(size=(3, 3)))
        rotations.append(orthogonal * np.linalg.det(orthogonal))
    for rotation in rotations:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, random.normal(size=3)
        sent = sent_odometry(pose).pose
        np.testing.assert_allclose(matrix(sent), pose, atol=1e-12)
        q = sent.orientation
        assert q.w >= 0
        assert q.x**2 + q.y**2 + q.z**2 + q.w**2 == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(
    "odometry",
    [(1, 2), np.eye(3), np.diag([1, 1, -1, 1]), 2 * np.eye(4), np.full((4, 4), np.nan), np.ones((4, 4))],
)
def test_what_is_no_pose_is_refused(odometry: npt.ArrayLike) -> None:
    with pytest.raises(ValueError, match="matrix"):
        sent_odometry(odometry)


def test_a_covariance_goes_row_by_row() -> None:
    covariance = np.arange(36.0).reshape(6, 6)
    sent = waypost.Frame(1, 1, b"x", odometry=(0, 0, 0), odometry_covariance=covariance).to_proto()
    assert list(sent.odometry.covariance) == list(range(36))
    with pytest.raises(ValueError, match="6 x 6"):
        waypost.Frame(1, 1, b"x", odometry=(0, 0, 0), odometry_covariance=np.eye(3)).to_proto()


def test_words_become_messages() -> None:
    histogram = waypost.WordHistogram([7, 3], [1, 65535])  # type: ignore[arg-type]
    assert histogram.words.dtype == np.uint32
    sent = waypost.Frame(1, 1, words=histogram).to_proto()
    assert sent.WhichOneof("content") == "histogram"
    assert (list(sent.histogram.words), list(sent.histogram.counts)) == ([7, 3], [1, 65535])
    # Nothing seen is something else than nothing sent.
    nothing = waypost.WordHistogram(np.array([], dtype=np.uint32))
    assert waypost.Frame(1, 1, words=nothing).to_proto().WhichOneof("content") == "histogram"

    x, y = np.array([1.5, 2.0]), np.array([0.0, 4.0])
    words = waypost.WordList(np.array([9, 9]), x, y, (640, 360), angle_rad=x)
    sent = waypost.Frame(1, 1, words=words).to_proto()
    expected = recognition_pb2.WordList(
        words=[9, 9], x_px=[1.5, 2], y_px=[0, 4], angle_rad=[1.5, 2], image_width_px=640, image_height_px=360
    )
    assert sent.words == expected


@pytest.mark.parametrize(
    ("words", "counts"),
    [
        ([-1], None),
        ([1 << 32], None),
        ([0.5], None),
        ([[1]], None),
        ([1, 2], [1]),
        ([True], None),
        (["a"], None),
    ],
)
def test_what_are_no_words_is_refused(words: list[object], counts: list[int] | None) -> None:
    with pytest.raises(ValueError, match=r"words|counts"):
        waypost.WordHistogram(words, counts)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"words|x_px"):
        waypost.WordList(words, [0.0] * 3, [0.0] * 3, (1, 1))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("ours", "contract", "ours_alone"),
    [
        (answers.Answer, session_pb2.FrameAnswer, {"posteriors"}),
        (answers.QueryAnswer, recognition_pb2.QueryResponse, {"posteriors"}),
        (answers.Match, recognition_pb2.Match, set()),
        (answers.Geometry, recognition_pb2.Geometry, set()),
        (answers.Placement, recognition_pb2.Placement, set()),
        (answers.Similarity, recognition_pb2.Similarity, set()),
        (answers.Timings, session_pb2.Timings, set()),
        (answers.FrameReference, map_pb2.FrameReference, set()),
        (answers.LoopClosure, map_pb2.LoopClosure, set()),
        (frames.WordHistogram, recognition_pb2.WordHistogram, set()),
    ],
)
def test_every_field_of_the_contract_has_its_place(
    ours: type[object], contract: type[Message], ours_alone: set[str]
) -> None:
    fields = {field.name for field in dataclasses.fields(ours)}  # type: ignore[arg-type]
    assert fields - ours_alone == set(contract.DESCRIPTOR.fields_by_name)
    assert ours_alone <= fields


def test_a_match_below_the_threshold_is_not_a_closure() -> None:
    match = recognition_pb2.Match(
        place_number=4, posterior=0.6, frame=map_pb2.FrameReference(session="s", sequence=9)
    )
    below = answers.answer(
        session_pb2.FrameAnswer(reason=session_pb2.REASON_BELOW_THRESHOLD, match=match, place_number=5)
    )
    assert below.loop_closure is None
    assert below.match == waypost.Match(4, 0.6, waypost.FrameReference("s", 9, 0), 0.0)
    closing = answers.answer(
        session_pb2.FrameAnswer(reason=session_pb2.REASON_LOOP_CLOSURE, match=match, place_number=4)
    )
    assert closing.loop_closure == closing.match == below.match


def test_an_unknown_reason_is_not_taken_for_another() -> None:
    with pytest.raises(waypost.ProtocolError, match="reason 99"):
        answers.answer(session_pb2.FrameAnswer(reason=99))  # type: ignore[arg-type]


def test_where_features_of_known_depth_put_the_robot_is_read() -> None:
    pose = geometry_pb2.Pose(
        position_m=geometry_pb2.Vector3(x=1.5, y=-0.5),
        orientation=geometry_pb2.Quaternion(z=0.6, w=0.8),
    )
    for placement, where in [
        (recognition_pb2.Placement(pose=pose, covariance=[0.25] * 9, inliers=20), (1.5, -0.5)),
        (recognition_pb2.Placement(), None),
    ]:
        geometry = recognition_pb2.Geometry(placement=placement)
        message = session_pb2.FrameAnswer(
            reason=session_pb2.REASON_LOOP_CLOSURE, match=recognition_pb2.Match(geometry=geometry)
        )
        match = answers.answer(message).match
        assert match
        assert match.geometry
        read = match.geometry.placement
        assert read
        assert (read.inliers, list(read.covariance)) == (placement.inliers, list(placement.covariance))
        assert (read.pose and (read.pose.x_m, read.pose.y_m)) == where
