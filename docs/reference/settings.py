"""The page of settings: the server's, from its own list and its help, and those of maps."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from . import contract
from .command_line import read, said
from .text import REPOSITORY, code, page, prose, sentence, table

SOURCE = REPOSITORY / "server" / "src" / "config" / "keys.rs"


def forms() -> dict[str, str]:
    """Each setting of the server, and how it is written, from the list that its errors name."""
    listed = re.search(r"^pub\(super\) const KEYS: [^=]+= \[\n(.*?)^\];", SOURCE.read_text(), re.MULTILINE | re.DOTALL)
    assert listed, f"{SOURCE} has no KEYS"
    found = re.findall(r'\(\s*"(\w+)",\s*"((?:[^"\\]|\\.)*)",?\s*\)', listed[1])
    return {key: form.replace('\\"', '"') for key, form in found}


def other_variables() -> list[str]:
    """Variables that the server knows and that are no settings of it."""
    listed = re.search(
        r"^const OTHER_VARIABLES: [^=]+= \[(.*?)\];", SOURCE.read_text(), re.MULTILINE | re.DOTALL
    )
    assert listed, f"{SOURCE} has no OTHER_VARIABLES"
    return [f"WAYPOST_{name}" for name in re.findall(r'"(\w+)"', listed[1])]


def make(binary: Callable[[str], Path]) -> str:
    """The page."""
    options = {
        how.strip("`").removeprefix("--").split("=")[0].split("[")[0].split(" ")[0].replace("-", "_"): what
        for how, what in read(binary("waypost-server"), ()).items["Options"]
    }
    in_force = defaults(binary("waypost-server"))
    rows = []
    for key, form in forms().items():
        # The default and the values stand in cells of their own.
        meaning = re.split(r"\n(?:Default|Possible values): ", options[key])[0].replace("\n", " ")
        rows.append(
            (
                code(key),
                code(in_force[key]) if key in in_force else "none",
                f"{meaning}\nWrite {prose(form)}.",
            )
        )
    return page(
        "Settings",
        "server/src/config/keys.rs, the help of waypost-server, and proto/waypost/v1/map.proto",
        "## Of the server",
        "Each is a key of the TOML file that `--config` or `WAYPOST_CONFIG` names. It is a variable in "
        "the environment, too "
        "(`data_dir` is `WAYPOST_DATA_DIR`), and a flag (`--data-dir`). A flag wins over the "
        "environment, and that over the "
        "file. `waypost-server --print-config` shows what is in force. "
        "[Running it for others](../operations.md#settings) has examples.",
        table(["key", "default", ""], rows),
        "An empty variable counts as none. These are no settings of the server: "
        + ", ".join(code(name) for name in other_variables())
        + ". The first names the file; the others are read by `waypost` and the clients.",
        "## Of maps",
        "A map has its settings from when it is made: `waypost map create`, `CreateMap`, or `POST /v1/maps`. "
        "They stay for as long as the map is there. [Tuning](../tuning.md) says which to change, and when.",
        *map_settings(),
    )


def defaults(server: Path) -> dict[str, str]:
    """What is in force if nothing is said, as in a file of settings."""
    shown = said(server, (), "--print-config")
    return dict(re.findall(r"^(\w+) = (.+)$", shown, re.MULTILINE))


def map_settings() -> list[str]:
    """What a map decides by."""
    [file] = [file for file in contract.files() if file.name.endswith("/map.proto")]
    comments = contract.Comments(file)
    [number] = [n for n, message in enumerate(file.message_type) if message.name == "MapSettings"]
    message = file.message_type[number]
    path = (contract.MESSAGE, number)
    enums = {enum.name: (index, enum) for index, enum in enumerate(message.enum_type)}
    rows = []
    for index, field in enumerate(message.field):
        values = ""
        name = field.type_name.rpartition(".")[2]
        if name in enums:
            at, enum = enums[name]
            told = [
                f"{code(value.name[len(common(enum.name)) :].lower())}: "
                + sentence(comments(*path, contract.NESTED_ENUM, at, contract.VALUE, place))
                for place, value in enumerate(enum.value)
                if place
            ]
            values = "\n" + "\n".join(told)
        flag = "--" + field.name.replace("_", "-")
        rows.append((code(field.name), code(flag), comments(*path, contract.FIELD, index) + values))
    return [table(["field", "flag of `waypost map create`", ""], rows)]


def common(enum: str) -> str:
    """How the values of an enumeration begin."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", enum).upper() + "_"
