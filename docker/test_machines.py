"""Machines of PostgreSQL, as `postgres-machine` makes them of Debian's."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import waypost

DOCKER = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCKER.parent / "client" / "python" / "tests"))

from conftest import Server, eventually  # noqa: E402


class Machines:
    """Three machines of PostgreSQL, as `postgres-machine` makes them, at addresses of loopback."""

    NAMES = ("127.0.0.1", "127.0.0.2", "127.0.0.3")

    def __init__(self, folder: Path, programs: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            self.port = listener.getsockname()[1]
        self.folder, self.programs = folder, programs
        # PostgreSQL's user may not look into this repository.
        self.script = shutil.copy(DOCKER / "postgres-machine", folder)
        # PostgreSQL does not run as root.
        self.user = {"user": "postgres", "group": "postgres", "extra_groups": []} if os.getuid() == 0 else {}
        self.running = {name: self.start(name) for name in self.NAMES}

    def environment(self, name: str) -> dict[str, str]:
        home = self.folder / name
        if not home.is_dir():
            home.mkdir()
            if self.user:
                shutil.chown(home, "postgres", "postgres")
        return {
            "PATH": f"{self.programs}:{os.environ['PATH']}",
            "MACHINES": " ".join(self.NAMES),
            "MACHINE": name,
            "PASSWORD": "it's",
            "PGDATA": str(home / "data"),
            "LISTEN": name,
            "SOCKETS": str(home),
            "PGPORT": str(self.port),
        }

    def start(self, name: str) -> subprocess.Popen[bytes]:
        env = self.environment(name)
        with (self.folder / f"{name}.log").open("ab") as log:
            return subprocess.Popen(
                [self.script], env=env, stderr=log, cwd=env["SOCKETS"], start_new_session=True, **self.user
            )

    def run(self, name: str, *command: str | Path) -> str:
        env = self.environment(name)
        done = subprocess.run(
            command, env=env, cwd=env["SOCKETS"], stdout=subprocess.PIPE, text=True, timeout=60, **self.user
        )
        assert done.returncode == 0, f"{command}: {done.stdout}"
        return done.stdout.strip()

    def kill(self, name: str) -> None:
        self.running[name].kill()
        self.running[name].wait()

    def cut_off(self, name: str, at: str, program: str, *command: str | Path) -> None:
        """Runs what is killed as soon as it calls a program with such arguments."""
        env = self.environment(name)
        home = Path(env["SOCKETS"])
        fatal = home / program
        killing = f'case "$*" in {at}) kill -9 $PPID; exit ;; esac'
        fatal.write_text(f'#!/bin/sh\n{killing}\nexec {shutil.which(program)} "$@"\n')
        fatal.chmod(0o755)
        env["PATH"] = f"{home}:{env['PATH']}"
        done = subprocess.run(command, env=env, cwd=home, timeout=60, **self.user)
        assert done.returncode == -signal.SIGKILL
        fatal.unlink()

    def ask(self, name: str, statement: str) -> str:
        """What a machine's own administrator hears."""
        where = ["--host", self.environment(name)["SOCKETS"], "--port", str(self.port)]
        return self.run(name, "psql", "--no-psqlrc", "--username=postgres", *where, "-Atqc", statement)

    def url(self) -> str:
        hosts = ",".join(f"{name}:{self.port}" for name in self.NAMES)
        return f"postgres://waypost:it%27s@{hosts}/maps"

    def stop(self) -> None:
        for machine in self.running.values():
            machine.send_signal(signal.SIGQUIT)
        for machine in self.running.values():
            try:
                machine.wait(timeout=10)
            except subprocess.TimeoutExpired:
                # One that waits for another to copy has no PostgreSQL that would listen.
                os.killpg(machine.pid, signal.SIGKILL)
                machine.wait()


@pytest.fixture
def machines() -> Iterator[Machines]:
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: int(path.parent.name))
    if not programs:
        pytest.skip("PostgreSQL is not installed: scripts/setup postgres")
    # Where its own user may go.
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o711)
        machines = Machines(Path(folder), programs[-1])
        yield machines
        machines.stop()


def test_machines_follow_the_first_and_one_takes_over(machines: Machines, tmp_path: Path) -> None:
    def standbys() -> list[tuple[str, str]]:
        try:
            return [(standby.name, standby.sync_state) for standby in client.cluster().standbys]
        except waypost.WaypostError:
            return []

    first, second, third = machines.NAMES
    server = Server(tmp_path / "scratch", flags=("--storage", machines.url()))
    eventually(lambda: (Path(machines.environment(third)["PGDATA"]) / "PG_VERSION").is_file())
    server.start()
    try:
        with waypost.client.lazy(server.address) as client:
            eventually(lambda: standbys() == [(second, "quorum"), (third, "quorum")])
            assert not client.cluster().warnings
            eventually(lambda: all(standby.HasField("lag_bytes") for standby in client.cluster().standbys))
            client.create_map("before", "shipped")
            machines.kill(first)
            received = "SELECT pg_last_wal_receive_lsn() - '0/0'"
            other, chosen = sorted((second, third), key=lambda name: int(machines.ask(name, received)))
            machines.run(chosen, "pg_ctl", "promote", "--silent")
            machines.run(other, machines.script, "follow", chosen)
            eventually(lambda: standbys() == [(other, "quorum")])
            client.create_map("after", "shipped")
            # The first comes back as a copy.
            machines.run(first, machines.script, "copy", chosen)
            machines.running[first] = machines.start(first)
            eventually(lambda: standbys() == [(first, "quorum"), (other, "quorum")])
            assert [found.name for found in client.maps()] == ["maps/after", "maps/before"]
            # Whoever may not see it says so.
            machines.ask(chosen, "REVOKE pg_monitor FROM waypost")
            eventually(lambda: standbys() == [(first, "unknown"), (other, "unknown")])
            assert not any(standby.HasField("lag_bytes") for standby in client.cluster().standbys)
    finally:
        server.kill()


def test_machines_whose_copy_was_cut_off_do_not_begin_anew(machines: Machines) -> None:
    first, second, _ = machines.NAMES
    data = Path(machines.environment(first)["PGDATA"])
    log = machines.folder / f"{first}.log"
    is_standby = "SELECT count(*) FROM pg_stat_wal_receiver"
    eventually(lambda: (Path(machines.environment(second)["PGDATA"]) / "PG_VERSION").is_file())
    eventually(lambda: "ready to accept" in (machines.folder / f"{second}.log").read_text())
    machines.kill(first)
    machines.run(second, "pg_ctl", "promote", "--silent")
    copy = (machines.script, "copy", second)
    # When the copy is whole and not yet in its place, and before there is any.
    for at, program in ((f"{data}.new*", "mv"), ("*", "rm")):
        machines.cut_off(first, at, program, *copy)
        machines.running[first] = machines.start(first)
        assert machines.running[first].wait(timeout=30) == 1
        assert log.read_text().endswith(f"run `copy MACHINE` again; what it had is in {data}.old\n")
        assert not data.exists()
    # When it is in its place, and the data before is not gone.
    machines.cut_off(first, f"*{data}.old", "rm", *copy)
    assert (data / "PG_VERSION").is_file()
    assert Path(f"{data}.old").is_dir()
    machines.running[first] = machines.start(first)
    eventually(lambda: log.read_text().count("ready to accept") == 2)
    eventually(lambda: machines.ask(first, is_standby) == "1")
    assert not Path(f"{data}.old").exists()
