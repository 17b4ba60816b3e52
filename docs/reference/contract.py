"""The pages of gRPC, from the contract and its comments."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import grpc_tools
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
    MethodDescriptorProto,
)
from grpc_tools import protoc

from .text import REPOSITORY, anchor, code, flowing, page, prose, table

PACKAGE = ".waypost.v1."
#: Numbers of fields in the descriptors of descriptors, by which comments are found.
SERVICE, METHOD, MESSAGE, ENUM, FIELD, NESTED, NESTED_ENUM, VALUE = 6, 2, 4, 5, 2, 3, 4, 2
SCALARS = {number: name.removeprefix("TYPE_").lower() for name, number in FieldDescriptorProto.Type.items()}


@cache
def files() -> list[FileDescriptorProto]:
    """The files of the contract, with their comments."""
    proto = REPOSITORY / "proto"
    sources = [str(file.relative_to(proto)) for file in sorted((proto / "waypost/v1").glob("*.proto"))]
    well_known = Path(grpc_tools.__file__).parent / "_proto"
    with TemporaryDirectory() as folder:
        out = Path(folder) / "descriptors"
        paths = [f"--proto_path={proto}", f"--proto_path={well_known}"]
        if protoc.main(["protoc", *paths, "--include_source_info", f"--descriptor_set_out={out}", *sources]):
            raise SystemExit(f"the contract in {proto} does not compile")
        return list(FileDescriptorSet.FromString(out.read_bytes()).file)


Path_ = tuple[int, ...]


class Comments:
    """Comments of a file by the path of what they are about."""

    def __init__(self, file: FileDescriptorProto) -> None:
        self._of = {
            tuple(location.path): flowing(location.leading_comments or location.trailing_comments)
            for location in file.source_code_info.location
        }

    def __call__(self, *path: int) -> str:
        """In Markdown; empty if there is none."""
        return prose(self._of.get(path, ""))


def calls() -> str:
    """The page of services and their calls."""
    parts = []
    for file in files():
        comments = Comments(file)
        for number, service in enumerate(file.service):
            parts += [f"## {service.name}", comments(SERVICE, number)]
            parts.append(
                table(
                    ["call", "", "takes", "gives"],
                    [
                        (
                            code(method.name),
                            comments(SERVICE, number, METHOD, index),
                            *ends(method),
                        )
                        for index, method in enumerate(service.method)
                    ],
                )
            )
    return page(
        "gRPC: calls",
        "proto/waypost/v1",
        "The contract is `proto/waypost/v1` in the repository, package `waypost.v1`. Servers answer "
        "reflection, so that "
        "`grpcurl` needs no file of it. What is taken and given: [gRPC: messages](messages.md). "
        "What refusals mean: [Errors](errors.md).",
        *parts,
    )


def ends(method: MethodDescriptorProto) -> tuple[str, str]:
    """What a call takes and gives."""
    taken, given = link(method.input_type), link(method.output_type)
    return (
        f"stream of {taken}" if method.client_streaming else taken,
        f"stream of {given}" if method.server_streaming else given,
    )


def link(full_name: str) -> str:
    """To the message or enumeration, on the page of messages."""
    name = full_name.removeprefix(PACKAGE)
    return f"[{code(name)}](messages.md#{anchor(name)})" if full_name.startswith(PACKAGE) else code(name[1:])


def messages() -> str:
    """The page of messages and enumerations."""
    parts = []
    for file in files():
        comments = Comments(file)
        parts.append(f"## {file.name.rpartition('/')[2]}")
        for number, message in enumerate(file.message_type):
            parts += message_parts(message, message.name, (MESSAGE, number), comments)
        for number, enum in enumerate(file.enum_type):
            parts += enum_parts(enum, enum.name, (ENUM, number), comments)
    return page(
        "gRPC: messages",
        "proto/waypost/v1",
        "What the [calls](grpc.md) take and give. A field that is not *optional* has the value 0, or "
        "nothing, where it is "
        "left out. Fields may be added; numbers of fields never change.",
        *parts,
    )


def message_parts(message: DescriptorProto, name: str, path: Path_, comments: Comments) -> Iterator[str]:
    """A message, and after it what is declared within it."""
    yield f"### {name}"
    yield comments(*path)
    yield (
        table(
            ["field", "type", ""],
            [
                (code(field.name), kind(field, message), comments(*path, FIELD, number))
                for number, field in enumerate(message.field)
            ],
        )
        or "It has no fields."
    )
    for number, enum in enumerate(message.enum_type):
        yield from enum_parts(enum, f"{name}.{enum.name}", (*path, NESTED_ENUM, number), comments)
    for number, nested in enumerate(message.nested_type):
        if not nested.options.map_entry:
            yield from message_parts(nested, f"{name}.{nested.name}", (*path, NESTED, number), comments)


def enum_parts(enum: EnumDescriptorProto, name: str, path: Path_, comments: Comments) -> Iterator[str]:
    """An enumeration."""
    yield f"### {name}"
    yield comments(*path)
    yield table(
        ["value", "", ""],
        [
            (str(value.number), code(value.name), comments(*path, VALUE, number))
            for number, value in enumerate(enum.value)
        ],
    )


def kind(field: FieldDescriptorProto, message: DescriptorProto) -> str:
    """The type of a field."""
    entries = {f"{nested.name}": nested for nested in message.nested_type if nested.options.map_entry}
    entry = entries.get(field.type_name.rpartition(".")[2])
    if entry is not None:
        return f"map of {single(entry.field[0])} to {single(entry.field[1])}"
    if field.label == FieldDescriptorProto.LABEL_REPEATED:
        return f"repeated {single(field)}"
    if field.proto3_optional:
        return f"optional {single(field)}"
    if field.HasField("oneof_index"):
        return f"{single(field)}, one of {code(message.oneof_decl[field.oneof_index].name)}"
    return single(field)


def single(field: FieldDescriptorProto) -> str:
    """The type of one value."""
    return link(field.type_name) if field.type_name else code(SCALARS[field.type])
