"""Writes all pages into docs/guide/src/reference: `python -m reference`, in docs/."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from . import command_line, contract, errors, metrics, python_client, rest, settings
from .text import PAGES, REPOSITORY


def pages(binary: Callable[[str], Path]) -> dict[str, Callable[[], str]]:
    """Each page by the name of its file. `binary` says where programs are."""
    return {
        "command-line.md": partial(command_line.make, binary),
        "settings.md": partial(settings.make, binary),
        "metrics.md": metrics.make,
        "rest.md": rest.routes,
        "rest-types.md": rest.types,
        "grpc.md": contract.calls,
        "messages.md": contract.messages,
        "python.md": python_client.make,
        "errors.md": errors.make,
    }


def main() -> None:
    """Writes them."""
    target = Path(os.environ.get("CARGO_TARGET_DIR") or REPOSITORY / "target")
    binaries = Path(os.environ.get("WAYPOST_BINARIES") or target / "release")
    for program in command_line.PROGRAMS:
        if not (binaries / program).is_file():
            sys.exit(
                f"{binaries / program} is missing: run `make build`, or say in WAYPOST_BINARIES where it is"
            )
    PAGES.mkdir(exist_ok=True)
    for name, make in pages(lambda program: binaries / program).items():
        (PAGES / name).write_text(make())


if __name__ == "__main__":
    main()
