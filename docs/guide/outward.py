"""Called by mdBook: links that leave the guide for the repository become the names of files there."""

from __future__ import annotations

import json
import posixpath
import re
import sys
from typing import Any

#: Where the pages are in the repository.
SOURCES = "docs/guide/src"
FENCE = re.compile(r"(^ *```.*?^ *```$)", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s:]+)\)")


def inward(text: str, page: str) -> str:
    """The text of a page without links that leave the guide."""

    def name(found: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(SOURCES, posixpath.dirname(page), found[2].split("#")[0]))
        # A book has its contents beside every page.
        if target == f"{SOURCES}/SUMMARY.md":
            return found[1]
        if found[2].startswith("#") or target.startswith(f"{SOURCES}/"):
            return found[0]
        return found[1] if found[1] == target else f"{found[1]} (`{target}` in the repository)"

    parts = FENCE.split(text)
    return "".join(part if number % 2 else LINK.sub(name, part) for number, part in enumerate(parts))


def chapters(node: Any) -> None:
    """Changes all of them, wherever they are in what mdBook gives."""
    if isinstance(node, dict):
        if isinstance(node.get("content"), str) and node.get("path"):
            node["content"] = inward(node["content"], node["path"])
        node = list(node.values())
    if isinstance(node, list):
        for within in node:
            chapters(within)


if __name__ == "__main__":
    if sys.argv[1:2] == ["supports"]:
        sys.exit(0)
    _, book = json.load(sys.stdin)
    chapters(book)
    json.dump(book, sys.stdout)
