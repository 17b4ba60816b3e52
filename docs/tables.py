"""Makes tables of ACCURACY.md and PERFORMANCE.md from what `waypost-eval` reported.

`measurements.toml` has a name and a command for each report. `python docs/tables.py NAME... --data DATA` runs the commands,
keeps their reports, with commit and machine, in `measured/NAME.json`, and writes the rows anew; without a name it only
writes the rows. The commit is that of the repository: build there before. A command that has a list `each` beside it runs once
for each of its texts, in place of EACH, and its report is the list of these reports. Where it has `seeds`, too, it runs so often
for each text, with 0 and so on in place of SEED, and the reports are each text's `runs`. A word with a `*` stands for the files
of such names. What a row says stands in a comment before its table:

    <!-- rows of NAME
    left_out[0] | `ietower`: offices, {frames} frames | {recognised} of {queries_with_loop} |
    -->

The first cell says which part of the report a row is of: `report` for all of it, `[*]` for a row for each of a list,
`kept` for a row that an earlier program measured, and that stays. Of several reports it begins with the name of one.
In braces stands an expression of that part's fields, of `each`, of `commit`, and of the table's reports by their names (`_` for
`-`). After a colon follows how it is written: `:.2` with two decimals, `:%1` in percent with one, `:,` with commas. A test holds
the pages against the reports.
"""

from __future__ import annotations

import argparse
import glob
import json
import os
import platform
import re
import shlex
import statistics
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent
MEASURED = DOCS / "measured"
PAGES = [REPOSITORY / "ACCURACY.md", REPOSITORY / "PERFORMANCE.md"]

#: A comment with templates, what stands between it and its table, the table's two first lines, and its rows.
TABLE = re.compile(
    r"(?P<head><!-- rows of (?P<names>[^\n]+)\n(?P<rows>.*?)-->\n+\|[^\n]*\n\|[-| ]+\|\n)(?P<body>(?:\|[^\n]*\n)*)",
    re.DOTALL,
)
HOLE = re.compile(r"\{(?P<expression>[^{}]+?)(?::(?P<how>[.%,]\d*))?\}")


@dataclass
class Measured:
    """A report of `waypost-eval`, and how it came about."""

    command: str
    commit: str
    machine: str
    report: Any

    @classmethod
    def read(cls, name: str) -> Measured:
        """The one that was kept last."""
        return cls(**json.loads((MEASURED / f"{name}.json").read_text(), object_hook=as_fields))

    def write(self, name: str) -> None:
        """Keeps it."""
        MEASURED.mkdir(exist_ok=True)
        (MEASURED / f"{name}.json").write_text(json.dumps(vars(self), indent=1) + "\n")


def as_fields(record: dict[str, Any]) -> Any:
    """A record whose fields have names; the outermost one stays as it is."""
    return record if "report" in record else SimpleNamespace(**record)


def page_with_tables(text: str) -> str:
    """The page with the rows of its tables as the reports have them."""
    return TABLE.sub(lambda found: found["head"] + "".join(rows(found["names"], found["rows"])), text)


def rows(names: str, templates: str) -> Iterator[str]:
    """Rows of one table."""
    measured = {name: Measured.read(name) for name in names.split()}
    reports = {name: of.report for name, of in measured.items()}
    by_name = {name.replace("-", "_"): report for name, report in reports.items()}
    for template in filter(None, (line.strip() for line in templates.splitlines())):
        path, cells = (part.strip() for part in template.split("|", 1))
        if path == "kept":
            yield f"| {cells}\n"
            continue
        name, path = of_report(reports, path)
        for number, part in enumerate(parts(reports[name], path)):
            known = by_name | {"commit": measured[name].commit, "number": number} | vars(part)
            yield f"| {HOLE.sub(lambda hole, known=known: cell(known, hole['expression'], hole['how']), cells)}\n"


def of_report(reports: dict[str, Any], path: str) -> tuple[str, str]:
    """Which report a template's rows are of, and what part of it."""
    for name in reports:
        if path == name or path.startswith((f"{name}.", f"{name}[")):
            return name, path.removeprefix(name)
    [name] = reports
    return name, "" if path == "report" else f".{path}"


def parts(report: Any, path: str) -> list[Any]:
    """What a template's rows are of."""
    # Ours alone: paths and expressions are of this repository's pages.
    found = eval(f"report{path.removesuffix('[*]')}", {"__builtins__": {}}, {"report": report})  # noqa: S307
    return list(found) if path.endswith("[*]") else [found]


def total(parts: list[Any], field: str) -> float:
    """A field of all parts, added up."""
    return sum(getattr(part, field) for part in parts)


def where(parts: list[Any], **fields: Any) -> list[Any]:
    """Those parts whose fields are so."""
    return [part for part in parts if all(getattr(part, name) == value for name, value in fields.items())]


#: What expressions may use besides a report's fields.
HELPERS = {
    "__builtins__": {},
    "sum": sum,
    "total": total,
    "where": where,
    "max": max,
    "min": min,
    "round": round,
    "len": len,
    "str": str,
    "sorted": sorted,
    "zip": zip,
    "median": statistics.median,
}


def cell(known: dict[str, Any], expression: str, how: str | None) -> str:
    """One figure as it is written."""
    value = eval(expression, dict(HELPERS, **known))  # noqa: S307
    if how is None:
        return "–" if value is None else str(value)
    if how.startswith("%"):
        return decimals(100 * value, how[1:])
    if how.startswith("."):
        return decimals(value, how[1:])
    return f"{value:,.0f}"


def decimals(value: float, count: str) -> str:
    """With a minus that is one, and none before a zero."""
    written = f"{value:.{int(count)}f}"
    return written.replace("-", "−" if float(written) else "")


def measure(name: str, data: Path, programs: Path, out: Path) -> None:
    """Runs a command of `measurements.toml`, and keeps what it reports."""
    measurement = tomllib.loads((DOCS / "measurements.toml").read_text())[name]
    command = measurement["command"]
    out.mkdir(parents=True, exist_ok=True)

    def reported(command: str) -> Any:
        places = {"DATA": str(data), "OUT": str(out)}
        words = [
            re.sub(r"\b(DATA|OUT)\b", lambda word: places[word[0]], word) for word in shlex.split(command)
        ]
        words = [name for word in words for name in (sorted(glob.glob(word)) if "*" in word else [word])]
        environment = os.environ | {"PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
        return json.loads(run([*words, "--json"], environment))

    def reported_for(each: str) -> Any:
        of_each = command.replace("EACH", each)
        if "seeds" not in measurement:
            return kept({"each": each} | reported(of_each), is_item=True)
        runs = [reported(of_each.replace("SEED", str(seed))) for seed in range(measurement["seeds"])]
        return {"each": each, "runs": kept(runs)}

    report = (
        [reported_for(each) for each in measurement["each"]]
        if "each" in measurement
        else kept(reported(command))
    )
    commit = run(["git", "rev-parse", "--short=7", "HEAD"], os.environ).decode().strip()
    Measured(command, commit, machine(), report).write(name)


def run(words: list[str], environment: Mapping[str, str]) -> bytes:
    """What a command prints."""
    ended = subprocess.run(words, stdout=subprocess.PIPE, check=True, env=environment, cwd=REPOSITORY)
    return ended.stdout


def kept(figure: Any, *, is_item: bool = False) -> Any:
    """A report without what is of single frames and closures: lists of records, or of lists, that are below a list."""
    if isinstance(figure, dict):
        return {
            name: kept(value)
            for name, value in figure.items()
            if not (is_item and isinstance(value, list) and value and isinstance(value[0], dict | list))
        }
    return [kept(value, is_item=True) for value in figure] if isinstance(figure, list) else figure


def machine() -> str:
    """What the figures were measured on, and how busy it was."""
    processor = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    name = processor[1] if processor else platform.machine()
    return f"{os.cpu_count()} cores of {name}, load {os.getloadavg()[0]:.1f} at the end"


def main() -> None:
    """Measures what is named, and writes the pages."""
    parser = argparse.ArgumentParser(description="Make the tables of ACCURACY.md and PERFORMANCE.md anew.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="of measurements.toml: measured first")
    parser.add_argument(
        "--data", type=Path, default=Path("data"), help="folder of the data, DATA in commands"
    )
    parser.add_argument(
        "--programs", type=Path, default=REPOSITORY / "target/release", help="with waypost-eval"
    )
    parser.add_argument("--out", type=Path, default=REPOSITORY / "target/measured", help="OUT in commands")
    options = parser.parse_args()
    for name in options.names:
        measure(name, options.data.resolve(), options.programs.resolve(), options.out.resolve())
    for page in PAGES:
        page.write_text(page_with_tables(page.read_text()))


if __name__ == "__main__":
    sys.exit(main())
