"""Generates `waypost.v1` from the contract before anything is built; all else is in pyproject.toml.

The package named as the contract's is what makes the generated imports (`from waypost.v1 import …`) right.

Messages and stubs are written here, from the descriptors that protoc makes of the contract, and not by
protoc itself: what protoc and its gRPC plugin write refuses to run with any protobuf or grpcio older than
themselves, although nothing in this contract needs newer ones.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from setuptools import setup

HERE = Path(__file__).resolve().parent
CONTRACT = HERE.parent.parent / "proto"
GENERATED = HERE / "src" / "waypost" / "v1"

MESSAGES = '''"""Generated from {file}."""

from google.protobuf import descriptor_pool
from google.protobuf.internal import builder
{imports}

DESCRIPTOR = descriptor_pool.Default().AddSerializedFile({descriptor!r})
builder.BuildMessageAndEnumDescriptors(DESCRIPTOR, globals())
builder.BuildTopDescriptorsAndMessages(DESCRIPTOR, "{module}", globals())
'''

STUBS = '''"""Generated from {file}."""

import grpc

{imports}
'''

SERVICE = '''

class {name}Stub:
    """Calls {full_name}."""

    def __init__(self, channel):
{calls}


class {name}Servicer:
    """Serves {full_name}."""
{served}

def add_{name}Servicer_to_server(servicer, server):
    """Lets a server serve it."""
    handlers = {{
{handlers}
    }}
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("{full_name}", handlers),))
'''

CALL = """        self.{name} = channel.{kind}(
            "/{service}/{name}",
            request_serializer={request}.SerializeToString,
            response_deserializer={response}.FromString,
        )"""

SERVED = '''
    def {name}(self, request, context):
        """Not served, unless a subclass does."""
        context.abort(grpc.StatusCode.UNIMPLEMENTED, "{name} is not served here")
'''

HANDLER = """        "{name}": grpc.{kind}_rpc_method_handler(
            servicer.{name},
            request_deserializer={request}.FromString,
            response_serializer={response}.SerializeToString,
        ),"""


def generate() -> None:
    """Writes `src/waypost/v1` anew from `proto/waypost/v1`.

    A source distribution has no contract, but what was generated from it. `google/rpc` is not generated:
    googleapis-common-protos has it.
    """
    files = sorted((CONTRACT / "waypost" / "v1").glob("*.proto"))
    if not files and (GENERATED / "__init__.py").exists():
        return
    if not files:
        raise SystemExit(
            f"there is neither a contract in {CONTRACT} nor code generated from one in {GENERATED}: "
            "build waypost from its repository, or from a source distribution that was made there"
        )
    from google.protobuf import descriptor_pb2

    shutil.rmtree(GENERATED, ignore_errors=True)
    GENERATED.mkdir()
    (GENERATED / "__init__.py").write_text('"""The contract, generated from proto/waypost/v1."""\n')
    with TemporaryDirectory() as folder:
        out = Path(folder) / "descriptors"
        compile_contract(files, out)
        descriptors = descriptor_pb2.FileDescriptorSet.FromString(out.read_bytes())
    module_of = {
        f".{file.package}.{message.name}": module_name(file.name).rpartition(".")[2]
        for file in descriptors.file
        for message in file.message_type
    }
    for file in descriptors.file:
        if file.package == "waypost.v1":
            write_module(file, module_of)


def compile_contract(files: list[Path], out: Path) -> None:
    """Writes the types for editors, and all descriptors to `out`."""
    import grpc_tools
    from grpc_tools import protoc

    well_known = Path(grpc_tools.__file__).parent / "_proto"
    arguments = [f"--proto_path={CONTRACT}", f"--proto_path={well_known}", "--include_imports"]
    arguments += [f"--pyi_out={HERE / 'src'}", f"--descriptor_set_out={out}"]
    if protoc.main(["protoc", *arguments, *(str(file.relative_to(CONTRACT)) for file in files)]):
        raise SystemExit(f"the contract in {CONTRACT} does not compile, or {GENERATED} cannot be written")


def write_module(file: Any, module_of: dict[str, str]) -> None:
    """Writes messages and stubs of one file of the contract."""
    module = module_name(file.name)
    path = GENERATED / module.rpartition(".")[2]
    imports = "\n".join(f"import {module_name(name)}  # noqa" for name in file.dependency)
    messages = MESSAGES.format(
        file=file.name, imports=imports, descriptor=file.SerializeToString(), module=module
    )
    path.with_suffix(".py").write_text(messages)
    if not file.service:
        return
    used = {module_of[kind] for service in file.service for m in service.method for kind in types_of(m)}
    text = STUBS.format(file=file.name, imports=f"from waypost.v1 import {', '.join(sorted(used))}")
    for service in file.service:
        full_name = f"{file.package}.{service.name}"
        fields = [method_fields(method, full_name, module_of) for method in service.method]
        text += SERVICE.format(
            name=service.name,
            full_name=full_name,
            calls="\n".join(CALL.format(**values) for values in fields),
            served="".join(SERVED.format(**values) for values in fields),
            handlers="\n".join(HANDLER.format(**values) for values in fields),
        )
    path.with_name(f"{path.name}_grpc.py").write_text(text)


def method_fields(method: Any, service: str, module_of: dict[str, str]) -> dict[str, str]:
    """What a method's templates are filled with."""
    request, response = (f"{module_of[kind]}.{kind.rpartition('.')[2]}" for kind in types_of(method))
    kind = "_".join("stream" if s else "unary" for s in (method.client_streaming, method.server_streaming))
    return {"name": method.name, "service": service, "kind": kind, "request": request, "response": response}


def types_of(method: Any) -> tuple[str, str]:
    """Full names of a method's request and response."""
    return method.input_type, method.output_type


def module_name(file: str) -> str:
    """`waypost.v1.map_pb2` of `waypost/v1/map.proto`."""
    return file.replace(".proto", "_pb2").replace("/", ".")


generate()
setup()
