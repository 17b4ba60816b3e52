"""What the packages bring is what the programs take."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

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
