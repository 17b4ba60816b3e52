"""The files of docker/ agree with each other, with scripts/setup and with the server."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

import waypost

DOCKER = Path(__file__).resolve().parent
REPOSITORY = DOCKER.parent
sys.path.insert(0, str(REPOSITORY / "client" / "python" / "tests"))

from conftest import Server, binary, environment, eventually  # noqa: E402

Instruction = tuple[str, str]

#: What makes the image.
BUILD_IMAGE = (REPOSITORY / "scripts" / "build-image").read_text()


def instructions() -> list[Instruction]:
    """Of the Dockerfile, with continued lines joined and comments gone."""
    lines = [line for line in (DOCKER / "Dockerfile").read_text().splitlines() if not line.startswith("#")]
    joined = re.sub(r"\\\n", " ", "\n".join(lines))
    split = (line.split(maxsplit=1) for line in joined.splitlines() if line.strip())
    return [(name, " ".join(arguments.split())) for name, arguments in split]


def arguments(of: str) -> list[str]:
    return [arguments for name, arguments in instructions() if name == of]


def settings() -> dict[str, str]:
    pairs = (pair.split("=", 1) for line in arguments("ENV") for pair in line.split())
    return {name: value for name, value in pairs}  # noqa: C416


def compose() -> dict[str, Any]:
    return yaml.safe_load((DOCKER / "compose.yaml").read_text())


def test_the_image_is_made_of_what_build_image_brings() -> None:
    assert arguments("FROM") == ["scratch"]
    [added] = arguments("ADD")
    assert f'>"$work/context/{added.split()[0]}"' in BUILD_IMAGE
    # Nothing runs while it is built, and nothing comes from elsewhere.
    assert {name for name, _ in instructions()}.isdisjoint({"RUN", "COPY"})


def test_user_volume_ports_and_signal() -> None:
    env = settings()
    [volume] = arguments("VOLUME")
    assert volume == env["WAYPOST_DATA_DIR"] == "/var/lib/waypost"
    [user] = arguments("USER")
    uid, gid = user.split(":")
    assert f"waypost:x:{uid}:{gid}:" in BUILD_IMAGE
    assert f"waypost:x:{gid}:" in BUILD_IMAGE
    assert f'chown {user} "$work/ours{volume}"' in BUILD_IMAGE
    assert int(uid) > 0
    assert arguments("STOPSIGNAL") == ["SIGTERM"]
    assert arguments("CMD") == ['["waypost-server"]']
    assert 'CMD ["health-check"]' in arguments("HEALTHCHECK")[0]
    # The server's own ports, and every address of the container.
    helped = subprocess.run(
        [binary("waypost-server"), "--help"], env=environment(), stdout=subprocess.PIPE, text=True, check=True
    )
    ports = re.findall(r"\[default: 127\.0\.0\.1:(\d+)\]", helped.stdout)
    assert len(ports) == 2
    [exposed] = arguments("EXPOSE")
    assert exposed.split() == ports
    assert [env["WAYPOST_GRPC_ADDRESS"], env["WAYPOST_HTTP_ADDRESS"]] == [f"0.0.0.0:{port}" for port in ports]


def test_compose_runs_the_image() -> None:
    service = compose()["services"]["waypost"]
    assert f"docker-archive:$work/image.tar:{service['image']}:latest" in BUILD_IMAGE
    [exposed] = arguments("EXPOSE")
    assert service["ports"] == [f"127.0.0.1:{port}:{port}" for port in exposed.split()]
    [volume] = arguments("VOLUME")
    assert service["volumes"] == [f"data:{volume}"]
    assert "data" in compose()["volumes"]
    assert service["restart"] == "unless-stopped"
    # The setting that the comment tells of is one that the file is valid with.
    text = (DOCKER / "compose.yaml").read_text()
    told = text.replace("    # environment:\n    #   WAYPOST", "    environment:\n      WAYPOST")
    assert yaml.safe_load(told)["services"]["waypost"]["environment"] == {"WAYPOST_ALLOW_ANONYMOUS": "true"}


def one_line() -> str:
    """The command that starts a server, as `scripts/test-image` takes it."""
    [line] = re.findall(r"^docker run --detach .+$", (DOCKER / "README.md").read_text(), re.MULTILINE)
    return line


def test_the_one_line_is_as_confined_as_compose() -> None:
    service = compose()["services"]["waypost"]
    assert service["read_only"]
    assert " --read-only " in one_line()
    assert service["cap_drop"] == ["ALL"]
    assert " --cap-drop ALL " in one_line()
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert " --security-opt no-new-privileges " in one_line()
    assert re.findall(r"--publish (\S+)", one_line()) == service["ports"]
    [volume] = arguments("VOLUME")
    assert f" --volume waypost:{volume} " in one_line()
    assert one_line() in (REPOSITORY / "README.md").read_text()


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    server = Server(tmp_path / "data")
    server.start()
    yield server
    server.kill()


def health(http_address: str, **further: str) -> subprocess.CompletedProcess[str]:
    env = {**environment(), "WAYPOST_HTTP_ADDRESS": http_address, **further}
    return subprocess.run([DOCKER / "health-check"], env=env, stderr=subprocess.PIPE, text=True, timeout=10)


def test_the_health_check_tells_a_living_server_from_a_dead_one(server: Server) -> None:
    port = server.http_address.rpartition(":")[2]
    # As in the image: the server's address, of which the port counts.
    assert health(f"0.0.0.0:{port}").returncode == 0
    assert health(f"0.0.0.0:{port}", WAYPOST_TLS_CERTIFICATE="server.crt").returncode == 0
    server.kill()
    assert health(f"0.0.0.0:{port}").returncode != 0


@pytest.mark.parametrize("answer", [b"HTTP/1.1 503 Service Unavailable\r\n\r\n", b""])
def test_a_server_that_is_not_well_is_told(answer: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        env = {**environment(), "WAYPOST_HTTP_ADDRESS": f"0.0.0.0:{port}"}
        check = subprocess.Popen([DOCKER / "health-check"], env=env, stderr=subprocess.PIPE)
        connection, _ = listener.accept()
        with connection:
            asked = connection.recv(1000)
            connection.sendall(answer)
        assert asked.startswith(b"GET /healthz HTTP/1.1\r\n")
        check.communicate(timeout=10)
        assert check.returncode == 1


#: What Prometheus itself adds to a metric, and the label of buckets.
PROMETHEUS_LABELS = {"instance", "job", "le"}


def expressions() -> list[str]:
    """Every question that the board and the alerts ask of Prometheus."""
    board = json.loads((DOCKER / "grafana-board.json").read_text())
    rules = yaml.safe_load((DOCKER / "alerts.yaml").read_text())
    asked = [target["expr"] for panel in board["panels"] for target in panel["targets"]]
    asked += [rule["expr"] for group in rules["groups"] for rule in group["rules"]]
    assert len(asked) >= 15
    return asked


def test_the_board_and_the_alerts_ask_for_metrics_that_there_are() -> None:
    source = (REPOSITORY / "server" / "src" / "metrics.rs").read_text()
    known = set(re.findall(r'const [A-Z_]+: &str = "(waypost_\w+)"', source))
    labels = set(re.findall(r'"(\w+)" => ', source)) | PROMETHEUS_LABELS
    histograms = set(re.findall(r"describe_histogram!\(\s*(\w+)", source))
    of_histograms = set(re.findall(rf'const (?:{"|".join(histograms)}): &str = "(waypost_\w+)"', source))
    assert len(known) >= 12
    assert len(of_histograms) >= 4
    sums = {f"{name}_{part}" for name in of_histograms for part in ("bucket", "sum", "count")}
    asked = set()
    for expression in expressions():
        asked |= set(re.findall(r"waypost_\w+", expression))
        used = set(re.findall(r"(\w+) *(?:=~|!~|!=|=)", re.sub(r"[=<>]= ", "", expression)))
        for grouped in re.findall(r"by \(([^)]*)\)", expression):
            used |= {label.strip() for label in grouped.split(",")}
        assert used <= labels, f"{used - labels} of {expression}"
    assert asked <= (known - of_histograms) | sums, asked - known - sums
    # What the server counts, somebody sees.
    shown = {re.sub(r"_(bucket|sum|count)$", "", name) for name in asked}
    assert known - shown <= {"waypost_build_info"}, known - shown


def server_settings() -> set[str]:
    source = (REPOSITORY / "server" / "src" / "config" / "keys.rs").read_text()
    return set(re.findall(r'\("(\w+)", "', source))


def fleet() -> dict[str, Any]:
    return yaml.safe_load((DOCKER / "fleet.yaml").read_text())


def test_the_fleet_is_of_the_same_image_and_settings() -> None:
    services = fleet()["services"]
    servers = [service for name, service in services.items() if name.startswith("waypost-")]
    machines = [service for name, service in services.items() if name.startswith("db-")]
    assert (len(servers), len(machines)) == (3, 3)
    single = compose()["services"]["waypost"]
    [volume] = arguments("VOLUME")
    published = []
    for name, service in services.items():
        assert service["restart"] == "unless-stopped"
        assert {mount.split(":")[0] for mount in service["volumes"]} <= fleet()["volumes"].keys() | {
            "./postgres-machine"
        }
        if service in machines:
            assert service["environment"]["MACHINE"] == name
            assert service["environment"]["MACHINES"].split() == ["db-1", "db-2", "db-3"]
            continue
        for confined in ("image", "read_only", "cap_drop", "security_opt", "stop_grace_period"):
            assert service[confined] == single[confined]
        assert service["environment"]["WAYPOST_ADVERTISED_HOST"] == name
        assert {
            variable.removeprefix("WAYPOST_").lower() for variable in service["environment"]
        } <= server_settings()
        assert service["environment"]["WAYPOST_STORAGE"].endswith("@db-1,db-2,db-3/maps")
        assert service["volumes"][0].endswith(f":{volume}")
        published += service["ports"]
    assert len(set(published)) == 6
    assert all(port.startswith("127.0.0.1:") for port in published)


def test_the_manifests_are_of_the_same_image_and_settings() -> None:
    documents = list(yaml.safe_load_all((DOCKER / "kubernetes.yaml").read_text()))
    deployment, service, budget = documents
    assert [document["kind"] for document in documents] == ["Deployment", "Service", "PodDisruptionBudget"]
    labels = deployment["spec"]["template"]["metadata"]["labels"]
    for selector in (
        deployment["spec"]["selector"]["matchLabels"],
        service["spec"]["selector"],
        budget["spec"]["selector"]["matchLabels"],
    ):
        assert selector == labels
    pod = deployment["spec"]["template"]["spec"]
    [container] = pod["containers"]
    [user] = arguments("USER")
    security = pod["securityContext"]
    assert [security["runAsUser"], security["runAsGroup"], security["fsGroup"]] == [
        int(user[:4]),
        int(user[5:]),
        7600,
    ]
    assert container["securityContext"]["readOnlyRootFilesystem"]
    assert {
        variable["name"].removeprefix("WAYPOST_").lower() for variable in container["env"]
    } <= server_settings()
    [exposed] = arguments("EXPOSE")
    assert [str(port["containerPort"]) for port in container["ports"]] == exposed.split()
    assert [str(port["port"]) for port in service["spec"]["ports"]] == exposed.split()
    [volume] = arguments("VOLUME")
    assert container["volumeMounts"] == [{"name": "scratch", "mountPath": volume}]


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
            machines.running[first].kill()
            machines.running[first].wait()
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


def test_each_alert_says_what_it_means() -> None:
    rules = yaml.safe_load((DOCKER / "alerts.yaml").read_text())["groups"][0]["rules"]
    names = [rule["alert"] for rule in rules]
    assert len(names) == len(set(names)) >= 6
    for rule in rules:
        assert rule["labels"]["severity"] in {"warning", "critical"}
        assert {"summary", "description"} == rule["annotations"].keys()
