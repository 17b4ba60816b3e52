"""The page of the Python client, from the package and its docstrings."""

from __future__ import annotations

import ast
import enum
import functools
import inspect
import re
from collections.abc import Iterator
from textwrap import dedent
from typing import Any

import waypost
import waypost.aio

from .text import code, flowing, page, prose, sentence, table

#: What stands together, by how each begins; a test holds it against what the package exports.
CHAPTERS: dict[str, tuple[str, ...]] = {
    "Connecting": ("connect", "lazy", "Client"),
    "Sessions": (
        "Session",
        "Mode",
        "Sender",
        "Frame",
        "WordHistogram",
        "WordList",
        "MAX_IMAGE_BYTES",
        "png",
        "image_files",
        "read_camera",
    ),
    "Answers": (
        *(
            "Outcome",
            "Answer",
            "Refusal",
            "Reason",
            "Match",
            "LoopClosure",
            "Geometry",
            "Similarity",
            "Placement",
        ),
        *("MapPose", "FrameReference", "Timings", "QueryAnswer"),
    ),
    "Navigation": (
        *(
            "Navigation",
            "GoalLike",
            "NavigationEvent",
            "Guidance",
            "Command",
            "Localization",
            "NavigationStatus",
        ),
        *("FrameSeen", "GoalRefused", "WheelsRefused", "Disconnected", "Reconnected"),
    ),
    "Poses": ("Pose2", "Pose3"),
    "Jobs and events": ("JobProgress", "MapEvents"),
    "Errors": (
        *("WaypostError", "ServerUnreachable", "ServerError", "InvalidArgument", "NotFound", "AlreadyExists"),
        *(
            "FailedPrecondition",
            "Aborted",
            "ResourceExhausted",
            "Unavailable",
            "Unauthenticated",
            "PermissionDenied",
        ),
        *("Cancelled", "QueueFull", "SessionLost", "SessionRewound", "ProtocolError", "OdometryWarning"),
    ),
}
ASYNCHRONOUS = ("connect", "AsyncClient", "AsyncSession", "AsyncNavigation")


def make() -> str:
    """The page."""
    parts = []
    for title, names in CHAPTERS.items():
        parts.append(f"## {title}")
        for name in names:
            parts += named(name, getattr(waypost, name))
    return page(
        "Python",
        "client/python/src/waypost",
        "In a virtual environment (`python3 -m venv env`): `pip install waypost-*.whl` of a release, or "
        "`pip install client/python` in the repository. "
        "What is exported by `waypost` is here; `waypost.v1` has the messages of the "
        "[contract](messages.md).",
        *parts,
        "## waypost.aio",
        docstring(waypost.aio),
        *[part for name in ASYNCHRONOUS for part in named(name, getattr(waypost.aio, name))],
    )


def named(name: str, what: Any) -> Iterator[str]:
    """A class, a function or a value."""
    yield f"### {name}"
    if inspect.isclass(what):
        yield from class_parts(what)
    elif inspect.isfunction(what):
        yield f"```python\n{signature(what)}\n```"
        yield docstring(what)
    else:
        yield value(name, what)


def value(name: str, what: Any) -> str:
    """A constant, or a type that stands for several."""
    if isinstance(what, int):
        return f"{what:,}. {comment_above(name)}"
    members = ", ".join(code(member.__name__) for member in getattr(what, "__args__", ()))
    return f"One of {members}. {comment_above(name)}"


def comment_above(name: str) -> str:
    """What is said in the source of a name that is no class and no function."""
    for module in (waypost.frames, waypost.answers, waypost.goals, waypost.guidance):
        source = inspect.getsource(module)
        if found := re.search(rf"((?:^#: .*\n)+){name}\b", source, re.MULTILINE):
            return docs_of_comment(found[1])
    return ""


def class_parts(what: type) -> Iterator[str]:
    """A class with its fields and methods, and those of what it is put together from."""
    bases = [base.__name__ for base in what.__bases__ if base.__name__ in waypost.__all__]
    if bases:
        yield f"A {code(bases[0])}."
    yield docstring(what)
    if issubclass(what, enum.Enum):
        yield table(["value", ""], [(name, meaning) for name, _, meaning in fields(what)])
    elif hasattr(what, "__dataclass_fields__"):
        yield table(["field", "type", ""], fields(what))
    for part in what.__mro__:
        if part.__module__.startswith("waypost"):
            if part is not what and part.__name__ not in waypost.__all__:
                yield docstring(part)
            yield from methods(part)


def fields(what: type) -> list[tuple[str, str, str]]:
    """Fields or values of a class, with the comments above them."""
    source = dedent(inspect.getsource(what))
    lines = source.splitlines()
    [tree] = ast.parse(source).body
    assert isinstance(tree, ast.ClassDef)
    found = []
    for node in tree.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            name, type_ = node.target.id, ast.unparse(node.annotation)
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name, type_ = node.targets[0].id, ""
        else:
            continue
        if not name.startswith("_"):
            above = []
            for line in reversed(lines[: node.lineno - 1]):
                if not line.strip().startswith("#:"):
                    break
                above.append(line)
            default = getattr(node, "value", None)
            told = f" = {ast.unparse(default)}" if default is not None and type_ else ""
            found.append(
                (code(name), code(type_ + told) if type_ else "", docs_of_comment("\n".join(reversed(above))))
            )
    return found


def docs_of_comment(text: str) -> str:
    """Of lines that begin with `#:`."""
    return prose(flowing(" ".join(line.strip().removeprefix("#:") for line in text.splitlines())))


def methods(of: type) -> Iterator[str]:
    """What a class itself defines for others. What only awaits a method of `Client` is named alone."""
    awaited: list[str] = []
    for name, what in vars(of).items():
        if name.startswith("_"):
            continue
        if isinstance(what, (property, functools.cached_property)):
            getter = what.fget if isinstance(what, property) else what.func
            yield f"#### {name}"
            yield f"```python\n{returned(getter)}\n```"
            yield docstring(getter)
        elif inspect.isfunction(what) and inspect.unwrap(what).__module__ != of.__module__:
            awaited.append(code(name))
        elif isinstance(what, (staticmethod, classmethod)) or inspect.isfunction(what):
            function = getattr(what, "__func__", what)
            yield f"#### {name}"
            yield f"```python\n{signature(function)}\n```"
            yield docstring(function)
    if awaited:
        yield f"As in `Client`, to be awaited: {', '.join(awaited)}."


def definition(function: Any) -> ast.FunctionDef | ast.AsyncFunctionDef:
    """As it stands in the source."""
    [tree] = ast.parse(dedent(inspect.getsource(inspect.unwrap(function)))).body
    assert isinstance(tree, (ast.FunctionDef, ast.AsyncFunctionDef))
    return tree


def signature(function: Any) -> str:
    """Arguments, one a line where they are many, and what comes out."""
    tree = definition(function)
    taken = [argument for argument in arguments(tree.args) if argument not in {"self", "cls"}]
    if taken and taken[0] == "/":
        taken.pop(0)
    gives = f" -> {ast.unparse(tree.returns)}" if tree.returns else ""
    managed = any("contextmanager" in ast.unparse(decorator) for decorator in tree.decorator_list)
    asynchronous = isinstance(tree, ast.AsyncFunctionDef)
    awaited = f"{'async ' if asynchronous else ''}{'with ' if managed else ''}"
    whole = f"{awaited}{tree.name}({', '.join(taken)}){gives}"
    if len(whole) <= 100:
        return whole
    inside = ",\n    ".join(taken)
    return f"{awaited}{tree.name}(\n    {inside},\n){gives}"


def arguments(of: ast.arguments) -> Iterator[str]:
    """Each as it would be written."""
    positional = [*of.posonlyargs, *of.args]
    missing: list[ast.expr | None] = [None] * (len(positional) - len(of.defaults))
    for number, (argument, default) in enumerate(zip(positional, [*missing, *of.defaults]), 1):
        yield written(argument, default)
        if number == len(of.posonlyargs):
            yield "/"
    if of.vararg:
        yield f"*{written(of.vararg, None)}"
    elif of.kwonlyargs:
        yield "*"
    for argument, default in zip(of.kwonlyargs, of.kw_defaults):
        yield written(argument, default)
    if of.kwarg:
        yield f"**{written(of.kwarg, None)}"


def written(argument: ast.arg, default: ast.expr | None) -> str:
    """Name, type and default."""
    typed = f"{argument.arg}: {ast.unparse(argument.annotation)}" if argument.annotation else argument.arg
    return typed if default is None else f"{typed} = {ast.unparse(default)}"


def returned(getter: Any) -> str:
    """Name and type of a property."""
    tree = definition(getter)
    return f"{tree.name}: {ast.unparse(tree.returns) if tree.returns else 'Any'}"


def docstring(of: Any) -> str:
    """In Markdown: paragraphs, examples, and lists of arguments and errors."""
    blocks = re.split(r"\n\s*\n", inspect.getdoc(of) or "")
    return "\n\n".join(block for block in map(paragraph, blocks) if block)


def paragraph(text: str) -> str:
    """One of a docstring."""
    if text.startswith(">>>"):
        return f"```python\n{text}\n```"
    title, _, rest = text.partition("\n")
    if title in {"Args:", "Raises:", "Attributes:"}:
        entries = re.split(r"\n(?=\S)", dedent(rest))
        rows = [entry.partition(":") for entry in entries]
        return table(
            [title.rstrip(":").replace("Args", "Arguments"), ""],
            [(code(name), sentence(prose(flowing(what)))) for name, _, what in rows],
        )
    if title in {"Returns:", "Yields:"}:
        return f"{title.rstrip(':')} {prose(flowing(rest))}"
    return prose(flowing(text))
