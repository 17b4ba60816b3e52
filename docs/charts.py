"""Draws what ACCURACY.md and PERFORMANCE.md begin with, from tables in these pages: `python charts.py`.

Each bar is a cell of a table, so a figure is written once. A test holds the pictures against the tables.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent

WIDTH_PX = 760
#: Where bars begin, and how long the longest may be.
LEFT_PX, LONGEST_PX = 260, 380
BAR_PX, GAP_PX, TOP_PX = 18, 22, 70
#: Of the logarithmic axis of times.
LEAST_MS, DECADES = 0.1, 5
GREEN, BLUE, GREY = "#15803d", "#2563eb", "#9ca3af"


@dataclass
class Bar:
    """One of a group's bars: how long it is, of 1, and what stands at its end."""

    share: float
    label: str


@dataclass
class Chart:
    """Groups of bars below each other, each group with the same kinds."""

    title: str
    kinds: list[tuple[str, str]]
    groups: list[tuple[str, list[Bar]]]
    #: Marks of the axis: where, of 1, and what stands below.
    marks: list[tuple[float, str]]

    def svg(self) -> str:
        """The picture, on a card of its own colour."""
        height = TOP_PX + sum(len(bars) * BAR_PX + GAP_PX for _, bars in self.groups) + 30
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH_PX} {height}" width="{WIDTH_PX}" '
            f'height="{height}" font-family="sans-serif" font-size="14">'
        )
        card = f'<rect width="{WIDTH_PX}" height="{height}" rx="10" fill="#fbfbf8" stroke="#c9c9c2"/>'
        return "\n".join([head, card, *self._axis(height), *self._bars(), "</svg>", ""])

    def _axis(self, height: int) -> Iterator[str]:
        for share, mark in self.marks:
            x = LEFT_PX + share * LONGEST_PX
            yield f'<path d="M{x:g} {TOP_PX} V{height - 30}" stroke="#d6d3d1"/>'
            yield text(x, height - 14, mark, 'text-anchor="middle" font-size="12" fill="#4b5563"')

    def _bars(self) -> Iterator[str]:
        yield text(20, 28, self.title, 'font-weight="bold" fill="#1f2937"')
        x = LEFT_PX
        for name, colour in self.kinds:
            yield f'<rect x="{x}" y="42" width="12" height="12" fill="{colour}"/>'
            yield text(x + 18, 53, name, 'fill="#1f2937"')
            x += 44 + 8 * len(name)
        y = TOP_PX + GAP_PX // 2
        for name, bars in self.groups:
            middle = y + len(bars) * BAR_PX / 2 + 5
            yield text(LEFT_PX - 12, middle, name, 'text-anchor="end" fill="#1f2937"')
            for (_, colour), bar in zip(self.kinds, bars, strict=True):
                length = max(1.0, bar.share * LONGEST_PX)
                size = f'width="{length:.1f}" height="{BAR_PX - 4}"'
                yield f'<rect x="{LEFT_PX}" y="{y}" {size} fill="{colour}"/>'
                yield text(LEFT_PX + length + 6, y + 12, bar.label, 'font-size="12" fill="#1f2937"')
                y += BAR_PX
            y += GAP_PX


def text(x: float, y: float, words: str, how: str) -> str:
    """A line of text."""
    return f'<text x="{x:g}" y="{y:g}" {how}>{escape(words)}</text>'


def table(page: str, begins: str) -> list[list[str]]:
    """The rows' cells of the first table whose header begins so."""
    lines = (REPOSITORY / page).read_text().splitlines()
    first = next(number for number, line in enumerate(lines) if line.startswith(f"| {begins}"))
    rows = []
    for line in lines[first + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def accuracy() -> Chart:
    """What is found of the frames with a loop, on the sequences that were left out in turn."""
    groups = []
    for sequence, recognised, _, recall, reference, _ in table("ACCURACY.md", "sequence | recognised"):
        found, of = (int(number) for number in re.findall(r"\d+", recognised)[:2])
        name = re.sub(r"`(\w+)`:.*", r"\1", sequence)
        percents = [float(cell.split("/")[0]) for cell in (recall, reference)]
        bars = [Bar(found / of, f"{found} of {of}"), *(Bar(share / 100, f"{share} %") for share in percents)]
        groups.append((name, bars))
    kinds = [("recognised", GREEN), ("recall", BLUE), ("recall of the data's reference", GREY)]
    return Chart(
        "Of the frames with a loop, on four real sequences",
        kinds,
        groups,
        [(share / 100, f"{share} %") for share in (0, 25, 50, 75, 100)],
    )


def performance() -> Chart:
    """Time of a query on one machine, in turn, on a logarithmic axis."""
    groups = []
    for size, *cells in table("PERFORMANCE.md", "places, words | Waypost"):
        places, words = (part.strip() for part in re.split(r", (?=\d+,)", size))
        times = [float(cell) for cell in cells[:3]]
        ratios = ["", *(f", {cell}" for cell in cells[3:])]
        bars = [
            Bar(math.log10(ms / LEAST_MS) / DECADES, f"{cell} ms{ratio}")
            for ms, cell, ratio in zip(times, cells, ratios)
        ]
        groups.append((f"{places} places, {words} words", bars))
    kinds = [("Waypost", GREEN), ("FabMap2", BLUE), ("DBoW2", GREY)]
    return Chart(
        "Scoring all places against one query, on one machine in turn",
        kinds,
        groups,
        [(decade / DECADES, f"{LEAST_MS * 10**decade:g} ms") for decade in range(DECADES + 1)],
    )


CHARTS: dict[str, Callable[[], Chart]] = {"accuracy.svg": accuracy, "performance.svg": performance}


def main() -> None:
    """Writes them."""
    for name, chart in CHARTS.items():
        (DOCS / name).write_text(chart().svg())


if __name__ == "__main__":
    main()
