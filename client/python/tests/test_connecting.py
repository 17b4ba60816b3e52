"""Addresses, the environment, tokens and certificates, as the command line takes them."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import trustme
from conftest import MODEL, Server, answers, binary, eventually

import waypost
from waypost.v1 import token_pb2


@pytest.fixture(autouse=True)
def no_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SERVER", "TOKEN", "CA", "CLIENT_CERT", "CLIENT_KEY"):
        monkeypatch.delenv(f"WAYPOST_{name}", raising=False)


@pytest.mark.parametrize("form", ["{}", "http://{}", "http://{}/"])
def test_addresses_are_written_in_several_ways(server: Server, form: str) -> None:
    with waypost.connect(form.format(server.address)) as client:
        assert client.models()


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        ("", "no host"),
        ("localhost", "lacks a port"),
        ("127.0.0.1:port", "port is no number"),
        ("127.0.0.1:70000", "port is no number"),
        ("ftp://127.0.0.1:7600", "the scheme `ftp` is not served"),
        ("http://127.0.0.1:7600/v1", "more than a host and a port"),
        ("http://user@127.0.0.1:7600", "more than a host and a port"),
        ("a b:7600", "no host"),
    ],
)
def test_what_is_no_address_is_said(address: str, reason: str) -> None:
    with pytest.raises(ValueError, match=f"{reason}.*write it as HOST:PORT"):
        waypost.connect(address)


def test_the_other_port_is_named(server: Server) -> None:
    with pytest.raises(waypost.ServerUnreachable, match="7600 unless set otherwise"):
        waypost.connect(server.http_address)


def test_the_environment_is_that_of_the_command_line(mortal: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WAYPOST_SERVER", f"http://{mortal.address}")
    # Empty counts as unset.
    monkeypatch.setenv("WAYPOST_TOKEN", "")
    with waypost.connect() as client:
        _, admin = client.create_token("operator", token_pb2.Token.ROLE_ADMIN)
    with pytest.raises(waypost.Unauthenticated):
        waypost.connect()
    monkeypatch.setenv("WAYPOST_TOKEN", f" {admin}\n")
    with waypost.connect() as client:
        token, robot = client.create_token("robot", token_pb2.Token.ROLE_ROBOT)
        assert [known.name for known in client.tokens()] == ["tokens/operator", token.name]
    with waypost.connect(token=robot) as client:
        caller = client.caller()
        assert (caller.token, caller.role, caller.asks_for_token) == (token.name, token.role, True)
        with pytest.raises(waypost.PermissionDenied, match="admin"):
            client.tokens()
    # Without greeting, the first call is what is refused.
    with waypost.lazy(token="waypost_0") as client:
        with pytest.raises(waypost.Unauthenticated):
            client.session("hall")
        with pytest.raises(waypost.Unauthenticated):
            client.maps()
    with waypost.connect() as client, pytest.raises(waypost.FailedPrecondition):
        client.delete_token("operator")
    with pytest.raises(ValueError, match="copy it again"):
        waypost.connect(token="wäypost")


def test_a_token_that_is_deleted_ends_its_sender(mortal: Server) -> None:
    with waypost.connect(mortal.address) as first:
        _, admin = first.create_token("operator", token_pb2.Token.ROLE_ADMIN)
    with waypost.connect(mortal.address, token=admin) as operator:
        _, robot = operator.create_token("robot", token_pb2.Token.ROLE_ROBOT)
        operator.create_map("hall", "shipped")
        with waypost.connect(mortal.address, token=robot) as client, client.session("hall", "r") as session:
            answers(session, range(1, 3))
            sender = session.sender()
            operator.delete_token("robot")
            eventually(lambda: sender.ended)
            with pytest.raises(waypost.Unauthenticated):
                sender.close()


@dataclass
class Guarded:
    """A server that demands certificates of its clients."""

    address: str
    ca: Path
    client_cert: Path
    client_key: Path
    #: Of an authority that the server does not know.
    strange_cert: Path
    strange_key: Path


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    folder = tmp_path_factory.mktemp("guarded")
    authority, stranger = trustme.CA(), trustme.CA()
    paths = {name: folder / f"{name}.pem" for name in ("ca", "server", "key")}
    authority.cert_pem.write_to_path(str(paths["ca"]))
    own = authority.issue_cert("localhost")
    own.cert_chain_pems[0].write_to_path(str(paths["server"]))
    own.private_key_pem.write_to_path(str(paths["key"]))
    pairs = []
    for name, issuer in (("robot", authority), ("stranger", stranger)):
        issued = issuer.issue_cert(f"{name}@example.org")
        pair = folder / f"{name}.crt", folder / f"{name}.key"
        issued.cert_chain_pems[0].write_to_path(str(pair[0]))
        issued.private_key_pem.write_to_path(str(pair[1]))
        pairs.append(pair)
    flags = (
        f"--tls-certificate={paths['server']}",
        f"--tls-key={paths['key']}",
        f"--tls-client-ca={paths['ca']}",
    )
    server = Server(folder / "data", flags=flags)
    server.start()
    try:
        port = server.address.rpartition(":")[2]
        yield Guarded(f"https://localhost:{port}", paths["ca"], *pairs[0], *pairs[1])
    finally:
        server.kill()


def test_a_certificate_lets_a_client_in(guarded: Guarded, monkeypatch: pytest.MonkeyPatch) -> None:
    own = {"client_cert": guarded.client_cert, "client_key": guarded.client_key.read_bytes()}
    with waypost.connect(guarded.address, ca=guarded.ca, **own) as client:  # type: ignore[arg-type]
        client.import_model(MODEL, "shipped")
        client.create_map("hall", "shipped")
        with client.session("hall", "robot") as session:
            answers(session, range(1, 3))
    with pytest.raises(waypost.ServerUnreachable):
        waypost.connect(guarded.address, ca=guarded.ca)
    with pytest.raises(waypost.ServerUnreachable):
        waypost.connect(
            guarded.address, ca=guarded.ca, client_cert=guarded.strange_cert, client_key=guarded.strange_key
        )
    monkeypatch.setenv("WAYPOST_SERVER", guarded.address)
    monkeypatch.setenv("WAYPOST_CA", str(guarded.ca))
    monkeypatch.setenv("WAYPOST_CLIENT_CERT", str(guarded.client_cert))
    with pytest.raises(ValueError, match="go together"):
        waypost.connect()
    monkeypatch.setenv("WAYPOST_CLIENT_KEY", str(guarded.client_key))
    with waypost.connect() as client:
        assert [found.name for found in client.maps()] == ["maps/hall"]
    # The command line takes the same environment.
    subprocess.run([binary("waypost"), "map", "ls"], check=True, capture_output=True)
    with pytest.raises(ValueError, match="not encrypted"):
        waypost.connect("http://127.0.0.1:7600")
    with pytest.raises(ValueError, match="not in PEM"):
        waypost.connect(ca=b"nonsense")
    with pytest.raises(FileNotFoundError, match=r"ca cannot be read \(No such file.*absent\.pem"):
        waypost.connect(ca="absent.pem")
