"""Servers that die, and servers that want a frame again."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from concurrent import futures
from typing import Any, Callable

import grpc
import pytest
from conftest import IMAGES, MODEL, SECOND_NS, Server, answers, decided, frame
from google.rpc import code_pb2, error_details_pb2

import waypost
from waypost.v1 import map_pb2, map_pb2_grpc, session_pb2, session_pb2_grpc

FRAMES = 24


@pytest.fixture
def mortal(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server of the test's own, with two maps."""
    server = Server(tmp_path_factory.mktemp("mortal") / "data")
    server.start()
    with waypost.connect(server.address) as client:
        client.import_model(MODEL, "shipped")
        client.create_map("hall", "shipped")
        client.create_map("undisturbed", "shipped")
    yield server
    server.kill()


def test_a_session_outlives_kills(mortal: Server) -> None:
    with waypost.connect(mortal.address) as client:
        with client.session("undisturbed", "robot") as session:
            expected = answers(session, range(1, FRAMES + 1))
        outcomes = []
        with client.session("hall", "robot") as session:
            for outcome in session.stream(frame(sequence) for sequence in range(1, FRAMES + 1)):
                outcomes.append(outcome)
                if outcome.sequence in (1, 7, 18):
                    mortal.kill()
                    mortal.start()
        assert [outcome.sequence for outcome in outcomes] == list(range(1, FRAMES + 1))
        streamed = [outcome for outcome in outcomes if isinstance(outcome, waypost.Answer)]
        assert without_names(streamed) == without_names(expected)
        maps = {name: client.map(name, full=True) for name in ("hall", "undisturbed")}
        assert maps["hall"].frames == FRAMES
        assert maps["hall"].state_hash == maps["undisturbed"].state_hash


def test_a_server_that_stops_in_good_order_and_comes_back(mortal: Server) -> None:
    with waypost.connect(mortal.address) as client, client.session("hall", "robot") as session:
        answers(session, range(1, 4))
        assert mortal.terminate() == 0
        mortal.start()
        assert [answer.resent for answer in answers(session, range(4, 7))] == [False] * 3
        assert client.map("hall").frames == 6


def test_a_server_that_stays_away_is_said_so(mortal: Server) -> None:
    with waypost.connect(mortal.address) as client:
        session = client.session("hall", "robot", patience_s=2.0)
        answers(session, range(1, 3))
        mortal.kill()
        with pytest.raises(waypost.SessionLost, match=r"2 frames unacknowledged.*open the same session"):
            list(session.stream([frame(3), frame(4)]))
        with pytest.raises(waypost.SessionLost):
            client.session("hall", "robot", patience_s=0.2)
        with pytest.raises(waypost.ServerUnreachable, match="check that waypost-server runs"):
            client.maps()
        mortal.start()
        # The same session goes on.
        answers(session, range(3, 5))
        session.close()
        assert client.map("hall").frames == 4


def test_a_job_is_waited_for_until_the_next_server_has_done_it(mortal: Server) -> None:
    with waypost.connect(mortal.address) as client:
        # Others wait for their turn behind it.
        training = client.train_model(IMAGES[:60], 2000, display_name="never")
        compacting = client.compact_map("hall")
        with futures.ThreadPoolExecutor(1) as waiting:
            ended = waiting.submit(client.wait_for_job, compacting)
            with pytest.raises(futures.TimeoutError):
                ended.result(timeout=0.5)
            mortal.kill()
            with pytest.raises(waypost.ServerUnreachable):
                client.wait_for_job(compacting, patience_s=0.3)
            mortal.start()
            assert ended.result(timeout=30.0).name == compacting.name
        with pytest.raises(waypost.Aborted, match="start it again"):
            client.wait_for_job(training)


def test_a_watch_goes_on_with_the_next_server(mortal: Server) -> None:
    with waypost.connect(mortal.address) as client, client.watch("hall", 0) as all_frames:
        with client.session("hall", "robot") as session:
            answers(session, range(1, 4))
            assert [next(all_frames).frame.frame.answer.sequence for _ in range(3)] == [1, 2, 3]
            # Where the log ended is all that this one has to go on from.
            new_frames = client.watch("hall", patience_s=30.0)
            with new_frames, futures.ThreadPoolExecutor(1) as waiting:
                first = waiting.submit(next, new_frames)
                with pytest.raises(futures.TimeoutError):
                    first.result(timeout=0.5)
                mortal.kill()
                mortal.start()
                answers(session, range(4, 6))
                told = [first.result(timeout=30.0), next(new_frames)]
                assert [event.frame.frame.answer.sequence for event in told] == [4, 5]
        assert [next(all_frames).frame.frame.answer.sequence for _ in range(2)] == [4, 5]
        with client.watch("hall", patience_s=0.3) as hasty:
            waiting_for = threading.Timer(0.5, mortal.kill)
            waiting_for.start()
            with pytest.raises(waypost.ServerUnreachable):
                next(hasty)
            waiting_for.join()


def test_a_watch_does_not_go_on_in_another_log(mortal: Server) -> None:
    """Positions mean something else once a session is removed."""
    with waypost.connect(mortal.address) as client:
        for name in ("first", "second"):
            with client.session("hall", name) as session:
                answers(session, range(1, 4))
        # The watch ends first, so that who waits for it does not wait for ever.
        with futures.ThreadPoolExecutor(1) as waiting, client.watch("hall", 0, patience_s=30.0) as events:
            assert [next(events).frame.frame.answer.sequence for _ in range(3)] == [1, 2, 3]
            mortal.kill()
            mortal.start()
            client.wait_for_job(client.delete_session("maps/hall/sessions/first"))
            rest = waiting.submit(lambda: list(itertools.islice(events, 10)))
            with pytest.raises(waypost.Aborted, match="watch it again"):
                rest.result(timeout=30.0)


def without_names(streamed: list[waypost.Answer]) -> list[dict[str, Any]]:
    """Decisions with matched frames by their numbers alone: the maps differ in name."""
    plain = []
    for answer in streamed:
        told = decided(answer)
        for name in ("match", "best_candidate"):
            match = told[name]
            told[name] = match and (match.place_number, match.posterior, match.log_odds, match.frame.sequence)
        plain.append(told)
    return plain


Conversation = Callable[[Iterator[session_pb2.StreamRequest]], Iterator[session_pb2.StreamResponse]]


class Peer(session_pb2_grpc.SessionServiceServicer, map_pb2_grpc.MapServiceServicer):
    """Speaks the contract from a script, for what a healthy server says too rarely to be tested with."""

    def __init__(self, *conversations: Conversation) -> None:
        self.conversations = list(conversations)
        self.openings: list[session_pb2.OpenSession] = []
        self.sent: list[list[int]] = []

    def ListMaps(self, request: map_pb2.ListMapsRequest, context: object) -> map_pb2.ListMapsResponse:  # noqa: N802
        return map_pb2.ListMapsResponse()

    def Stream(  # noqa: N802
        self, requests: Iterator[session_pb2.StreamRequest], context: grpc.ServicerContext
    ) -> Iterator[session_pb2.StreamResponse]:
        self.openings.append(next(requests).open)
        sent: list[int] = []
        self.sent.append(sent)
        yield from self.conversations.pop(0)(noted(requests, sent))


def noted(
    requests: Iterator[session_pb2.StreamRequest], sent: list[int]
) -> Iterator[session_pb2.StreamRequest]:
    for request in requests:
        sent.append(request.frame.sequence)
        yield request


@pytest.fixture
def serve() -> Iterator[Callable[[Peer], str]]:
    servers = []

    def serve(peer: Peer) -> str:
        server = grpc.server(futures.ThreadPoolExecutor(8))
        session_pb2_grpc.add_SessionServiceServicer_to_server(peer, server)
        map_pb2_grpc.add_MapServiceServicer_to_server(peer, server)
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        servers.append(server)
        return f"127.0.0.1:{port}"

    yield serve
    for server in servers:
        server.stop(None).wait()


def opened(last_committed: int | None = None) -> session_pb2.StreamResponse:
    return session_pb2.StreamResponse(
        opened=session_pb2.SessionOpened(
            session="maps/hall/sessions/made-up", last_committed_sequence=last_committed
        )
    )


def answered(sequence: int) -> session_pb2.StreamResponse:
    return session_pb2.StreamResponse(
        answer=session_pb2.FrameAnswer(
            sequence=sequence, last_committed_sequence=sequence, reason=session_pb2.REASON_NEW_PLACE
        )
    )


def postponed(sequence: int, retry_delay_ms: int) -> session_pb2.StreamResponse:
    hint = error_details_pb2.RetryInfo()
    hint.retry_delay.FromMilliseconds(retry_delay_ms)
    refusal = session_pb2.FrameRefusal(sequence=sequence)
    refusal.status.code, refusal.status.message = code_pb2.UNAVAILABLE, "send it again"
    refusal.status.details.add().Pack(hint)
    return session_pb2.StreamResponse(refusal=refusal)


def small(sequence: int) -> waypost.Frame:
    return waypost.Frame(sequence, sequence * SECOND_NS, b"image")


def test_frames_to_be_sent_again_are_sent_again_in_order(serve: Callable[[Peer], str]) -> None:
    def busy(requests: Iterator[session_pb2.StreamRequest]) -> Iterator[session_pb2.StreamResponse]:
        yield opened()
        yield answered(next(requests).frame.sequence)
        yield postponed(next(requests).frame.sequence, retry_delay_ms=20)
        wanted = 2
        for request in requests:
            # As a server does: until the frame comes again, later ones are refused as well.
            if request.frame.sequence == wanted:
                yield answered(wanted)
                wanted += 1
            else:
                yield postponed(request.frame.sequence, retry_delay_ms=20)

    peer = Peer(busy)
    with waypost.connect(serve(peer)) as client, client.session("hall", window_frames=4) as session:
        outcomes = list(session.stream(map(small, range(1, 8))))
    assert [(outcome.sequence, type(outcome)) for outcome in outcomes] == [
        (sequence, waypost.Answer) for sequence in range(1, 8)
    ]
    assert peer.sent[0][:4] == [1, 2, 3, 4]
    # Frame 5 may have been sent when frame 1 was answered; that frame 2 has to wait was not known then.
    assert peer.sent[0][-6:] == [2, 3, 4, 5, 6, 7]
    assert len(peer.sent[0]) in (10, 11)


def test_a_server_that_keeps_postponing_is_given_up(serve: Callable[[Peer], str]) -> None:
    def always_busy(requests: Iterator[session_pb2.StreamRequest]) -> Iterator[session_pb2.StreamResponse]:
        yield opened()
        for request in requests:
            yield postponed(request.frame.sequence, retry_delay_ms=1)

    with waypost.connect(serve(Peer(always_busy))) as client:
        session = client.session("hall", patience_s=0.5)
        with pytest.raises(waypost.SessionLost, match=r"1 frames unacknowledged .*send it again"):
            list(session.stream([small(1)]))


def test_what_was_not_answered_goes_over_the_next_connection(serve: Callable[[Peer], str]) -> None:
    def cut_off(requests: Iterator[session_pb2.StreamRequest]) -> Iterator[session_pb2.StreamResponse]:
        yield opened()
        yield answered(next(requests).frame.sequence)
        next(requests)

    def takes_all(requests: Iterator[session_pb2.StreamRequest]) -> Iterator[session_pb2.StreamResponse]:
        yield opened(last_committed=1)
        for request in requests:
            yield answered(request.frame.sequence)

    peer = Peer(cut_off, takes_all)
    with waypost.connect(serve(peer)) as client, client.session("hall") as session:
        assert [outcome.sequence for outcome in session.stream(map(small, range(1, 6)))] == [1, 2, 3, 4, 5]
    # The name that the server made up is what the session is opened again by.
    assert [opening.session_id for opening in peer.openings] == ["", "made-up"]
    assert peer.sent[1] == [2, 3, 4, 5]


def test_a_server_with_older_data_is_noticed(serve: Callable[[Peer], str]) -> None:
    def forgets(requests: Iterator[session_pb2.StreamRequest]) -> Iterator[session_pb2.StreamResponse]:
        yield opened()
        yield answered(next(requests).frame.sequence)

    def knows_nothing(requests: Iterator[session_pb2.StreamRequest]) -> Iterator[session_pb2.StreamResponse]:
        yield opened()
        yield from ()

    with waypost.connect(serve(Peer(forgets, knows_nothing))) as client:
        session = client.session("hall", "made-up")
        with pytest.raises(waypost.SessionRewound, match=r"frame 1 .* no frame at all"):
            list(session.stream(map(small, range(1, 3))))


def test_nonsense_is_a_protocol_error(serve: Callable[[Peer], str]) -> None:
    def answers_what_nobody_asked(
        requests: Iterator[session_pb2.StreamRequest],
    ) -> Iterator[session_pb2.StreamResponse]:
        yield opened()
        next(requests)
        yield answered(77)

    with waypost.connect(serve(Peer(answers_what_nobody_asked))) as client:
        session = client.session("hall")
        with pytest.raises(waypost.ProtocolError, match="frame 77"):
            list(session.stream([small(1)]))


def test_no_more_frames_are_taken_than_the_window_holds(serve: Callable[[Peer], str]) -> None:
    taken: list[int] = []
    stalled = threading.Event()

    def frames() -> Iterator[waypost.Frame]:
        for sequence in range(1, 20):
            taken.append(sequence)
            yield small(sequence)

    def stalls(requests: Iterator[session_pb2.StreamRequest]) -> Iterator[session_pb2.StreamResponse]:
        yield opened()
        for _ in range(3):
            next(requests)
        # A fourth request would come at once, if it came at all.
        stalled.wait(0.5)
        assert taken == [1, 2, 3]
        yield answered(1)
        yield answered(2)
        yield answered(3)
        for request in requests:
            yield answered(request.frame.sequence)

    with waypost.connect(serve(Peer(stalls))) as client, client.session("hall", window_frames=3) as session:
        assert len(list(session.stream(frames()))) == 19
