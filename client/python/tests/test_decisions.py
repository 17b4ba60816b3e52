"""The same images give the same decisions, from either client."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from conftest import IMAGES, REPOSITORY, Server, answers, binary, decided, environment

import waypost


def test_decisions_are_those_that_the_rust_client_gets(client: waypost.Client, server: Server) -> None:
    client.create_map("rust", "shipped")
    client.create_map("python", "shipped")
    rows = streamed_by_rust(server, "rust", "drive")
    with client.session("python", "drive") as session:
        streamed = answers(session, range(1, len(IMAGES) + 1))
    assert len(rows) == len(streamed)
    for row, answer in zip(rows, streamed):
        expected = {name: row[name] for name in row_of(answer, "rust")}
        assert row_of(answer, "rust") == expected
    assert client.map("python", full=True).state_hash == client.map("rust", full=True).state_hash

    closures = [answer for answer in streamed if answer.loop_closure]
    assert len(closures) >= 10, "the shipped drive closes loops"
    for answer, match in zip(closures, client.loop_closures("python")):
        assert answer.reason == waypost.Reason.LOOP_CLOSURE
        assert answer.loop_closure is not None
        assert (answer.sequence, answer.loop_closure.frame) == (match.frame.sequence, match.matched_frame)
        assert answer.loop_closure.frame.session == session.name == "maps/python/sessions/drive"
    assert len(closures) == client.map("python").loop_closures
    check_posteriors(streamed)


def test_stored_answers_are_the_same_and_a_session_goes_on(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "drive") as session:
        assert session.last_committed_sequence is None
        first = answers(session, range(1, 7))
        assert session.last_committed_sequence == 6
        # The same stream takes more.
        first += answers(session, range(7, 10))
    with client.session(hall, "drive") as session:
        assert session.last_committed_sequence == 9
        state_hash = client.map(hall, full=True).state_hash
        again = answers(session, range(1, 10))
        assert [decided(answer) for answer in again] == [decided(answer) for answer in first]
        assert all(answer.resent and answer.timings is None for answer in again)
        assert client.map(hall, full=True).state_hash == state_hash
        [further] = answers(session, range(10, 11))
    assert not further.resent
    assert further.timings is not None
    assert further.timings.total_ms > 0


def test_a_session_without_a_name_gets_one(client: waypost.Client, hall: str) -> None:
    with client.session(f"maps/{hall}") as session:
        assert session.name.startswith(f"maps/{hall}/sessions/")
        assert session.model == client.map(hall).model == client.models()[0].name


def streamed_by_rust(server: Server, map_id: str, session_id: str) -> list[dict[str, Any]]:
    command: list[str | Path] = [binary("waypost"), "--server", f"http://{server.address}"]
    command += ["--json", "stream"]
    command += [REPOSITORY / "demo" / "sequence", "--map", map_id, "--session", session_id]
    streamed = subprocess.run(command, env=environment(), stdout=subprocess.PIPE, check=True)
    frames: list[dict[str, Any]] = json.loads(streamed.stdout)["frames"]
    return frames


def row_of(answer: waypost.Answer, map_id: str) -> dict[str, Any]:
    """The row that `waypost stream --json` prints of an answer, but for the times."""
    row: dict[str, Any] = {
        "sequence": answer.sequence,
        "reason": answer.reason.name.lower(),
        "place_number": answer.place_number,
        "posterior": answer.posterior,
        "new_place_posterior": answer.new_place_posterior,
        "words": answer.words,
        "resent": answer.resent,
    }
    matches = {"match": answer.match, "best_candidate": answer.best_candidate}
    for name, match in matches.items():
        row[f"{name}_place_number"] = match and match.place_number
        row[f"{name}_posterior"] = match and match.posterior
        row[f"{name}_log_odds"] = match and match.log_odds
        row[f"{name}_session"] = match and match.frame.session.replace("/python/", f"/{map_id}/")
        row[f"{name}_sequence"] = match and match.frame.sequence
    return row


def check_posteriors(streamed: list[waypost.Answer]) -> None:
    for answer in streamed:
        assert answer.places.dtype == np.uint32
        assert answer.posteriors.dtype == np.float64
        assert answer.places.shape == answer.posteriors.shape
        assert len(answer.places) <= 10
        assert (np.diff(answer.posteriors) <= 0).all()
        assert answer.posteriors.sum() + answer.new_place_posterior <= 1 + 1e-9
    assert max(len(answer.places) for answer in streamed) == 10
