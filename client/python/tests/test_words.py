"""Words in place of images, maps that are only read, and queries."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from conftest import IMAGES, SECOND_NS, Server, decided
from PIL import Image

import waypost
from waypost.v1 import map_pb2, session_pb2, session_pb2_grpc

#: A part of the drive that comes back to where it began.
DRIVE = [*IMAGES[:40], *IMAGES[99:120]]
TIMES = dict(enumerate(DRIVE, start=1))


@dataclass(frozen=True)
class Mapped:
    """A map that was made from the images of `DRIVE`."""

    map_id: str
    answers: list[waypost.Answer]
    histograms: list[waypost.WordHistogram]
    words_hash: str


# Histograms cannot be verified by geometry, so that words alone are to decide, and soon.
BY_WORDS = map_pb2.MapSettings(verification=map_pb2.MapSettings.VERIFICATION_NONE, closure_threshold=0.5)


@pytest.fixture(scope="module")
def mapped(server: Server) -> Mapped:
    """The words are those that the server itself keeps of the frames."""
    with waypost.connect(server.address) as client:
        client.create_map("mapped", "shipped", BY_WORDS)
        with client.session("mapped", "robot") as session:
            answers = answered(session, [waypost_frame(n, image=TIMES[n].read_bytes()) for n in TIMES])
            name, words_hash = session.name, session.words_hash
        stub = session_pb2_grpc.SessionServiceStub(client.channel)
        histograms = []
        for number in TIMES:
            kept = stub.GetFrame(session_pb2.GetFrameRequest(name=f"{name}/frames/{number}")).histogram
            counts = list(kept.counts) or None
            histograms.append(waypost.WordHistogram(list(kept.words), counts))  # type: ignore[arg-type]
    assert any(answer.loop_closure for answer in answers)
    return Mapped("mapped", answers, histograms, words_hash)


def waypost_frame(
    sequence: int, image: bytes | None = None, words: waypost.WordHistogram | waypost.WordList | None = None
) -> waypost.Frame:
    return waypost.Frame(sequence, sequence * SECOND_NS, image=image, words=words)


def answered(session: waypost.Session, frames: list[waypost.Frame]) -> list[waypost.Answer]:
    answers = []
    for outcome in session.stream(frames):
        assert isinstance(outcome, waypost.Answer), outcome
        answers.append(outcome)
    assert len(answers) == len(frames)
    return answers


def as_list(histogram: waypost.WordHistogram) -> waypost.WordList:
    """The same words, each as often, at points of no meaning."""
    counts = np.ones_like(histogram.words) if histogram.counts is None else histogram.counts
    words = np.repeat(histogram.words, counts)
    points = np.linspace(0, 300, len(words), dtype=np.float32)
    return waypost.WordList(words, points, points, (640, 360))


def told(answers: list[waypost.Answer]) -> list[dict[str, Any]]:
    """All that was decided, with matched frames by number: the maps have different names."""
    matches = ("match", "best_candidate")
    plain = []
    for answer in answers:
        fields = decided(answer)
        for name in matches:
            match = fields.pop(name)
            fields[name] = match and (
                match.place_number,
                match.posterior,
                match.log_odds,
                match.frame.sequence,
            )
        plain.append(fields)
    return plain


@pytest.mark.parametrize("kind", ["histogram", "list"])
def test_words_are_decided_as_their_images_were(client: waypost.Client, mapped: Mapped, kind: str) -> None:
    map_id = f"words_{kind}"
    client.create_map(map_id, "shipped", BY_WORDS)
    words = [histogram if kind == "histogram" else as_list(histogram) for histogram in mapped.histograms]
    frames = [waypost_frame(number, words=of) for number, of in enumerate(words, start=1)]
    with client.session(map_id, "robot", words_hash=mapped.words_hash) as session:
        answers = answered(session, frames)
    assert told(answers) == told(mapped.answers)
    assert client.map(map_id, full=True).state_hash == client.map(mapped.map_id, full=True).state_hash


def test_words_of_another_vocabulary_are_refused(client: waypost.Client, mapped: Mapped, hall: str) -> None:
    with pytest.raises(waypost.FailedPrecondition, match=r"(?i)words"):
        client.session(hall, "robot", words_hash="0" * len(mapped.words_hash))
    # Nor are words taken from who has not said of which vocabulary they are.
    with client.session(hall, "robot") as session:
        [outcome] = session.stream([waypost_frame(1, words=mapped.histograms[0])])
    assert isinstance(outcome, waypost.Refusal)
    assert "words_hash" in outcome.error.message
    assert client.map(hall).frames == 0


def test_localizing_finds_places_and_changes_nothing(client: waypost.Client, mapped: Mapped) -> None:
    before = client.map(mapped.map_id, full=True)
    frames = [waypost_frame(n, image=TIMES[n].read_bytes()) for n in range(1, 21)]
    with client.session(mapped.map_id, "visitor", mode=waypost.Mode.LOCALIZE) as session:
        answers = answered(session, frames[:10])
    # Resumed, as long as the server runs.
    with client.session(mapped.map_id, "visitor", mode=waypost.Mode.LOCALIZE) as session:
        answers += answered(session, frames[10:])
    assert client.map(mapped.map_id, full=True) == before
    places = [answer.place_number for answer in answers]
    mapped_to = [answer.place_number for answer in mapped.answers[:20]]
    right = sum(place == where for place, where in zip(places, mapped_to))
    assert right >= 10, list(zip(places, mapped_to))
    assert not any(place is not None and place >= before.places for place in places)


def test_a_query_says_where_an_image_was_taken(client: waypost.Client, mapped: Mapped) -> None:
    before = client.map(mapped.map_id, full=True)
    image = TIMES[8].read_bytes()
    found = client.query(mapped.map_id, image, explained_words=5)
    assert found.accepted
    assert found.match is not None
    assert found.match.place_number == found.places[0] == mapped.answers[7].place_number
    assert found.match.frame.session == "maps/mapped/sessions/robot"
    assert found.place_explanation is not None
    assert found.place_explanation.place_number == found.match.place_number
    assert 0 < len(found.place_explanation.words_for) <= 5
    assert found.places.dtype == np.uint32
    assert found.posteriors.sum() + found.new_place_posterior <= 1 + 1e-9

    by_words = client.query(mapped.map_id, mapped.histograms[7], words_hash=mapped.words_hash)
    assert by_words.place_explanation is None
    np.testing.assert_array_equal(by_words.places, found.places)
    np.testing.assert_array_equal(by_words.posteriors, found.posteriors)
    assert (by_words.match, by_words.words) == (found.match, found.words)

    pixels = np.asarray(Image.open(io.BytesIO(image)))
    assert client.query(mapped.map_id, pixels).match is not None
    assert client.map(mapped.map_id, full=True) == before
    with pytest.raises(waypost.NotFound):
        client.query("nowhere", image)
