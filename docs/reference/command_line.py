"""The page of the command lines, from what the programs say with --help."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from .text import code, page, prose, sentence, table

#: The programs that users have, with what stands in the help of each of their commands.
PROGRAMS = ("waypost", "waypost-server", "waypost-ros")
#: Sections that are the same for all commands of a program: they stand under the program alone.
SHARED = ("Global options", "Exit codes")


@dataclass
class Help:
    """What a command says of itself."""

    about: str
    usage: str
    #: Arguments and options, in order: how it is written, and what it means.
    items: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    #: Sections of other text.
    texts: dict[str, str] = field(default_factory=dict)


def make(binary: Callable[[str], Path]) -> str:
    """The page."""
    parts = [text for program in PROGRAMS for text in program_parts(binary(program), program)]
    return page(
        "Command lines",
        "what the programs say with --help",
        "Each program says this with `--help`, and `waypost man FOLDER` writes it as manual pages.",
        *parts,
    )


def program_parts(binary: Path, program: str) -> Iterator[str]:
    """A heading for the program, and one for each of its commands."""
    for words in commands(binary):
        shown = read(binary, words)
        yield f"{'##' if not words else '###'} {code(' '.join([program, *words]))}"
        yield prose(shown.about)
        yield f"```text\n{shown.usage}\n```"
        for title, items in shown.items.items():
            if not words or title not in SHARED:
                yield table([title, ""], items)
        for title, text in shown.texts.items():
            if not words or title not in SHARED:
                yield f"{title}:\n\n```text\n{text}\n```"


def commands(binary: Path, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """The program itself and all commands, each group before what is in it."""
    yield words
    listed = re.search(r"^Commands:\n((?: .*\n|\n(?= ))+)", said(binary, words), re.MULTILINE)
    for name in re.findall(r"^  ([a-z][a-z-]*)", listed[1], re.MULTILINE) if listed else []:
        if name != "help":
            yield from commands(binary, (*words, name))


def said(binary: Path, words: tuple[str, ...], flag: str = "--help") -> str:
    """What a command prints, in the environment of nobody in particular."""
    # Help shows the value of a variable that is set.
    env = {name: value for name, value in os.environ.items() if not name.startswith(("WAYPOST_", "ROS_"))}
    asked = [str(binary), *words, flag]
    shown = subprocess.run(asked, env=env, check=True, stdout=subprocess.PIPE, text=True)
    return shown.stdout


def read(binary: Path, words: tuple[str, ...]) -> Help:
    """The help, taken apart."""
    text = said(binary, words)
    about, _, rest = text.partition("Usage: ")
    usage, _, rest = rest.partition("\n\n")
    found = Help(about.strip(), "\n".join(line.strip() for line in usage.splitlines()))
    for section in re.split(r"\n(?=[A-Z][^\n:]*:\n)", "\n" + rest):
        title, _, body = section.strip("\n").partition(":\n")
        if title == "Commands":
            found.items[title] = [
                (code(name), meaning(what))
                for name, what in re.findall(r"^  ([a-z-]+) +(.+)$", body, re.MULTILINE)
                if name != "help"
            ]
        elif re.search(r"^ {2,6}(?:-|<|\[)", body, re.MULTILINE):
            found.items[title] = list(items(body))
        elif title:
            found.texts[title] = re.sub(r"^  ", "", body.rstrip(), flags=re.MULTILINE)
    return found


def items(body: str) -> Iterator[tuple[str, str]]:
    """Arguments or options of a section."""
    for entry in re.split(r"\n(?= {2,6}[-<\[])", "\n" + body):
        # Where nothing is said at length, it stands on the same line.
        found = re.match(r"\s*(\S.*?)(?:  +(\S.*))?(?:\n(.*))?$", entry, re.DOTALL)
        if found and "--help" not in found[1] and "--version" not in found[1]:
            yield code(found[1]), meaning("\n".join(part for part in found.groups()[1:] if part))


#: What clap adds to the meaning of an item.
NOTE = re.compile(r"\s*\[(env|default|possible values|aliases|alias): ([^\]]*?)=?\]")


def meaning(text: str) -> str:
    """What an item means, with its values, default and variable."""
    text = "\n".join(line.strip() for line in text.splitlines())
    notes = [noted(kind, what) for kind, what in NOTE.findall(text)]
    text, _, values = NOTE.sub("", text).partition("Possible values:\n")
    said = [sentence(prose(" ".join(part.split()))) for part in re.split(r"\n\n+", text) if part.strip()]
    for name, what in re.findall(r"^- ([^:\n]+):? *(.*)$", values, re.MULTILINE):
        said.append(f"{code(name)}: {sentence(prose(what))}" if what else code(name))
    return "\n".join([*said, *([" ".join(notes)] if notes else [])])


def noted(kind: str, what: str) -> str:
    """A note in words. A default that is a phrase is no code."""
    label = {"env": "Environment", "default": "Default"}.get(kind, kind.capitalize())
    return f"{label}: {prose(what) if ' ' in what and kind == 'default' else code(what)}."
