"""Runs a benchmark, and prints its medians as JSON: `python docs/benches.py relaxation`.

Each benchmark has a name, and a median in milliseconds for each of its groups, by their names.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", REPOSITORY / "target"))


def benchmarks(reports: Path) -> list[dict[str, object]]:
    """What criterion has left in this folder."""
    figures: dict[str, list[float]] = {}
    for estimates in sorted(reports.glob("*/*/new/estimates.json")):
        described = json.loads((estimates.parent / "benchmark.json").read_text())
        median_ns = json.loads(estimates.read_text())["median"]["point_estimate"]
        figures.setdefault(described["function_id"], []).append(median_ns / 1e6)
    return [{"name": name, "median_ms": by_group} for name, by_group in figures.items()]


def main() -> None:
    """Runs it, and reads what it left."""
    bench, *_json = sys.argv[1:]
    # Beside those of other benchmarks its own could not be told.
    reports = TARGET / "criterion-of" / bench
    subprocess.run(
        # Of the workspace, whose dependencies have the features that they were built with.
        ["cargo", "bench", "--locked", "--workspace", "--bench", bench],
        check=True,
        cwd=REPOSITORY,
        stdout=sys.stderr,
        env=os.environ | {"CRITERION_HOME": str(reports)},
    )
    print(json.dumps({"benchmarks": benchmarks(reports)}))


if __name__ == "__main__":
    main()
