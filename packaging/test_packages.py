"""What the packages bring is what the programs take."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
BINARIES = Path(os.environ.get("WAYPOST_BINARIES", HERE.parent / "target/release"))


def test_every_line_of_the_bridges_parameters_is_one_that_it_takes(tmp_path: Path) -> None:
    whole = (HERE / "robot1.toml").read_text()
    every = re.sub(r"^#([a-z_]+ = )", r"\1", whole, flags=re.MULTILINE)
    assert every.count("\n") == whole.count("\n")
    assert len(re.findall(r"^[a-z_]+ = ", every, flags=re.MULTILINE)) > 8
    parameters = tmp_path / "robot1.toml"
    # One thing is wrong: it is the one that is refused, and all else was read before.
    parameters.write_text(every.replace('namespace = "robot1"', 'namespace = "9 lives"'))
    ended = subprocess.run(
        [BINARIES / "waypost-ros", "--params", parameters],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert ended.returncode == 2, ended.stderr
    assert "9 lives" in ended.stderr


@pytest.mark.parametrize("alone", [False, True])
def test_every_link_in_what_is_installed_leads_somewhere(tmp_path: Path, alone: bool) -> None:
    subprocess.run(
        [sys.executable, HERE / "documents.py", tmp_path, *(["--alone"] if alone else [])], check=True
    )
    pages = list(tmp_path.rglob("*.md"))
    links = [
        (page, target)
        for page in pages
        for target in re.findall(r"\]\(([^)\s#]+)[^)\s]*\)", page.read_text())
        if "://" not in target
    ]
    assert (len(pages), links) == (1, []) if alone else len(links) > 300
    assert [(page, target) for page, target in links if not (page.parent / target).exists()] == []
    # Nobody has built anything.
    said = (tmp_path / "README.md").read_text()
    assert "make serve" not in said and "target/release" not in said and "are published yet" not in said
    assert alone or "target/release" not in (tmp_path / "guide/ros2.md").read_text()
