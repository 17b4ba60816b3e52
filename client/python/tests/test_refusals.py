"""What the server refuses, and what this side refuses before it."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import grpc
import numpy as np
import pytest
from conftest import Server, answers, frame

import waypost


def test_a_refused_frame_is_an_outcome_and_the_stream_goes_on(client: waypost.Client, hall: str) -> None:
    frames = [
        frame(1),
        frame(2, image=b"GIF89a"),
        frame(3, image=bytes(waypost.MAX_IMAGE_BYTES + 1)),
        frame(4, odometry=(float("nan"), 0, 0)),
        frame(5),
    ]
    with client.session(hall, "robot") as session:
        outcomes = list(session.stream(frames))
    assert [outcome.sequence for outcome in outcomes] == [1, 2, 3, 4, 5]
    assert [isinstance(outcome, waypost.Refusal) for outcome in outcomes] == [False, True, True, True, False]
    assert not any(outcome.loop_closure for outcome in outcomes)
    for outcome, hint in zip(outcomes[1:4], ["JPEG", "make it smaller", "odometry"]):
        assert isinstance(outcome, waypost.Refusal)
        assert isinstance(outcome.error, waypost.InvalidArgument)
        assert hint in outcome.error.message
        # Frames are refused as soon as they are looked at: the first may not be durable by then.
        assert outcome.last_committed_sequence in (None, 1)
    assert client.map(hall).frames == 2


def test_a_number_that_was_skipped_is_refused(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "robot") as session:
        list(session.stream([frame(1), frame(5)]))
        [refusal] = session.stream([frame(3)])
    assert isinstance(refusal, waypost.Refusal)
    assert isinstance(refusal.error, waypost.FailedPrecondition)
    assert "skipped" in str(refusal.error)


def test_wrong_names_are_exceptions_with_the_words_of_the_server(client: waypost.Client, hall: str) -> None:
    with pytest.raises(waypost.NotFound, match="cellar"):
        client.session("cellar")
    with pytest.raises(waypost.NotFound, match="cellar"):
        client.map("cellar")
    with pytest.raises(waypost.InvalidArgument):
        client.session(hall, "Not A Name")
    with pytest.raises(waypost.AlreadyExists, match=hall) as refused:
        client.create_map(hall, "shipped")
    assert refused.value.code == grpc.StatusCode.ALREADY_EXISTS
    with pytest.raises(waypost.NotFound):
        client.create_map("other", "models/000000")


def test_a_deleted_map_ends_its_sessions(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "robot") as session:
        answers(session, range(1, 3))
        client.delete_map(hall)
        with pytest.raises(waypost.NotFound):
            list(session.stream([frame(3)]))
    assert hall not in [found.name for found in client.maps()]


def test_a_session_that_is_taken_over_ends(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "robot") as older, client.session(hall, "robot") as newer:
        with pytest.raises(waypost.Aborted):
            list(older.stream([frame(1)]))
        answers(newer, range(1, 3))


def test_numbers_have_to_rise(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "robot") as session:
        outcomes = session.stream([frame(1), frame(2), frame(2)])
        assert [next(outcomes).sequence, next(outcomes).sequence] == [1, 2]
        with pytest.raises(ValueError, match="frame 2 follows frame 2"):
            next(outcomes)
        # That was no error of the session.
        answers(session, range(3, 5))


def test_what_the_frames_raise_comes_after_the_outcomes_of_those_before(
    client: waypost.Client, hall: str
) -> None:
    def unplugged() -> Iterator[waypost.Frame]:
        yield frame(1)
        yield frame(2)
        raise OSError("the camera is unplugged")

    with client.session(hall, "robot") as session:
        outcomes = session.stream(unplugged())
        assert [next(outcomes).sequence, next(outcomes).sequence] == [1, 2]
        with pytest.raises(OSError, match="unplugged"):
            next(outcomes)


def test_a_stream_that_is_left_early_does_not_confuse_the_next(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "robot", window_frames=4) as session:
        for outcome in session.stream(frame(sequence) for sequence in range(1, 100)):
            if outcome.sequence == 3:
                break
        answers(session, range(1, 12))
    assert client.map(hall).frames == 11


def test_nobody_at_the_address_is_said_at_once() -> None:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        nobody = "127.0.0.1:%d" % bound.getsockname()[1]  # noqa: UP031
        with pytest.raises(waypost.ServerUnreachable, match=f"{nobody}.*check that waypost-server runs"):
            waypost.connect(nobody)


def test_tls_to_a_server_without_is_no_connection(server: Server) -> None:
    with pytest.raises(waypost.ServerUnreachable, match=r"http://, and give ca="):
        waypost.connect(server.address, tls=True)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "either an image or words"),
        (
            {"image": b"x", "words": waypost.WordHistogram(np.array([1], np.uint32))},
            "either an image or words",
        ),
        ({"image": b"x", "sequence": -1}, "from 0 to"),
        ({"image": b"x", "stamp_ns": 1 << 63}, "from 0 to"),
        ({"image": b"x", "odometry_covariance": np.eye(6)}, "needs odometry"),
    ],
)
def test_frames_that_no_server_would_take_cannot_be_made(fields: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        waypost.Frame(**{"sequence": 1, "stamp_ns": 1, **fields})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "options", [{"window_frames": 0}, {"patience_s": -1.0}, {"patience_s": float("nan")}]
)
def test_options_that_cannot_work_are_refused(client: waypost.Client, options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        client.session("hall", **options)  # type: ignore[arg-type]
