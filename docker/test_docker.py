"""The files of docker/ agree with each other, with scripts/setup and with the server."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

DOCKER = Path(__file__).resolve().parent
REPOSITORY = DOCKER.parent
sys.path.insert(0, str(REPOSITORY / "client" / "python" / "tests"))

from conftest import Server, binary, environment  # noqa: E402

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


def test_each_alert_says_what_it_means() -> None:
    rules = yaml.safe_load((DOCKER / "alerts.yaml").read_text())["groups"][0]["rules"]
    names = [rule["alert"] for rule in rules]
    assert len(names) == len(set(names)) >= 6
    for rule in rules:
        assert rule["labels"]["severity"] in {"warning", "critical"}
        assert {"summary", "description"} == rule["annotations"].keys()
