"""Frames pushed by callbacks."""

from __future__ import annotations

import threading

import pytest
from conftest import Server, answers, decided, eventually, frame, our_threads

import waypost


def test_frames_from_callbacks_are_decided_like_those_of_a_stream(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "pulled") as session:
        expected = [decided(answer) for answer in answers(session, range(1, 9))]
    client.delete_map(hall)
    client.create_map(hall, "shipped")
    outcomes: list[waypost.Outcome] = []
    with client.session(hall, "pulled") as session:
        with session.sender(outcomes.append) as sender:
            for sequence in range(1, 9):
                # A thread for each, as camera drivers have it.
                camera = threading.Thread(target=sender.send, args=(frame(sequence),))
                camera.start()
                camera.join()
        assert [decided(outcome) for outcome in outcomes if isinstance(outcome, waypost.Answer)] == expected
        with pytest.raises(waypost.WaypostError, match="closed"):
            sender.send(frame(9))
        # The session goes on, with another sender or pulled, but not with both at once.
        with session.sender() as another:
            another.send(frame(9))
            with pytest.raises(waypost.WaypostError, match="has a sender already"):
                session.sender()
            another.finish()
            assert [outcome.sequence for outcome in another] == [9]
        answers(session, range(10, 12))
    assert client.map(hall).frames == 11
    eventually(lambda: not our_threads())


def test_a_full_queue_refuses_and_goes_on(mortal: Server) -> None:
    with waypost.connect(mortal.address) as client:
        client.create_map("hall", "shipped")
        with client.session("hall", "robot") as session, session.sender(queue_frames=3) as sender:
            mortal.freeze()
            try:
                for sequence in range(1, 4):
                    sender.send(frame(sequence))
                with pytest.raises(waypost.QueueFull, match=r"frame 4 was not taken: 3 frames wait"):
                    sender.send(frame(4))
                with pytest.raises(waypost.QueueFull):
                    sender.send(frame(4), timeout_s=0.05)
            finally:
                mortal.thaw()
            # Outcomes make room once they are taken.
            assert [outcome.sequence for _, outcome in zip(range(3), sender)] == [1, 2, 3]
            sender.send(frame(5), timeout_s=30)
        assert session.last_committed_sequence == 5
        assert client.map("hall").frames == 4


def test_numbers_and_frames_that_cannot_be_sent_are_refused_at_once(
    client: waypost.Client, hall: str
) -> None:
    with client.session(hall, "robot") as session, session.sender() as sender:
        sender.send(frame(2))
        with pytest.raises(ValueError, match="frame 2 follows frame 2"):
            sender.send(frame(2))
        with pytest.raises(ValueError, match="read_bytes"):
            sender.send(waypost.Frame(3, 3, "000003.jpg"))  # type: ignore[arg-type]
        sender.send(frame(3))
        assert sender.next_outcome() is not None
    assert client.map(hall).frames == 2


def test_a_sender_outlives_kills(mortal: Server) -> None:
    with waypost.connect(mortal.address) as client:
        client.create_map("hall", "shipped")
        outcomes: list[int] = []
        with client.session("hall", "robot") as session:
            with session.sender(lambda outcome: outcomes.append(outcome.sequence)) as sender:
                for sequence in range(1, 13):
                    sender.send(frame(sequence))
                    if sequence in (4, 8):
                        mortal.kill()
                        mortal.start()
            assert outcomes == list(range(1, 13))
        assert client.map("hall").frames == 12


def test_a_session_that_is_lost_is_said_at_the_next_frame(mortal: Server) -> None:
    with waypost.connect(mortal.address) as client:
        client.create_map("hall", "shipped")
        with client.session("hall", "robot", patience_s=0.5) as session:
            sender = session.sender()
            mortal.kill()
            sender.send(frame(1))
            eventually(lambda: sender.ended)
            for once_more in (lambda: sender.send(frame(2)), sender.close, sender.next_outcome):
                with pytest.raises(waypost.SessionLost, match="1 frames unacknowledged"):
                    once_more()
        eventually(lambda: not our_threads())


def test_what_a_callback_raises_ends_the_sender(client: waypost.Client, hall: str) -> None:
    def broken(outcome: waypost.Outcome) -> None:
        raise RuntimeError("the disk is full")

    with client.session(hall, "robot") as session:
        sender = session.sender(broken)
        sender.send(frame(1))
        with pytest.raises(RuntimeError, match="disk"):
            sender.close()
        answers(session, range(2, 4))
    eventually(lambda: not our_threads())


def test_left_by_an_exception_it_does_not_wait(mortal: Server) -> None:
    with waypost.connect(mortal.address) as client:
        client.create_map("hall", "shipped")
        session = client.session("hall", "robot")
        mortal.freeze()
        try:
            with pytest.raises(ValueError, match="follows"), session.sender() as sender:  # noqa: PT012
                sender.send(frame(1))
                sender.send(frame(1))
        finally:
            mortal.thaw()
        answers(session, range(2, 4))
        # A session that is closed gives up what its sender has left.
        forgotten = session.sender()
        session.close()
        assert forgotten.ended
    eventually(lambda: not our_threads())
