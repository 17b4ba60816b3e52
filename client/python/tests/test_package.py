"""What is installed, and what its README promises."""

from __future__ import annotations

import doctest
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from conftest import IMAGES, REPOSITORY, Server

import waypost
import waypost.client
import waypost.goals
import waypost.poses
import waypost.sender

PACKAGE = REPOSITORY / "client" / "python"


def test_a_wheel_holds_the_contract_and_its_types(tmp_path: Path) -> None:
    """Built from a copy without anything generated, with what this environment has."""
    copy = copied(tmp_path)
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
    ]
    subprocess.run([*command, "--wheel-dir", str(tmp_path), str(copy)], check=True)
    [wheel] = tmp_path.glob("waypost-*.whl")
    with zipfile.ZipFile(wheel) as files:
        names = set(files.namelist())
    contract = list((REPOSITORY / "proto" / "waypost" / "v1").glob("*.proto"))
    assert len(contract) >= 5
    for file in contract:
        stubs = ["_pb2_grpc.py"] if "\nservice " in file.read_text() else []
        for end in ("_pb2.py", "_pb2.pyi", *stubs):
            assert f"waypost/v1/{file.stem}{end}" in names
    assert {"waypost/__init__.py", "waypost/py.typed", "waypost/session.py"} <= names
    assert not [name for name in names if name.startswith(("google/", "tests/"))]


def test_nothing_generated_is_kept_in_the_repository() -> None:
    if not (REPOSITORY / ".git").exists() or shutil.which("git") is None:
        pytest.skip("this is no checkout, or there is no git to ask")
    command = ["git", "ls-files", "src"]
    kept = subprocess.run(command, cwd=PACKAGE, stdout=subprocess.PIPE, text=True, check=True)
    files = kept.stdout.split()
    assert "src/waypost/session.py" in files
    assert not [file for file in files if "v1/" in file]


def test_the_version_is_that_of_the_server() -> None:
    cargo = (REPOSITORY / "Cargo.toml").read_text()
    python = (PACKAGE / "pyproject.toml").read_text()
    of_cargo, of_python = (re.search(r'^version = "(.+)"', text, re.MULTILINE) for text in (cargo, python))
    assert of_cargo
    assert of_python
    assert of_cargo[1] == of_python[1]


def test_a_source_distribution_installs_and_imports(server: Server, tmp_path: Path) -> None:
    """In an environment of its own that has nothing but what the package depends on."""
    copy = copied(tmp_path)
    build = "import sys; from setuptools import build_meta; build_meta.build_sdist(sys.argv[1])"
    subprocess.run(
        [sys.executable, "-c", build, str(tmp_path)], cwd=copy, check=True, stdout=subprocess.DEVNULL
    )
    [sdist] = tmp_path.glob("waypost-*.tar.gz")
    fresh = tmp_path / "fresh"
    venv.create(fresh, with_pip=False)
    python = fresh / "bin" / "python"
    # What it depends on is that of this environment: editable installs are not followed from there.
    purelib = "import sysconfig; print(sysconfig.get_path('purelib'))"
    own = subprocess.run(
        [python, "-c", purelib], stdout=subprocess.PIPE, text=True, check=True
    ).stdout.strip()
    (Path(own) / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    install = ["-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--no-build-isolation"]
    subprocess.run([python, *install, "--ignore-installed", sdist], check=True, cwd=tmp_path)
    used = f"import waypost; print(waypost.__file__, len(waypost.connect({server.address!r}).models()))"
    shown = subprocess.run([python, "-c", used], stdout=subprocess.PIPE, text=True, check=True, cwd=tmp_path)
    assert shown.stdout.split() == [f"{own}/waypost/__init__.py", "1"]


def copied(folder: Path) -> Path:
    """The package with its contract, without anything generated."""
    copy = folder / "client" / "python"
    shutil.copytree(
        PACKAGE, copy, ignore=shutil.ignore_patterns("v1", "*.egg-info", "__pycache__", ".*_cache")
    )
    shutil.copytree(REPOSITORY / "proto" / "waypost", folder / "proto" / "waypost")
    shutil.copytree(REPOSITORY / "proto" / "google", folder / "proto" / "google")
    return copy


def test_the_readme_runs_as_it_stands(client: waypost.Client, server: Server, tmp_path: Path) -> None:
    examples = re.findall(r"```python\n(.+?)```", (PACKAGE / "README.md").read_text(), re.DOTALL)
    assert len(examples) == 4
    assert all("127.0.0.1:7600" in example for example in examples)
    # The first one is what a newcomer reads.
    assert len([line for line in examples[0].splitlines() if line.strip()]) <= 20
    images = tmp_path / "drive" / "images"
    images.mkdir(parents=True)
    # So near to each other that the way back closes a loop.
    for number, image in enumerate([*IMAGES[:40], *IMAGES[99:120]]):
        shutil.copy(image, images / f"{number:03}.jpg")
    client.create_map("hall", "shipped")

    def shown(example: str) -> str:
        command = [sys.executable, "-c", example.replace("127.0.0.1:7600", server.address)]
        return subprocess.run(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True, check=True).stdout

    streamed, called_back, asynchronous, kept = examples
    told = shown(streamed)
    closures = client.map("hall").loop_closures
    assert closures >= 1
    seen = re.findall(r"^frame \d+ is at place \d+, seen in FrameReference\(", told, re.MULTILINE)
    assert len(seen) == closures
    # Run again, it goes on after the last frame: there is nothing left to do.
    assert (shown(streamed), client.map("hall").frames) == ("", 61)
    assert shown(called_back).splitlines()[-1].startswith("61 ")
    assert client.map("hall").frames == 122
    assert "61 " in shown(asynchronous).splitlines()[-1]
    explained = shown(kept)
    assert "\nprobability - " in explained
    assert explained.splitlines()[-1] == "maps/copy"
    assert client.map("copy").frames == client.map("hall").frames


def test_the_examples_in_docstrings_run(
    client: waypost.Client, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WAYPOST_SERVER", server.address)
    given = {"client": client, "image": IMAGES[0].read_bytes(), "waypost": waypost}
    ran = {}
    for module in (waypost, waypost.client, waypost.goals, waypost.poses, waypost.sender):
        results = doctest.testmod(module, extraglobs=given)
        assert results.failed == 0, module
        ran[module.__name__] = results.attempted
    assert all(ran.values()), ran


@pytest.mark.parametrize("tool", [["ruff", "check"], ["ruff", "format", "--check"], ["mypy"]])
def test_the_package_is_clean(tool: list[str]) -> None:
    checked = subprocess.run(
        [sys.executable, "-m", *tool],
        cwd=PACKAGE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert checked.returncode == 0, checked.stdout
