"""Figures that README and the guide repeat are those of ACCURACY.md and PERFORMANCE.md; so are the charts."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent
sys.path[:0] = [str(DOCS)]

import charts  # noqa: E402
import tables  # noqa: E402

README, FIGURES, NUMBERS = "README.md", "docs/guide/src/figures.md", "docs/guide/src/numbers.md"
FLEET, METRES = "docs/guide/src/fleet.md", "docs/guide/src/metres.md"
QUESTIONS = "docs/guide/src/faq.md"


def said(page: str) -> str:
    """A page's words, with one blank between them, and without what makes them bold."""
    return " ".join((REPOSITORY / page).read_text().replace("**", "").split())


def cell(page: str, table: str, row: str, column: int) -> str:
    """Of the table whose header begins so, in the row that begins so."""
    found = [cells for cells in charts.table(page, table) if cells[0].replace("`", "").startswith(row)]
    assert len(found) == 1, f"{page}: {len(found)} rows begin with {row}"
    return found[0][column]


def sequences() -> list[list[str]]:
    """What ACCURACY.md begins with: sequence, recognised, accepted, recall, reference, error."""
    return charts.table("ACCURACY.md", "sequence | recognised")


@pytest.mark.parametrize("name", charts.CHARTS)
def test_a_chart_is_drawn_from_the_tables_as_they_are(name: str) -> None:
    if (DOCS / name).read_text() != charts.CHARTS[name]().svg():
        pytest.fail(f"{name} shows other figures: run docs/charts.py and commit", pytrace=False)


def test_what_is_recognised_is_the_same_everywhere() -> None:
    readme = {"ietower": "look-alike office floors", "gardens": "a campus path", "qut": "tiny fisheye images"}
    for sequence, recognised, accepted, recall, reference, _ in sequences():
        name = re.match(r"`(\w+)`", sequence)[1]
        row = cell(FIGURES, "sequence | recall", name, 3), cell(FIGURES, "sequence | recall", name, 4)
        assert row == (recognised, accepted)
        assert cell(FIGURES, "sequence | recall", name, 1) == f"{recall} %"
        assert cell(FIGURES, "sequence | recall", name, 2) == f"{reference} %"
        for begins, words in readme.items():
            if name.startswith(begins):
                assert cell(README, "what | figure", words, 1).replace("**", "") == recognised


def test_sums_over_the_sequences_are_right() -> None:
    recognised = sum(int(row[1].split()[0]) for row in sequences())
    accepted = sum(int(row[2].split(",")[0]) for row in sequences())
    assert f"all {recognised} on those sequences were right" in said(NUMBERS)
    assert f"each left out in turn, {accepted} were accepted, and none was false" in said(NUMBERS)


def test_what_was_reached_and_missed_is_what_was_measured() -> None:
    """The share of recognised frames and of recall, against what was wanted."""
    shares = [
        100 * int(found) / int(of)
        for _, recognised, *_ in sequences()
        for found, of in re.findall(r"(\d+) of (\d+)", recognised)
    ]
    recalls = [float(row[3].split("/")[0]) for row in sequences()]
    errors = [float(row[5].split(",")[0]) for row in sequences()]
    names = [re.match(r"`(\w+)`", row[0])[0] for row in sequences()]

    def numbers(row: str, column: int) -> list[float]:
        found = re.findall(r"[\d.]+", cell("ACCURACY.md", "| wanted", row, column))
        return [float(number) for number in found]

    for row, reached, digits in (("frames", shares, 1), ("recall", recalls, 1)):
        assert numbers(row, 2) == [round(share, digits) for share in reached]
        wanted = numbers(row, 1)
        missed = [name for name, share, least in zip(names, reached, wanted, strict=True) if share < least]
        assert cell("ACCURACY.md", "| wanted", row, 3) == ", ".join(missed)
    assert numbers("calibration", 2) == errors
    missed = [name for name, error in zip(names, errors, strict=True) if error > numbers("calibration", 1)[0]]
    assert cell("ACCURACY.md", "| wanted", "calibration", 3) == ", ".join(missed)


def test_simulated_figures_are_those_of_accuracy() -> None:
    assert f"a map that is {cell('ACCURACY.md', 'route | images', '38 m', 5)} off" in said(METRES)
    drives, arrived = cell("ACCURACY.md", "trial | drives", "repeat", 1).split(", ")
    mean_cm = 100 * float(cell("ACCURACY.md", "trial | drives", "repeat", 2).split(",")[0])
    assert cell(README, "what | figure", "led along 30 m", 1) == f"{arrived} of {drives}; {mean_cm:.1f} cm"
    found, of = re.findall(r"\d+", cell(README, "what | figure", "found again", 1))
    assert f"(seeds 3000 to 30{int(of) - 1}, run once): {found} found out where they were" in said(
        "ACCURACY.md"
    )


def test_times_are_those_of_performance() -> None:
    """What README and the guide repeat of PERFORMANCE.md, and of ACCURACY.md's times per frame."""
    totals = [float(row[6]) for row in charts.table("ACCURACY.md", "sequence | decode")]
    assert f"One image takes {min(totals):.0f} to {max(totals):.0f} ms" in said(QUESTIONS)
    for row in ("filter update", "50 robots"):
        assert cell(README, "what | figure", row, 1) == cell("PERFORMANCE.md", "what | figure", row, 1)
    for row in ("50 robots", "… their data in memory"):
        told = [cell("PERFORMANCE.md", "robots that send words", row, column) for column in (1, 2)]
        assert cell(FIGURES, "what | figure", row, 1) == f"{told[0]} and {told[1]} ms"
        assert cell("PERFORMANCE.md", "what | figure", row, 1) == f"{told[0]}, {told[1]} ms"
        assert cell(FLEET, "load | what", row, 1) == f"{told[0]} ms; {told[1]} ms"
    for servers, begins in (("1", "images, one server"), ("2", "… two servers")):
        rate = cell("PERFORMANCE.md", "servers, machine | images/s", f"{servers}, Xeon-2", 1)
        assert cell(FLEET, "load | what", begins, 1) == f"{rate} images a second"


def test_ratios_to_others_are_those_of_the_times() -> None:
    """Ratios are of times before they were rounded, so they may differ by what rounding does."""
    for row in charts.table("PERFORMANCE.md", "places, words | Waypost"):
        ours, *others = (float(number) for number in row[1:4])
        for theirs, ratio in zip(others, row[4:], strict=True):
            assert abs(theirs / ours / float(ratio.removesuffix(" times")) - 1) < 0.05
    rows = charts.table("PERFORMANCE.md", "places, words | Waypost")
    for column, name in ((4, "FabMap2"), (5, "DBoW2")):
        ratios = sorted(int(row[column].removesuffix(" times")) for row in rows)
        told = cell("PERFORMANCE.md", "what | figure", f"… faster than {name}", 1)
        assert told == f"{ratios[0]} to {ratios[-1]} times"


@pytest.mark.parametrize("page", ["ACCURACY.md", "PERFORMANCE.md"])
def test_each_section_with_a_table_names_a_commit(page: str) -> None:
    sections = re.split(r"^(?=#+ )", (REPOSITORY / page).read_text(), flags=re.MULTILINE)
    tables = [section for section in sections if "\n|" in section]
    assert len(tables) > 8
    without = [
        section.splitlines()[0]
        for section in tables
        if not re.search(r"\b(?=\d*[a-f])[0-9a-f]{7}\b", section)
    ]
    assert not without


@pytest.mark.parametrize("page", tables.PAGES, ids=lambda page: page.name)
def test_a_table_says_what_was_reported(page: Path) -> None:
    if tables.page_with_tables(page.read_text()) != page.read_text():
        pytest.fail(f"{page.name} shows other figures: run docs/tables.py and commit", pytrace=False)


@pytest.mark.parametrize("page", tables.PAGES, ids=lambda page: page.name)
def test_a_section_names_the_commit_of_each_report(page: Path) -> None:
    sections = re.split(r"^(?=#+ )", page.read_text(), flags=re.MULTILINE)
    for section in sections:
        for made in tables.TABLE.finditer(section):
            for name in made["names"].split():
                commit = tables.Measured.read(name).commit
                assert commit in section, f"{name} was measured at {commit}: {section.splitlines()[0]}"


def test_each_report_is_of_a_known_command_and_shown() -> None:
    commands = tomllib.loads((DOCS / "measurements.toml").read_text())
    shown = {
        name
        for page in tables.PAGES
        for made in tables.TABLE.finditer(page.read_text())
        for name in made["names"].split()
    }
    assert shown == {report.stem for report in tables.MEASURED.glob("*.json")}
    for name in shown:
        assert tables.Measured.read(name).command == commands[name]["command"]


def test_rows_are_written_from_reports(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tables, "MEASURED", tmp_path)
    runs = [{"seed": 1, "error_m": -0.0004, "frames": 1200}, {"seed": 2, "error_m": -1.5, "frames": None}]
    tables.Measured("a command", "0123456", "a machine", {"share": 0.1234, "runs": runs}).write("some")
    head = "<!-- rows of some\n{}\n-->\n\n| a | b |\n|---|---|\n"
    for template, rows in (
        ("runs[*] | {seed} | {error_m:.2} |", "| 1 | 0.00 |\n| 2 | −1.50 |\n"),
        (
            "report | {share:%1} % | {total(runs, 'error_m'):.1} |\nkept | as | before |",
            "| 12.3 % | −1.5 |\n| as | before |\n",
        ),
        (
            "report | {len(where(runs, seed=2))} | {total(where(runs, seed=1), 'frames'):,} |",
            "| 1 | 1,200 |\n",
        ),
        (
            "runs[1] | {frames} | {frames} |\nsome.runs[0] | {frames:,} | {seed} |",
            "| – | – |\n| 1,200 | 1 |\n",
        ),
    ):
        page = head.format(template)
        assert tables.page_with_tables(page + "| old | row |\n\nNext.") == page + rows + "\nNext."
