"""README and the guide do what they say: each command is run, each link leads somewhere, sentences are short.

A page's blocks marked `sh` and `python` run in order, in one shell, in a folder with what `recordings` makes.
A `text` block holds lines of what the block above it prints, in order; `…` stands for anything. A block
that cannot run says why (`sh needs=docker`), and `CANNOT_RUN` counts those.
"""

from __future__ import annotations

import contextlib
import gzip
import json
import os
import random
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path
from textwrap import dedent
from urllib.request import urlopen

import pytest
from PIL import Image

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent
GUIDE = DOCS / "guide" / "src"
sys.path[:0] = [str(REPOSITORY / "client" / "python" / "tests"), str(DOCS)]

from conftest import IMAGES, MODEL, Server, binary, environment  # noqa: E402
from rtabmap_file import rtabmap  # noqa: E402
from test_bags import mcap  # noqa: E402

import waypost  # noqa: E402

PAGES = [REPOSITORY / "README.md", *sorted(GUIDE.glob("*.md"))]
#: What else is held to short sentences.
SHORT = [
    *PAGES,
    *(page for page in sorted(REPOSITORY.glob("*.md")) if page.name != "README.md"),
    *sorted((DOCS / "adr").glob("*.md")),
    *sorted(REPOSITORY.glob("*/README.md")),
    *sorted(REPOSITORY.glob("client/*/README.md")),
]
#: Every page of the repository, for its links.
LINKING = sorted(
    {*REPOSITORY.glob("*.md"), *DOCS.rglob("*.md"), *REPOSITORY.glob("client/**/README.md")}
    | {REPOSITORY / "docker" / "README.md"}
)
#: Reasons for which blocks do not run, and how many there are: a new one is a line here.
CANNOT_RUN = Counter(
    {"build": 9, "checkerboard": 1, "damage": 1, "docker": 2, "packages": 2, "robot": 12, "terminal": 1}
)
#: Methods of the Python client that are of the connection itself.
NOT_CALLS = {"address", "channel", "close", "greet"}
LANGUAGES = {"sh", "python", "text", "toml", "yaml", "cpp", "cmake"}
MOST_WORDS_IN_A_SENTENCE = 25
PATIENCE_S = 300

FENCE = re.compile(r"^ *```(\S*)([^\n]*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
ADDRESS = re.compile(r"\b(127\.0\.0\.1|0\.0\.0\.0):(76\d\d)\b")


@dataclass
class Block:
    """What a page tells one to run, and what it says that comes out."""

    line: int
    language: str
    code: str
    printed: list[str] = field(default_factory=list)


def fences(page: Path) -> Iterator[tuple[int, str, str, str]]:
    """Line, language, the rest of the info string, and content of each."""
    text = page.read_text()
    for fence in FENCE.finditer(text):
        yield text.count("\n", 0, fence.start()) + 1, fence[1], fence[2].strip(), dedent(fence[3])


def blocks(page: Path) -> list[Block]:
    """Those of a page that run."""
    found: list[Block] = []
    runs = False
    for line, language, info, content in fences(page):
        assert language in LANGUAGES, f"{page.name}:{line}: a fence is one of {sorted(LANGUAGES)}"
        if language in {"sh", "python"}:
            assert not info or re.fullmatch(r"needs=[a-z-]+", info), f"{page.name}:{line}: {info}"
            runs = not info
            if runs:
                found.append(Block(line, language, content))
        elif language == "text" and runs:
            found[-1].printed += [text.strip() for text in content.splitlines() if text.strip(" …")]
    return found


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the pages take for granted: `drive` in four forms, `photos`, `panoramas` and `demo`.

    `drive` is a simulated robot's: images, odometry and the camera's calibration. `drive.mcap`, `drive.mp4`
    and `rtabmap.db` are other forms of a drive, and `orb.yml.gz` is a vocabulary of DBoW2. `photos` are images of the
    demo, which come back to where they began, and `panoramas` the same, cut to the shape of panoramas.
    """
    folder = tmp_path_factory.mktemp("recordings")
    (folder / "demo").symlink_to(REPOSITORY / "demo")
    mcap(folder / "drive", "NONE")
    for name in ("photos", "panoramas"):
        (folder / name).mkdir()
    for image in [*IMAGES[:20], *IMAGES[99:110]]:
        shutil.copy(image, folder / "photos")
        with Image.open(image) as photo:
            width, height = photo.size
            photo.crop((0, 0, width, min(height, width // 2))).save(folder / "panoramas" / image.name)
    server = Server(folder / "data")
    server.start()
    try:
        record(server, folder / "drive")
    finally:
        server.terminate()
    shutil.rmtree(folder / "data")
    film(folder / "drive" / "images", folder / "drive.mp4")
    rtabmap(folder / "drive", folder / "rtabmap.db")
    (folder / "orb.yml.gz").write_bytes(gzip.compress(orb_vocabulary().encode()))
    return folder


def orb_vocabulary() -> str:
    """Twenty words, as DBoW2 writes them."""
    head = "%YAML:1.0\nvocabulary:\n   k: 20\n   L: 1\n   scoringType: 0\n   weightingType: 0\n"
    chance = random.Random(1)
    nodes, words = "", ""
    for word in range(20):
        row = "".join(f"{byte} " for byte in chance.randbytes(32))
        nodes += f'      - {{ nodeId:{word + 1}, parentId:0, weight:1.,\n          descriptor:"{row}" }}\n'
        words += f"      - {{ wordId:{word}, nodeId:{word + 1} }}\n"
    return f"{head}   nodes:\n{nodes}   words:\n{words}"


def film(images: Path, video: Path) -> None:
    """The first images as a video."""
    ffmpeg = ["ffmpeg", "-nostdin", "-loglevel", "error", "-framerate", "4", "-i", images / "%06d.jpg"]
    subprocess.run([*ffmpeg, "-frames:v", "20", "-c:v", "mpeg4", "-q:v", "2", video], check=True)


def record(server: Server, drive: Path) -> None:
    """A simulated drive, as a folder that a robot could have recorded."""
    (drive / "images").mkdir(parents=True)
    with waypost.connect(server.address) as client:
        client.import_model(MODEL, "shipped")
        env = {**environment(), "WAYPOST_SERVER": f"http://{server.address}"}
        quiet = {"check": True, "env": env, "stdout": subprocess.DEVNULL}
        waypost_cli = binary("waypost")
        subprocess.run([waypost_cli, "map", "create", "r", "--model", "shipped", "--keep", "images"], **quiet)
        subprocess.run([waypost_cli, "simulate", "--map", "r", "--session", "s"], **quiet)
        odometry = ["--frame", "odom", "--out", drive / "odometry.tum"]
        subprocess.run([waypost_cli, "map", "trajectory", "r", "s", *odometry], **quiet)
    for number in range(1, len((drive / "odometry.tum").read_text().splitlines()) + 1):
        with urlopen(f"http://{server.http_address}/v1/maps/r/sessions/s/frames/{number}/image") as image:
            (drive / "images" / f"{number:06}.jpg").write_bytes(image.read())
    (drive / "camera.yaml").write_text(
        "image_width: 320\nimage_height: 240\ncamera_name: front\ndistortion_model: plumb_bob\n"
        "camera_matrix: {rows: 3, cols: 3, data: [251.15, 0, 160, 0, 251.15, 120, 0, 0, 1]}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
        "rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\n"
        "projection_matrix: {rows: 3, cols: 4, data: [251.15, 0, 160, 0, 0, 251.15, 120, 0, 0, 0, 1, 0]}\n"
    )


@pytest.fixture(scope="session")
def runs(
    recordings: Path, tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> Iterator[dict[str, Future[str]]]:
    """All pages that are asked for, two at a time. Each gives what is wrong with it, or nothing."""
    asked_for = {
        item.callspec.params["page"]
        for item in request.session.items
        if isinstance(item, pytest.Function) and item.originalname == "test_what_a_page_tells_one_to_run_runs"
    }
    with ThreadPoolExecutor(2) as pool:
        # The longest first, so that none is left to run alone.
        order = sorted(
            asked_for & set(PAGES), key=lambda page: -sum(len(block.code) for block in blocks(page))
        )
        yield {
            page.name: pool.submit(run, page, recordings, tmp_path_factory.mktemp(page.stem))
            for page in order
        }


def run(page: Path, recordings: Path, folder: Path) -> str:
    """Runs a page against a server of its own."""
    to_run = blocks(page)
    if not to_run or needs_postgres(page):
        return ""
    scratch = folder / "scratch"
    shutil.copytree(recordings, scratch, symlinks=True)
    server = Server(folder / "data")
    server.start()
    try:
        return wrong(page, to_run, outputs(to_run, server, scratch))
    finally:
        server.kill()


def needs_postgres(page: Path) -> bool:
    """Whether a page is about a database that does not run here."""
    return "PGHOST" not in os.environ and any("postgres:///" in block.code for block in blocks(page))


def outputs(to_run: list[Block], server: Server, scratch: Path) -> list[str]:
    """What each block printed, in one shell that ends where one fails."""
    ports = {"7600": server.address.rpartition(":")[2], "7601": server.http_address.rpartition(":")[2]}

    def address(found: re.Match[str]) -> str:
        return f"{found[1]}:{ports.setdefault(found[2], free_port())}"

    script = ["set -euo pipefail"]
    for number, block in enumerate(to_run):
        code = ADDRESS.sub(address, block.code)
        script.append(f"printf '\\036\\n'  # block {number}")
        script.append(f"python - <<'PYTHON'\n{code}PYTHON" if block.language == "python" else code)
    script.append("printf '\\036\\n'")
    path = os.pathsep.join(
        [str(binary("waypost").parent), str(Path(sys.executable).parent), os.environ["PATH"]]
    )
    env = {**environment(), "WAYPOST_SERVER": f"http://{server.address}", "PATH": path}
    with (scratch / ".output").open("wb") as output:
        shell = subprocess.Popen(
            ["bash", "-c", "\n".join(script)],
            cwd=scratch,
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,
        )
        with contextlib.suppress(subprocess.TimeoutExpired):
            shell.wait(PATIENCE_S)
        # Servers that the page started in the background are of the same group.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(shell.pid, signal.SIGKILL)
        shell.wait()
    return (scratch / ".output").read_text(errors="replace").split("\x1e\n")[1:]


def free_port() -> str:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return str(listener.getsockname()[1])


def wrong(page: Path, to_run: list[Block], printed: list[str]) -> str:
    """Which block failed, or did not print what the page says."""
    if len(printed) <= len(to_run):
        block = to_run[len(printed) - 1]
        return f"{page.name}:{block.line} failed:\n{printed[-1]}"
    for block, output in zip(to_run, printed):
        lines = iter(output.splitlines())
        for expected in block.printed:
            if not any(matches(expected, line) for line in lines):
                return f"{page.name}:{block.line} does not print `{expected}`:\n{output}"
    return ""


def matches(expected: str, line: str) -> bool:
    """Blanks are one blank, and `…` is anything."""
    parts = (re.escape(" ".join(part.split())) for part in expected.split("…"))
    return re.fullmatch(r"\s*.*\s*".join(parts), " ".join(line.split())) is not None


def test_a_page_that_does_not_hold_is_found() -> None:
    told = [Block(3, "sh", "waypost map ls", ["hall … 22"])]
    page = GUIDE / "concepts.md"
    assert wrong(page, told, ["MAP  PLACES\nhall     100  22\n", ""]) == ""
    assert "concepts.md:3 does not print `hall … 22`" in wrong(page, told, ["hall  100  21\n", ""])
    assert wrong(page, told, ["there is no server\n"]) == "concepts.md:3 failed:\nthere is no server\n"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_tells_one_to_run_runs(runs: dict[str, Future[str]], page: Path) -> None:
    if needs_postgres(page):
        pytest.skip("no PostgreSQL runs: scripts/with-postgres")
    if problem := runs[page.name].result():
        pytest.fail(problem, pytrace=False)


def test_what_cannot_run_is_counted() -> None:
    infos = [info for page in PAGES for _, language, info, _ in fences(page) if language in {"sh", "python"}]
    assert Counter(info.removeprefix("needs=") for info in infos if info) == CANNOT_RUN


def test_every_command_and_flag_exists() -> None:
    """In prose, in tables and in blocks that cannot run as well, and of those that figures are made with."""
    pages = [*PAGES, REPOSITORY / "ACCURACY.md", REPOSITORY / "PERFORMANCE.md"]
    said = {command for page in pages for command in commands(page)}
    assert len(said) > 100
    assert unknown("waypost map shwo hall")
    assert "['--nosuch']" in unknown("waypost map ls --nosuch")
    assert "['--nosuch']" in unknown("waypost-ros --map hall --nosuch")
    assert any(command.startswith("waypost-ros ") for command in said)
    with ThreadPoolExecutor(2) as pool:
        assert not sorted(filter(None, pool.map(unknown, said)))


def commands(page: Path) -> Iterator[str]:
    """Calls of our programs, without comments, pipes and redirections."""
    text = page.read_text()
    shell = "\n".join(code for _, language, _, code in fences(page) if language == "sh")
    inline = re.findall(r"`(waypost(?:-eval|-server|-ros)?(?: [^`\n]+)?)`", FENCE.sub("", text))
    for line in [*inline, *shell.replace("\\\n", " ").splitlines()]:
        found = re.search(r"\b(waypost(?:-eval|-server|-ros)? [^#|;>&<]+)", line)
        if found and re.match(r"(?:target/release/)?waypost", line):
            yield " ".join(found[1].split())


def unknown(command: str) -> str:
    """What is wrong with it, by the program's own help."""
    program, *words = command.split()
    names = list(takewhile(lambda word: re.fullmatch("[a-z][a-z-]*", word), words))
    shown = subprocess.run([binary(program), *names, "--help"], capture_output=True, text=True)
    flags = re.findall(r"(?<=\s)--[a-z][a-z0-9-]*", f" {command}")
    missing = [flag for flag in flags if not re.search(rf"{flag}\b(?!-)", shown.stdout)]
    return f"{command}: {missing or shown.stderr}" if missing or shown.returncode else ""


@pytest.mark.parametrize("page", LINKING, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"`[^`\n]+`", "", FENCE.sub("", page.read_text()))
    dead = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("https://", "http://")):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        if not file.exists() or (anchor and anchor not in anchors(file)):
            dead.append(target)
    assert not dead


def anchors(page: Path) -> set[str]:
    """As git hosts and mdBook make them of headings."""
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text()), re.MULTILINE)
    plain = (
        re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]+)\]\([^)]*\)", r"\1", heading)) for heading in headings
    )
    return {heading.strip().lower().replace(" ", "-") for heading in plain}


def test_the_guide_s_contents_name_each_page_once() -> None:
    named = re.findall(r"\]\((\S+\.md)\)", (GUIDE / "SUMMARY.md").read_text())
    pages = sorted(str(page.relative_to(GUIDE)) for page in GUIDE.rglob("*.md"))
    assert sorted([*named, "SUMMARY.md"]) == pages


def test_the_table_of_abilities_is_whole(tmp_path: Path) -> None:
    """Nothing is missing in it, and nothing is there that does not exist."""
    lines = [line.split("|") for line in (GUIDE / "abilities.md").read_text().splitlines() if line[:1] == "|"]
    told: list[set[str]] = [
        {
            name
            for cells in lines
            if cells[2].strip() != "gRPC"
            for name in re.findall("`([^`]+)`", cells[column])
        }
        for column in (2, 3, 4, 5)
    ]
    contract = "\n".join(file.read_text() for file in (REPOSITORY / "proto/waypost/v1").glob("*.proto"))
    services = re.findall(r"^service (\w+) \{(.*?)^\}", contract, re.MULTILINE | re.DOTALL)
    rpcs = {f"{service}.{rpc}" for service, body in services for rpc in re.findall(r"rpc (\w+)\(", body)}
    paths = json.loads((REPOSITORY / "server/openapi.json").read_text())["paths"]
    routes = {
        f"{method.upper()} {path.removeprefix('/v1')}"
        for path, methods in paths.items()
        for method in methods
    }
    subprocess.run([binary("waypost"), "man", tmp_path / "man"], check=True, stdout=subprocess.DEVNULL)
    manual = {page.stem for page in (tmp_path / "man").iterdir()}
    leaves = {page for page in manual if not any(other.startswith(f"{page}-") for other in manual)}
    groups = manual - leaves
    commands = {command_of(page, groups) for page in leaves}
    methods = {name for name in dir(waypost.Client) if name[0] != "_"} - NOT_CALLS
    assert told == [rpcs, routes, commands, methods]


def test_the_table_of_abilities_has_what_a_robot_of_ros_can_ask() -> None:
    """Names in its last column are in the bridge's sources, and each of the bridge's own is there."""
    lines = [line.split("|") for line in (GUIDE / "abilities.md").read_text().splitlines() if line[:1] == "|"]
    told = {name for cells in lines for name in re.findall("`([^`]+)`", cells[6])} - {"waypost-ros"}
    sources = "\n".join(file.read_text() for file in (REPOSITORY / "ros/src").rglob("*.rs"))
    assert not {name for name in told if f'"{name}"' not in sources and f"/{name}" not in sources}
    assert {name for name in told if name.startswith("waypost/")} == set(
        re.findall(r'"(waypost/[a-z_]+)"', sources)
    )


def command_of(page: str, groups: set[str]) -> str:
    """`map loop-closures` of `waypost-map-loop-closures`."""
    group = max((group for group in groups if page.startswith(f"{group}-")), key=len)
    above = group.removeprefix("waypost").removeprefix("-")
    return f"{above} {page[len(group) + 1 :]}".strip()


def test_the_readme_is_short() -> None:
    assert len((REPOSITORY / "README.md").read_text().split()) <= 700


@pytest.mark.parametrize("page", SHORT, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_sentences_are_short(page: Path) -> None:
    long = [sentence for sentence in sentences(page) if len(sentence.split()) > MOST_WORDS_IN_A_SENTENCE]
    assert not long


def sentences(page: Path) -> list[str]:
    """Of its prose and its tables' cells, without code."""
    # What a table is made by is no prose.
    text = re.sub(r"<!--.*?-->", "", page.read_text(), flags=re.DOTALL)
    text = re.sub(r"`[^`\n]+`", "code", FENCE.sub("\n\n", text))
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    paragraphs = re.split(r"\n\s*\n|\n(?=\s*(?:[-*|#]|\d+\.) ?)|\|", text)
    return [part for text in paragraphs for part in re.split(r"(?<=[.!?:])[*)]*\s", " ".join(text.split()))]
