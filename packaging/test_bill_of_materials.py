"""What a release says that it is made of: complete, and seen to be refused where something is missing."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

PROGRAM = Path(__file__).resolve().parent / "bill-of-materials"
DEPENDS = "adduser, libc6 (>= 2.36), libopencv-core406 (>= 4.6.0+dfsg)"


def ran(*arguments: str) -> subprocess.CompletedProcess[str]:
    """The program, as the release scripts run it."""
    return subprocess.run([PROGRAM, *arguments], capture_output=True, text=True, cwd=PROGRAM.parent.parent)


def checked(bill: object, folder: Path) -> subprocess.CompletedProcess[str]:
    """What it says of a list."""
    file = folder / "list.cdx.json"
    file.write_text(json.dumps(bill))
    return ran("check", str(file))


@pytest.fixture(scope="module")
def bill() -> Any:
    """The list of this source."""
    made = ran("list", "0.1.0", DEPENDS)
    assert made.returncode == 0, made.stderr
    return json.loads(made.stdout)


def test_crates_page_and_packages_are_listed_with_version_and_licence(bill: Any, tmp_path: Path) -> None:
    """All that is linked in, compiled in, embedded or needed."""
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.5")
    complete = checked(bill, tmp_path)
    assert complete.returncode == 0, complete.stderr
    by_name = {entry["name"]: entry for entry in bill["components"]}
    for name in ["axum", "tonic", "opencv", "preact", "uplot", "sqlite", "zstd", "libopencv-core406"]:
        assert name in by_name, name
    assert {one["value"] for one in by_name["axum"]["properties"]} >= {"waypost-server"}
    assert len(by_name["axum"]["hashes"][0]["content"]) == 64
    assert len(by_name["preact"]["hashes"][0]["content"]) == 128
    # Tests and what builds are in no release.
    assert not {"proptest", "esbuild", "serde_derive"} & by_name.keys()


@pytest.mark.parametrize("name", ["tokio", "rustls", "uplot", "sqlite"])
def test_what_is_missing_is_told(bill: Any, tmp_path: Path, name: str) -> None:
    """One thing less."""
    entries = [entry for entry in bill["components"] if entry["name"] != name]
    assert len(entries) < len(bill["components"])
    refused = checked({**bill, "components": entries}, tmp_path)
    assert refused.returncode == 1
    assert name in refused.stderr and "is not listed" in refused.stderr


@pytest.mark.parametrize(("field", "said"), [("version", "no version"), ("licenses", "no licence")])
def test_a_crate_without_version_or_licence_is_told(bill: Any, tmp_path: Path, field: str, said: str) -> None:
    """The name alone is not enough."""
    without = {key: value for key, value in bill["components"][0].items() if key != field}
    refused = checked({**bill, "components": [without, *bill["components"][1:]]}, tmp_path)
    assert refused.returncode == 1
    assert said in refused.stderr and without["name"] in refused.stderr


def test_what_is_no_list_is_refused(tmp_path: Path) -> None:
    """Half a file."""
    file = tmp_path / "half"
    file.write_text('{"components": [')
    assert ran("check", str(file)).returncode != 0
