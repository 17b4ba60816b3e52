"""The page of errors: what each kind is called on every way in, and what to do."""

from __future__ import annotations

import re
from collections.abc import Iterator
from http import HTTPStatus

from waypost import errors

from .text import REPOSITORY, code, flowing, page, prose, table

#: What to do about each kind of refusal; a test asks for one of each.
WHAT_TO_DO = {
    "InvalidArgument": "Change the request: the message says what is wrong, and how to write it.",
    "NotFound": "List what there is, as with `waypost map ls`; check the spelling.",
    "AlreadyExists": "Choose another name, or go on with what is there.",
    "FailedPrecondition": "Do first what the message asks for, or ask for something else.",
    "Aborted": (
        "Nothing, if you started another stream on purpose. Else look for a "
        "second program with this session's name. A watch begins again from 0, or from now on."
    ),
    "ResourceExhausted": "Ask for less at a time, or make room: the message says of what.",
    "QuotaUsedUp": (
        "Send the same again, after the time that comes with it: clients do so by themselves with frames. "
        "Delete what you do not need, or ask for more."
    ),
    "Unavailable": "Send the same again, after the time that comes with it. Clients do so by themselves.",
    "Unauthenticated": "Give a token that this server knows: `--token`, or `WAYPOST_TOKEN`.",
    "PermissionDenied": "Ask an administrator for a token that allows it: the message names what is missing.",
    "DeadlineExceeded": "Ask for less at a time, or give the call more time.",
    "DataLoss": "`waypost-server check --deep` says what is damaged; restore a backup.",
    "Internal": "It is a bug: report it with the lines of the server's log that have the same `request_id`.",
}
#: Kinds that gRPC has no name of their own for.
CALLED = {"QuotaUsedUp": "ResourceExhausted"}
#: Files whose errors are enumerated with their messages.
ENUMERATED = {
    "Starting a server": ("server/src/config/error.rs", "ConfigError"),
    "Clients": ("client/src/error.rs", "Error"),
}


def kinds() -> list[tuple[str, str]]:
    """Each kind of refusal, and what it means, in the server's words."""
    source = (REPOSITORY / "server/src/error.rs").read_text()
    [body] = re.findall(r"^pub enum ServiceError \{\n(.*?)^\}", source, re.MULTILINE | re.DOTALL)
    found = re.findall(r"((?:^    /// .*\n)+)^    #\[error\(.*\n^    (\w+)", body, re.MULTILINE)
    return [(name, flowing(meaning.replace("///", ""))) for meaning, name in found]


def statuses() -> dict[str, int]:
    """The HTTP status of each kind."""
    return {
        name: HTTPStatus[status].value
        for name, status in arms("server/src/http.rs", "ServiceError", r"StatusCode::(\w+)")
    }


def exit_codes() -> dict[str, str]:
    """What `waypost` ends with."""
    return dict(arms("cli/src/failure.rs", "Code", r"(\d+)"))


def arms(file: str, type_: str, result: str) -> Iterator[tuple[str, str]]:
    """Variants and results of a `match`."""
    variant = rf"{type_}::\w+(?: \{{ \.\. \}})?"
    source = (REPOSITORY / file).read_text()
    for patterns, value in re.findall(
        rf"((?:{variant}\s*\|\s*)*{variant}) => (?:\{{\s*)?{result}(?:,|\s*\}})", source
    ):
        for name in re.findall(rf"{type_}::(\w+)", patterns):
            yield name, value


def exceptions() -> dict[str, str]:
    """The exception of each status of gRPC."""
    return {status.name: raised.__name__ for status, raised in errors._BY_CODE.items()}


def snake(name: str) -> str:
    """`not_found` of `NotFound`."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def messages(file: str, enum: str) -> Iterator[tuple[str, str]]:
    """The messages of an enumeration of errors; `…` stands for what is filled in."""
    source = (REPOSITORY / file).read_text()
    [body] = re.findall(rf"^pub enum {enum} \{{\n(.*?)^\}}", source, re.MULTILINE | re.DOTALL)
    text = r'"((?:[^"\\]|\\.|\\\n)*)"'
    for comment, message in re.findall(rf"((?:^    /// .*\n)+)^    #\[error\(\s*{text}", body, re.MULTILINE):
        plain = re.sub(r"\\\n\s*", "", message).replace('\\"', '"')
        if re.sub(r"\{[^{}]*\}", "", plain):
            yield (
                prose(flowing(re.sub(r"\[`([^`]+)`\]\([^)]*\)", r"`\1`", comment.replace("///", "")))),
                prose(filled(plain)),
            )


def filled(message: str) -> str:
    """With dots for what is filled in."""
    return flowing(re.sub(r"\{[^{}]*\}", "…", message))


def make() -> str:
    """The page."""
    status, exit_code, raised = statuses(), exit_codes(), exceptions()
    rows = []
    for name, meaning in kinds():
        called = CALLED.get(name, name)
        grpc = snake(called).upper()
        other = raised.get(grpc) != called
        said = f"{code(grpc)}\nHTTP {status[name]}, exit code {exit_code[called]}" + (
            "\nPython: `ServerError`" if other else ""
        )
        rows.append((said, prose(meaning), WHAT_TO_DO[name]))
    return page(
        "Errors",
        "server/src/error.rs, server/src/http.rs, cli/src/failure.rs and the clients",
        "Every refusal has a message for people: what is wrong, and how to mend it. Programs go by its kind. "
        "What you see on a map, rather than as an error, is in [Troubleshooting](../troubleshooting.md).",
        "## Refusals of the server",
        "The name is that of gRPC. REST has it in lower case, as `not_found`, and Python has an "
        "exception of that name, "
        "as `NotFound`, but where the table says otherwise. The exit code is that of `waypost`.",
        table(["name", "meaning", "what to do"], rows),
        "A refusal of one frame comes within a stream, with the same kinds. The stream goes on.",
        *[
            part
            for title, (file, enum) in ENUMERATED.items()
            for part in (f"## {title}", table(["when", "message"], messages(file, enum)))
        ],
        "What Python raises besides is in [Python](python.md#errors).",
    )
