"""The page of metrics, from where the server describes them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from .text import REPOSITORY, code, flowing, page, prose, table

SOURCE = REPOSITORY / "server" / "src" / "metrics.rs"


@dataclass
class Metric:
    """What is counted, timed or looked at."""

    name: str
    kind: str
    meaning: str
    labels: set[str] = field(default_factory=set)


def metrics() -> list[Metric]:
    """All of them, in the order in which they are described."""
    source = SOURCE.read_text().partition("#[cfg(test)]")[0]
    names = dict(re.findall(r'^const (\w+): &str = "(waypost_\w+)";', source, re.MULTILINE))
    found = [
        Metric(names[constant], kind, flowing(re.sub(r"\\\n\s*", "", text)))
        for kind, constant, text in re.findall(
            r'describe_(\w+)!\(\s*(\w+),\s*(?:Unit::\w+,\s*)?"((?:[^"\\]|\\.|\\\n)*)"', source
        )
    ]
    for constant, labels in re.findall(
        r"(?<!_)(?:counter|gauge|histogram)!\(\s*(\w+)((?:,[^()]*(?:\([^()]*\))?)*)\)", source
    ):
        [metric] = [metric for metric in found if metric.name == names[constant]]
        metric.labels |= set(re.findall(r'"(\w+)" =>', labels))
    return found


def buckets() -> Iterator[tuple[str, str]]:
    """Upper bounds of the buckets of each histogram."""
    source = SOURCE.read_text()
    names = dict(re.findall(r'^const (\w+): &str = "(waypost_\w+)";', source, re.MULTILINE))
    bounds = dict(re.findall(r"^const (\w+): \[f64; \d+\] =\s*\[(.*?)\];", source, re.MULTILINE | re.DOTALL))
    for constant, of in re.findall(r"set_buckets_for_metric\(named\((\w+)\), &(\w+)\)", source):
        numbers = (
            f"{float(number.replace('_', '')):g}" for number in bounds[of].split(",") if number.strip()
        )
        yield code(names[constant]), ", ".join(numbers)


def make() -> str:
    """The page."""
    return page(
        "Metrics",
        "server/src/metrics.rs",
        "`/metrics` at the HTTP port gives these to Prometheus. Where the server has tokens, it needs "
        "one; a reader's is "
        "enough. `docker/alerts.yaml` are rules for them, `docker/grafana-board.json` is a board. "
        "[Running it for others](../operations.md#watching-it) shows how to look at them.",
        table(
            ["metric", "kind", "labels", ""],
            [
                (
                    code(metric.name),
                    metric.kind,
                    ", ".join(code(label) for label in sorted(metric.labels)),
                    prose(metric.meaning),
                )
                for metric in metrics()
            ],
        ),
        "## Buckets",
        "Upper bounds, in seconds or in frames. A histogram has `_bucket`, `_sum` and `_count`.",
        table(["histogram", "buckets"], buckets()),
    )
