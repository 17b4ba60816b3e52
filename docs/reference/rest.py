"""The pages of REST, from the description that the server gives of itself."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from typing import Any

from .text import REPOSITORY, anchor, code, flowing, page, prose, table

Node = dict[str, Any]
#: Answers that every route may give: they stand on the page once.
USUAL = "#/components/responses/"


@cache
def description() -> Node:
    """The OpenAPI document."""
    loaded: Node = json.loads((REPOSITORY / "server" / "openapi.json").read_text())
    return loaded


def routes() -> str:
    """The page of routes, by what they are about."""
    document = description()
    parts = [document["info"]["description"], "## Refusals", refusals(document)]
    for tag in document["tags"]:
        parts += [f"## {tag['name'].capitalize()}", tag["description"]]
        for path, methods in document["paths"].items():
            for method, operation in methods.items():
                if tag["name"] in operation["tags"]:
                    parts += list(operation_parts(f"{method.upper()} {path}", operation))
    return page(
        "REST: routes",
        "server/openapi.json",
        "A server shows the same at `/docs/`, where you can try it, and gives it to programs at "
        "`/v1/openapi.json`. "
        "What is taken and given: [REST: types](rest-types.md).",
        *parts,
    )


def refusals(document: Node) -> str:
    """What any route may answer with."""
    used: dict[str, str] = {}
    for methods in document["paths"].values():
        for operation in methods.values():
            for status, answer in operation["responses"].items():
                if "$ref" in answer:
                    used[status] = answer["$ref"].removeprefix(USUAL)
    responses = document["components"]["responses"]
    return table(
        ["status", "when"],
        [(status, responses[name]["description"]) for status, name in sorted(used.items())],
    )


def operation_parts(heading: str, operation: Node) -> Iterator[str]:
    """One route with one method."""
    yield f"### {code(heading)}"
    yield operation.get("summary", "")
    yield operation.get("description", "")
    yield table(
        ["parameter", "in", "type", ""],
        [
            (
                code(parameter["name"]),
                parameter["in"] + (", required" if parameter.get("required") else ""),
                kind(parameter["schema"]),
                flowing(parameter.get("description", "")),
            )
            for parameter in operation.get("parameters", [])
        ],
    )
    if body := operation.get("requestBody"):
        yield f"Body: {contents(body)}. {flowing(body.get('description', ''))}"
    yield table(
        ["answer", "", "as"],
        [
            (status, flowing(answer["description"]), contents(answer))
            for status, answer in operation["responses"].items()
            if "$ref" not in answer
        ],
    )


def contents(of: Node) -> str:
    """Media types of a body, with the types of what is in them."""
    told = []
    for media, content in of.get("content", {}).items():
        schema = content.get("schema", {})
        binary = not schema or schema.get("format") == "binary" or schema.get("type") == "string"
        told.append(code(media) if binary else f"{kind(schema)} ({code(media)})")
    return " or ".join(told) or "nothing"


def types() -> str:
    """The page of types."""
    parts = []
    for name, schema in sorted(description()["components"]["schemas"].items()):
        parts += [f"## {name}", flowing(schema.get("description", ""))]
        parts.append(fields(schema) if "properties" in schema else whole(schema))
    return page(
        "REST: types",
        "server/openapi.json",
        "What the [routes](rest.md) take and give, in JSON. Where a field may be `null`, that means: "
        "there is none.",
        *parts,
    )


def whole(schema: Node) -> str:
    """A type that is no object."""
    return f"One of {kind(schema)}." if "enum" in schema else f"A value: {kind(schema)}."


def fields(schema: Node) -> str:
    """What an object has."""
    needed = set(schema.get("required", []))
    return table(
        ["field", "type", ""],
        [
            (
                code(name),
                kind(field) + ("" if name in needed else ", may be left out"),
                flowing(field.get("description", "")),
            )
            for name, field in schema["properties"].items()
        ],
    )


def kind(schema: Node) -> str:
    """A type in words."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{code(name)}](rest-types.md#{anchor(name)})"
    for choice in ("oneOf", "anyOf", "allOf"):
        if choice in schema:
            return " or ".join(dict.fromkeys(kind(one) for one in schema[choice]))
    names = schema.get("type", "object")
    return " or ".join(one_kind(name, schema) for name in ([names] if isinstance(names, str) else names))


def one_kind(name: str, schema: Node) -> str:
    """A type that has no alternative."""
    if name == "array":
        return f"list of {kind(schema['items'])}"
    if name == "null":
        return code("null")
    if "enum" in schema:
        return ", ".join(code(str(value)) for value in schema["enum"] if value is not None)
    if name == "object" and isinstance(schema.get("additionalProperties"), dict):
        return f"object of {kind(schema['additionalProperties'])}"
    return prose(name) + (f" ({schema['format']})" if "format" in schema else "") + limits(schema)


def limits(schema: Node) -> str:
    """What a number may be at least and at most."""
    least, most = schema.get("minimum"), schema.get("maximum")
    told = [f"from {least}" if least is not None else "", f"to {most}" if most is not None else ""]
    default = f"default {json.dumps(schema['default'])}" if "default" in schema else ""
    text = ", ".join(part for part in (" ".join(part for part in told if part), default) if part)
    return f", {text}" if text else ""
