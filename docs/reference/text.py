"""Markdown of what programs and sources say in plain text."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
#: Where the pages are.
PAGES = REPOSITORY / "docs" / "guide" / "src" / "reference"


def page(title: str, made_of: str, *parts: str) -> str:
    """A whole page. `made_of` says which sources hold what is on it."""
    notice = f"<!-- Made by scripts/build-docs from {made_of}: change that, then run it again. -->"
    return "\n\n".join([notice, f"# {title}", *(part.strip("\n") for part in parts if part)]) + "\n"


def prose(text: str) -> str:
    """Plain text as Markdown: code in backticks stays, and nothing else is markup."""
    pieces = re.split(r"(`[^`\n]+`)", text)
    return "".join(piece if piece.startswith("`") else _plain(piece) for piece in pieces)


def _plain(text: str) -> str:
    escaped = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    # An underscore within a word is none of emphasis.
    return re.sub(r"([\\*\[\]]|(?<!\w)_|_(?!\w))", r"\\\1", escaped)


def flowing(text: str) -> str:
    """One line of a comment that was broken into several."""
    return " ".join(text.split())


def sentence(text: str) -> str:
    """With a full stop, which the help of programs leaves out."""
    return text if not text or text[-1] in ".:!?…" else f"{text}."


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table, or nothing if it has no rows."""
    lines = [_row(row) for row in rows]
    return "\n".join([_row(heads), "|" + "---|" * len(heads), *lines]) if lines else ""


def _row(cells: Sequence[str]) -> str:
    # A pipe ends a cell even within code.
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", "<br>") for cell in cells) + " |"


def code(text: str) -> str:
    """As code within a line."""
    return f"`{text}`"


def anchor(heading: str) -> str:
    """What a heading is linked by, as git hosts and mdBook make it."""
    return re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-")
