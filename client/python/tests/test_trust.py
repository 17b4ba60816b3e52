"""Servers that ask who is there, and that show who they are."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import trustme
from conftest import MODEL, Server, answers, binary, environment, frame

import waypost
from waypost.v1 import token_pb2


def create_token(data_dir: Path, name: str, role: str) -> str:
    """While no server runs; gives the secret."""
    command = [str(binary("waypost-server")), "token", "create", name, "--role", role]
    command += ["--data-dir", str(data_dir)]
    created = subprocess.run(command, env=environment(), capture_output=True, text=True, check=True)
    secret: str = next(word for word in created.stdout.split() if word.startswith("waypost_"))
    return secret


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[tuple[Server, str, str]]:
    """A server with the secrets of an admin and of a robot."""
    data_dir = tmp_path / "data"
    admin, robot = create_token(data_dir, "operator", "admin"), create_token(data_dir, "robot", "robot")
    server = Server(data_dir)
    server.start()
    yield server, admin, robot
    server.kill()


def test_a_token_opens_what_it_is_for(guarded: tuple[Server, str, str]) -> None:
    server, admin, robot = guarded
    for wrong in [None, "", "waypost_0", robot[:-1]]:
        with pytest.raises(waypost.Unauthenticated, match="token"):
            waypost.connect(server.address, token=wrong)
    with waypost.connect(server.address, token=admin) as operator:
        operator.import_model(MODEL, "shipped")
        operator.create_map("hall", "shipped")
    with waypost.connect(server.address, token=robot) as client:
        with client.session("hall", "robot") as session:
            assert [answer.sequence for answer in answers(session, range(1, 4))] == [1, 2, 3]
        with pytest.raises(waypost.PermissionDenied, match="admin"):
            client.create_map("cellar", "shipped")
        assert client.map("hall").frames == 3


def test_a_stream_ends_with_its_token(guarded: tuple[Server, str, str]) -> None:
    server, admin, robot = guarded
    with waypost.connect(server.address, token=admin) as operator:
        operator.import_model(MODEL, "shipped")
        operator.create_map("hall", "shipped")
        with waypost.connect(server.address, token=robot) as client, client.session("hall", "r") as session:
            answers(session, range(1, 3))
            rm = [
                str(binary("waypost")),
                "token",
                "rm",
                "robot",
                "--yes",
                "--server",
                f"http://{server.address}",
            ]
            subprocess.run([*rm, "--token", admin], env=environment(), check=True, capture_output=True)
            with pytest.raises(waypost.Unauthenticated):
                list(session.stream([frame(3)]))
        assert operator.map("hall").frames == 2


def test_a_robot_waits_for_its_quotas_and_loses_nothing(guarded: tuple[Server, str, str]) -> None:
    server, admin, _ = guarded
    with waypost.connect(server.address, token=admin) as operator:
        operator.import_model(MODEL, "shipped")
        operator.create_map("hall", "shipped")
        quotas = token_pb2.Quotas(max_sessions=1, max_frames_per_second=4, max_kept_mib=1)
        token, secret = operator.create_token("robot-7", token_pb2.Token.ROLE_ROBOT, quotas=quotas)
        assert token.quotas == quotas
        with waypost.connect(server.address, token=secret) as client, client.session("hall", "r") as session:
            assert client.caller().quotas == quotas
            with pytest.raises(waypost.FailedPrecondition, match="has 1 of the 1 sessions"):
                client.session("hall", "other")
            began = time.monotonic()
            assert [answer.sequence for answer in answers(session, range(1, 9))] == [*range(1, 9)]
            assert time.monotonic() - began > 0.8, "only those of one second may come at once"
            operator.update_token("robot-7", lifted=[token_pb2.Quotas.KIND_FRAMES_PER_SECOND])
            sender = session.sender()
            for number in range(9, 25):
                sender.send(frame(number))
            sender.finish()
            taken = 8
            while (outcome := sender.next_outcome(timeout_s=2.0)) is not None:
                taken = outcome.sequence
            assert taken < 24, "a mebibyte is full by then"
            [_, _, limited] = operator.tokens()
            assert limited.used.sessions == 1
            assert limited.used.kept_bytes == operator.session_record(session.name).kept_bytes <= 1 << 20
            raised = operator.update_token("robot-7", quotas=token_pb2.Quotas(max_kept_mib=100))
            assert (raised.quotas.max_sessions, raised.quotas.max_kept_mib) == (1, 100)
            assert [outcome.sequence for outcome in sender] == [*range(taken + 1, 25)]
        assert operator.map("hall").frames == 24


def test_a_server_is_known_by_its_authority(tmp_path: Path) -> None:
    authority, stranger = trustme.CA(), trustme.CA()
    certificate = authority.issue_cert("localhost")
    chain, key, trusted = tmp_path / "server.crt", tmp_path / "server.key", tmp_path / "ca.crt"
    certificate.cert_chain_pems[0].write_to_path(str(chain))
    certificate.private_key_pem.write_to_path(str(key))
    authority.cert_pem.write_to_path(str(trusted))
    server = Server(tmp_path / "data", flags=(f"--tls-certificate={chain}", f"--tls-key={key}"))
    server.start()
    try:
        address = f"localhost:{server.address.rpartition(':')[2]}"
        authorities: list[Path | str | bytes] = [trusted, str(trusted), trusted.read_bytes()]
        for ca in authorities:
            with waypost.connect(address, ca=ca) as client:
                assert client.maps() == []
        with pytest.raises(waypost.ServerUnreachable):
            waypost.connect(address, ca=stranger.cert_pem.bytes())
        with pytest.raises(waypost.ServerUnreachable):
            waypost.connect(server.address)
    finally:
        server.kill()
