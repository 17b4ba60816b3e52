"""What is installed, and what its README promises."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from conftest import IMAGES, REPOSITORY, Server

import waypost

PACKAGE = REPOSITORY / "client" / "python"


def test_a_wheel_holds_the_contract_and_its_types(tmp_path: Path) -> None:
    """Built from a copy without anything generated, with what this environment has."""
    copy = tmp_path / "client" / "python"
    shutil.copytree(
        PACKAGE, copy, ignore=shutil.ignore_patterns("v1", "*.egg-info", "__pycache__", ".*_cache")
    )
    shutil.copytree(REPOSITORY / "proto" / "waypost", tmp_path / "proto" / "waypost")
    shutil.copytree(REPOSITORY / "proto" / "google", tmp_path / "proto" / "google")
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
    contract = [file.stem for file in (REPOSITORY / "proto" / "waypost" / "v1").glob("*.proto")]
    assert len(contract) >= 5
    for name in contract:
        for end in ("_pb2.py", "_pb2.pyi", "_pb2_grpc.py"):
            assert f"waypost/v1/{name}{end}" in names
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


def test_the_readme_runs_and_fits_in_twenty_lines(
    client: waypost.Client, server: Server, tmp_path: Path
) -> None:
    example = re.search(r"```python\n(.+?)```", (PACKAGE / "README.md").read_text(), re.DOTALL)
    assert example
    statements = [line for line in example[1].splitlines() if line.strip()]
    assert len(statements) <= 20
    assert "127.0.0.1:7600" in example[1]
    images = tmp_path / "drive" / "images"
    images.mkdir(parents=True)
    # So near to each other that the way back closes a loop.
    for number, image in enumerate([*IMAGES[:40], *IMAGES[99:120]]):
        shutil.copy(image, images / f"{number:03}.jpg")
    client.create_map("hall", "shipped")
    command = [sys.executable, "-c", example[1].replace("127.0.0.1:7600", server.address)]
    shown = subprocess.run(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True, check=True).stdout
    closures = client.map("hall").loop_closures
    assert closures >= 1
    assert (
        len(re.findall(r"^frame \d+ is at place \d+, seen in FrameReference\(", shown, re.MULTILINE))
        == closures
    )
    # Run again, it goes on after the last frame: there is nothing left to do.
    shown = subprocess.run(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True, check=True).stdout
    assert (shown, client.map("hall").frames) == ("", 61)


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
