"""Lays out README and guide as packages bring them: documents.py FOLDER [--alone]

Pages lie where their links lead: the guide in guide/, whatever README, guide and these pages refer to beside it. What is not
brought is no link there, and who has packages builds nothing. With --alone it is README by itself.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

REPOSITORY = Path(__file__).resolve().parent.parent

#: What else is brought where a page refers to it: figures, pictures, examples, the contract.
BROUGHT = re.compile(
    r"(docs/guide/src/.*|(ACCURACY|PERFORMANCE|RELIABILITY|SECURITY|THIRD-PARTY|CHANGELOG)\.md|docs/[\w-]+\.(svg|png|jpg)"
    r"|docker/[\w-]+\.(md|yaml)|client/(\w+/)?README\.md|client/\w+/examples/\w+\.\w+|proto/.*\.proto|demo/pictures/.*)"
)

#: What only who builds does, and what others do.
INSTALLED = [
    ("`scripts/release` makes packages, a container image and a Python wheel; none are published yet.\n", ""),
    ("`make serve` keeps a server: robots", "The service `waypost-server` keeps a server: robots"),
    (
        " With `target/release` in your `PATH`\n(",
        " `ln -s /usr/share/waypost/demo demo`\nmakes `demo` what is used here (",
    ),
    ("pip install client/python`", "pip install waypost-*.whl`"),
    ("From source it is in `target/release`:", "Is it there?"),
    ("target/release/waypost-ros", "waypost-ros"),
]

LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]+)\)")


def of_repository(page: PurePosixPath, target: str) -> PurePosixPath | None:
    """The file that a page's link leads to; none if it leads elsewhere."""
    path = target.split("#")[0]
    if "://" in path or path.startswith("mailto:"):
        return None
    parts: list[str] = []
    for part in (page.parent / path).parts if path else page.parts:
        if part == "..":
            parts.pop()
        else:
            parts.append(part)
    return PurePosixPath(*parts)


def installed(path: PurePosixPath) -> PurePosixPath:
    """Where a file of the repository lies in the package."""
    return PurePosixPath(re.sub(r"^docs/guide/src/", "guide/", str(path)))


def is_brought(path: PurePosixPath) -> bool:
    """Whether packages have the file."""
    return path.name == "README.md" and path.parent == PurePosixPath() or bool(BROUGHT.fullmatch(str(path)))


def rewritten(page: PurePosixPath, text: str, *, alone: bool) -> str:
    """A page as packages have it."""

    def link(found: re.Match[str]) -> str:
        path = of_repository(page, found["target"])
        if path is None:
            return found[0]
        if alone or not (is_brought(path) and (REPOSITORY / path).is_file()):
            return "" if found["picture"] else found["text"]
        here, there = installed(page).parent.parts, installed(path)
        up = len(here) - next(
            (at for at, part in enumerate(here) if there.parts[at : at + 1] != (part,)), len(here)
        )
        target = PurePosixPath(*[".."] * up, *there.parts[len(here) - up :])
        anchor = found["target"].partition("#")[1:]
        return f"{found['picture']}[{found['text']}]({target}{''.join(anchor)})"

    for built, used in INSTALLED:
        text = text.replace(built, used)
    return LINK.sub(link, text)


def reached(first: list[PurePosixPath]) -> Iterator[tuple[PurePosixPath, str | None]]:
    """All that is brought, pages with their text."""
    waiting, known = list(first), set(first)
    while waiting:
        path = waiting.pop()
        text = (REPOSITORY / path).read_text() if path.suffix == ".md" else None
        yield path, text
        for found in LINK.finditer(text or ""):
            linked = of_repository(path, found["target"])
            if linked and linked not in known and is_brought(linked) and (REPOSITORY / linked).is_file():
                known.add(linked)
                waiting.append(linked)


def main() -> None:
    """Writes them."""
    folder, alone = Path(sys.argv[1]), "--alone" in sys.argv[2:]
    tracked = subprocess.run(
        ["git", "ls-files", "docs/guide/src"], cwd=REPOSITORY, stdout=subprocess.PIPE, check=True, text=True
    ).stdout.split()
    first = [PurePosixPath("README.md"), *map(PurePosixPath, [] if alone else tracked)]
    for path, text in [(first[0], (REPOSITORY / first[0]).read_text())] if alone else reached(first):
        target = folder / installed(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        if text is None:
            shutil.copy(REPOSITORY / path, target)
        else:
            target.write_text(rewritten(path, text, alone=alone))


if __name__ == "__main__":
    main()
