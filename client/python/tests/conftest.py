"""Real servers, and the drive and the model that ship with the repository."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, TypeVar

import pytest

import waypost

REPOSITORY = Path(__file__).resolve().parents[3]
MODEL = REPOSITORY / "demo" / "model.waypost"
IMAGES = sorted((REPOSITORY / "demo" / "sequence" / "images").glob("*.jpg"))
SECOND_NS = 1_000_000_000
#: Far more than a start or a stop takes.
PATIENCE_S = 60.0

T = TypeVar("T")


def binary(name: str) -> Path:
    """`waypost-server` or `waypost`, as built from this repository."""
    target = Path(os.environ.get("CARGO_TARGET_DIR") or REPOSITORY / "target")
    path = Path(os.environ.get("WAYPOST_BINARIES") or target / "release") / name
    if not path.is_file():
        pytest.exit(f"{path} is missing: run `make build`, or say in WAYPOST_BINARIES where it is", 3)
    return path


def environment() -> dict[str, str]:
    """This one without settings for Waypost."""
    return {name: value for name, value in os.environ.items() if not name.startswith("WAYPOST_")}


def frame(sequence: int, **changes: Any) -> waypost.Frame:
    """The frame of that number, from 1, of the shipped drive, as `waypost stream` would send it."""
    fields = {"image": IMAGES[sequence - 1].read_bytes(), **changes} if sequence <= len(IMAGES) else changes
    return waypost.Frame(sequence=sequence, stamp_ns=sequence * SECOND_NS, **fields)


def answers(session: waypost.Session, sequences: range) -> list[waypost.Answer]:
    """Streams frames of the shipped drive, none of which may be refused."""
    outcomes = list(session.stream(frame(sequence) for sequence in sequences))
    assert [outcome.sequence for outcome in outcomes] == list(sequences)
    return [
        outcome for outcome in outcomes if isinstance(outcome, waypost.Answer) or pytest.fail(str(outcome))
    ]


def decided(answer: waypost.Answer) -> dict[str, Any]:
    """An answer but for what is of the moment."""
    of_the_moment = {"last_committed_sequence", "timings", "resent"}
    decided = {name: value for name, value in vars(answer).items() if name not in of_the_moment}
    return {**decided, "places": answer.places.tolist(), "posteriors": answer.posteriors.tolist()}


@dataclass
class Server:
    """`waypost-server` in a process of its own."""

    data_dir: Path
    address: str = "127.0.0.1:0"
    http_address: str = "127.0.0.1:0"
    #: What else it is started with.
    flags: tuple[str, ...] = ()
    process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """On free ports the first time, then on the same."""
        ready, log = self.data_dir.with_suffix(".ready"), self.data_dir.with_suffix(".log")
        ready.unlink(missing_ok=True)
        command: list[str | Path] = [binary("waypost-server"), "--data-dir", self.data_dir]
        command += ["--ready-file", ready]
        command += ["--grpc-address", self.address, "--http-address", self.http_address, *self.flags]
        with log.open("wb") as stderr:
            self.process = subprocess.Popen(command, env=environment(), stdout=stderr, stderr=stderr)
        deadline = time.monotonic() + PATIENCE_S
        while not ready.exists():
            if self.process.poll() is not None or time.monotonic() > deadline:
                self.kill()
                pytest.fail(f"the server did not start:\n{log.read_text()}")
            time.sleep(0.005)
        addresses = json.loads(ready.read_text())
        self.address, self.http_address = addresses["grpc"], addresses["http"]

    def kill(self) -> None:
        """`kill -9`."""
        self._end(signal.SIGKILL)

    def terminate(self) -> int | None:
        """Asks it to stop in good order; gives its exit code."""
        return self._end(signal.SIGTERM)

    def freeze(self) -> None:
        """It neither answers nor goes away."""
        assert self.process is not None
        self.process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """It goes on."""
        assert self.process is not None
        self.process.send_signal(signal.SIGCONT)

    def _end(self, how: signal.Signals) -> int | None:
        if self.process is None:
            return None
        self.process.send_signal(how)
        code, self.process = self.process.wait(PATIENCE_S), None
        return code


class Proxy:
    """A way to a server that can be cut while the server lives on."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._ends: list[socket.socket] = []
        threading.Thread(target=self._accept, name="proxy", daemon=True).start()

    def cut(self) -> None:
        """Breaks all connections; new ones are let through."""
        while self._ends:
            with contextlib.suppress(OSError):
                self._ends.pop().shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.cut()

    def _accept(self) -> None:
        host, _, port = self._server.address.rpartition(":")
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection((host, int(port)))
                self._ends += [near, far]
                for source, target in ((near, far), (far, near)):
                    threading.Thread(target=self._copy, args=(source, target), daemon=True).start()

    @staticmethod
    def _copy(source: socket.socket, target: socket.socket) -> None:
        with contextlib.suppress(OSError), source, target:
            while chunk := source.recv(1 << 16):
                target.sendall(chunk)
            target.shutdown(socket.SHUT_RDWR)


def eventually(is_so: Callable[[], T], timeout_s: float = PATIENCE_S) -> T:
    """Waits until something is so, and gives it."""
    deadline = time.monotonic() + timeout_s
    while not (found := is_so()):
        assert time.monotonic() < deadline, "it never became so"
        time.sleep(0.01)
    return found


def our_threads() -> list[str]:
    """The threads of the package that run."""
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("waypost-")]


@pytest.fixture
def mortal(tmp_path: Path) -> Iterator[Server]:
    """A server of the test's own, which it may kill, that knows the shipped model as `shipped`."""
    server = Server(tmp_path / "data")
    server.start()
    try:
        with waypost.connect(server.address) as client:
            client.import_model(MODEL, "shipped")
        yield server
    finally:
        server.kill()


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that knows the shipped model as `shipped`."""
    server = Server(tmp_path_factory.mktemp("server") / "data")
    server.start()
    try:
        with waypost.connect(server.address) as client:
            client.import_model(MODEL, "shipped")
        yield server
    finally:
        server.kill()


@pytest.fixture
def client(server: Server) -> Iterator[waypost.Client]:
    """A connection to it."""
    with waypost.connect(server.address) as client:
        yield client


@pytest.fixture
def hall(client: waypost.Client, request: pytest.FixtureRequest) -> str:
    """An empty map, named after the test."""
    map_id = str(request.node.name).split("[")[0].replace("test_", "")[:63]
    client.create_map(map_id, "shipped")
    return map_id
