"""The reference pages say what the sources say, all of it, and the guide as a book links to what there is."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent
sys.path[:0] = [str(DOCS), str(DOCS / "guide"), str(REPOSITORY / "client" / "python" / "tests")]

import dead_links  # noqa: E402
import outward  # noqa: E402
from conftest import IMAGES, MODEL, Server, binary, environment  # noqa: E402
from reference import contract, errors, metrics, python_client, settings, text  # noqa: E402
from reference.__main__ import pages  # noqa: E402

import waypost  # noqa: E402

MADE = pages(binary)


@pytest.mark.parametrize("name", MADE)
def test_a_page_says_what_its_sources_say(name: str) -> None:
    if (text.PAGES / name).read_text() != MADE[name]():
        pytest.fail(
            f"{name} is not what its sources say now: run scripts/build-docs and commit", pytrace=False
        )


def test_there_is_no_page_without_sources() -> None:
    assert sorted(MADE) == sorted(page.name for page in text.PAGES.iterdir())


def kept(name: str) -> str:
    return (text.PAGES / name).read_text()


def headings(name: str) -> list[str]:
    return [heading.strip("`") for heading in re.findall(r"^#{2,4} (.+)$", kept(name), re.MULTILINE)]


def test_every_command_and_flag_of_waypost_is_there(tmp_path: Path) -> None:
    """By its manual pages, which are made in another way than its help."""
    subprocess.run([binary("waypost"), "man", tmp_path], check=True, stdout=subprocess.DEVNULL)
    manual = list(tmp_path.iterdir())
    assert len(manual) > 50
    told = {heading.replace(" ", "-") for heading in headings("command-line.md")}
    assert {page.stem for page in manual} <= told
    flags = {
        flag for page in manual for flag in re.findall(r"\\-\\-([a-z]+(?:\\-[a-z]+)*)", page.read_text())
    }
    flags = {flag.replace("\\", "") for flag in flags} - {"help", "version"}
    assert len(flags) > 60
    assert {flag for flag in flags if f"--{flag}" not in kept("command-line.md")} == set()


def test_every_setting_of_the_server_is_there_with_its_default(tmp_path: Path) -> None:
    """By what it prints of itself, and by what it takes."""
    printed = subprocess.run(
        [binary("waypost-server"), "--print-config"],
        env=environment(),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    ).stdout
    for key, value in re.findall(r"^(\w+) = (.+)$", printed, re.MULTILINE):
        assert f"| `{key}` | `{value}` |" in kept("settings.md")
    unknown = tmp_path / "unknown.toml"
    unknown.write_text("nosuch = 1\n")
    refused = subprocess.run(
        [binary("waypost-server"), "--config", unknown], env=environment(), stderr=subprocess.PIPE, text=True
    )
    known = refused.stderr.rpartition("known are ")[2].replace(" and ", ", ")
    assert {key.strip() for key in known.split(",")} == settings.forms().keys()


def test_every_setting_of_a_map_has_its_flag() -> None:
    shown = subprocess.run(
        [binary("waypost"), "map", "create", "--help"], stdout=subprocess.PIPE, text=True
    ).stdout
    told = re.findall(r"^\| `(\w+)` \| `(--[a-z-]+)` \|", kept("settings.md"), re.MULTILINE)
    assert len(told) >= 12
    for _, flag in told:
        assert f"{flag} " in shown


def test_every_metric_that_a_server_gives_is_there_with_its_labels(tmp_path: Path) -> None:
    """By those of a server that has worked."""
    described = {metric.name: metric for metric in metrics.metrics()}
    source = metrics.SOURCE.read_text()
    assert set(re.findall(r'^const \w+: &str = "(waypost_\w+)"', source, re.MULTILINE)) == described.keys()
    server = Server(tmp_path / "data")
    server.start()
    try:
        with waypost.connect(server.address) as client:
            client.import_model(MODEL, "shipped")
            client.create_map("hall")
            with client.session("hall", "monday") as session:
                frames = (
                    waypost.Frame(n, n * 10**9, image.read_bytes()) for n, image in enumerate(IMAGES[:3], 1)
                )
                assert len(list(session.stream(frames))) == 3
        given = subprocess.run(
            ["curl", "--silent", "--fail", f"http://{server.http_address}/metrics"],
            stdout=subprocess.PIPE,
            check=True,
            text=True,
        ).stdout
    finally:
        server.terminate()
    seen = set()
    for name, labels in re.findall(r"^(waypost_\w+?)(?:\{(.*)\})? \S+$", given, re.MULTILINE):
        whole = re.sub(r"_(bucket|sum|count)$", "", name)
        metric = described.get(name) or described[whole]
        seen.add(metric.name)
        assert set(re.findall(r'(\w+)="', labels)) <= metric.labels | {"le"}, metric
    assert len(seen) >= 12


def test_every_route_of_rest_is_there() -> None:
    paths = json.loads((REPOSITORY / "server/openapi.json").read_text())
    routes = {f"{method.upper()} {path}" for path, methods in paths["paths"].items() for method in methods}
    told = [heading for heading in headings("rest.md") if "/v1" in heading]
    assert sorted(told) == sorted(routes)
    assert sorted(headings("rest-types.md")) == sorted(paths["components"]["schemas"])


def test_everything_of_the_contract_is_there_with_what_it_means() -> None:
    sources = "\n".join(file.read_text() for file in (REPOSITORY / "proto/waypost/v1").glob("*.proto"))
    calls = re.findall(r"^  rpc (\w+)\(", sources, re.MULTILINE)
    assert len(calls) > 50
    for call in calls:
        assert re.search(rf"^\| `{call}` \| \S", kept("grpc.md"), re.MULTILINE), call
    declared = re.findall(r"^ *(?:message|enum) (\w+) \{", sources, re.MULTILINE)
    told = [
        heading.rpartition(".")[2] for heading in headings("messages.md") if not heading.endswith(".proto")
    ]
    assert sorted(told) == sorted(declared)
    fields = re.findall(r"^ +(?:[\w.<>, ]+ )?(\w+) = \d+(?: \[.*\])?;", sources, re.MULTILINE)
    assert (
        len(fields) == len(re.findall(r"^\| (?:\d+ \| )?`\w+` \|", kept("messages.md"), re.MULTILINE)) > 300
    )


def test_everything_that_the_python_package_exports_is_there() -> None:
    named = [name for names in python_client.CHAPTERS.values() for name in names]
    assert sorted(named) == sorted(waypost.__all__)
    told = headings("python.md")
    assert {name for name in dir(waypost.Client) if name[0] != "_"} <= set(told)


def test_every_kind_of_error_says_what_to_do() -> None:
    kinds = {name for name, _ in errors.kinds()}
    assert kinds == errors.WHAT_TO_DO.keys() == errors.statuses().keys()
    assert {errors.CALLED.get(name, name) for name in kinds} <= errors.exit_codes().keys()
    # Each exception of the client is of a kind that there is, but for calls that the client itself ended.
    assert {errors.snake(name).upper() for name in kinds} | {"CANCELLED"} >= errors.exceptions().keys()


def test_the_contract_is_read_with_its_comments() -> None:
    [file] = [file for file in contract.files() if file.name.endswith("/map.proto")]
    assert (
        contract.Comments(file)(contract.SERVICE, 0)
        == "Maps: places joined by links, grown by the sessions of robots."
    )


def test_plain_text_is_no_markup() -> None:
    assert text.prose("a <NAME> of `<x_y>`, map_id or *_") == "a &lt;NAME&gt; of `<x_y>`, map_id or \\*\\_"
    assert text.table(["a"], [("x|y",)]) == "| a |\n|---|\n| x\\|y |"
    assert text.table(["a"], []) == ""


def test_links_that_leave_the_guide_are_names_in_a_book() -> None:
    def told(link: str, page: str = "ros.md") -> str:
        return outward.inward(link, page)

    assert (
        told("[Python](../../../client/python/README.md#calls)")
        == "Python (`client/python/README.md` in the repository)"
    )
    assert told("[ACCURACY.md](../../../ACCURACY.md)") == "ACCURACY.md"
    assert told("the [contents](SUMMARY.md)") == "the contents"
    for link in (
        "[a](faq.md#b)",
        "[a](#b)",
        "[a](https://b.example/c)",
        "![a](pictures/b.svg)",
        "```text\n[a](../../x)\n```",
    ):
        assert told(link) == link
    assert told("[a](../faq.md)", "reference/errors.md") == "[a](../faq.md)"
    book = {"items": [{"Chapter": {"content": "[a](../../b)", "path": "c.md", "sub_items": []}}]}
    outward.chapters(book)
    assert book["items"][0]["Chapter"]["content"] == "a (`docs/b` in the repository)"


def test_dead_links_of_a_book_are_found(tmp_path: Path) -> None:
    def page(name: str, body: str) -> None:
        (tmp_path / name).write_text(body)

    page(
        "a.html",
        '<h1 id="top">A</h1><a href="b.html#x">b</a><a href="https://c.example">c</a><a href="#top">a</a>',
    )
    page("b.html", '<p id="x"><img src="picture.svg"></p><a href="a.html#gone">a</a><a href="#nowhere">b</a>')
    assert dead_links.dead(tmp_path) == ["b.html: #nowhere", "b.html: a.html#gone", "b.html: picture.svg"]
    page("picture.svg", "<svg/>")
    assert len(dead_links.dead(tmp_path)) == 2


def links(page: Path) -> Iterator[str]:
    yield from re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]+`", "", page.read_text()))


def test_the_pages_link_to_each_other() -> None:
    """What an anchor means is checked by test_docs; that there are many is checked here."""
    assert sum(len(list(links(page))) for page in text.PAGES.iterdir()) > 300
