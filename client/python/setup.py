"""Generates `waypost.v1` from the contract before anything is built; all else is in pyproject.toml.

The package named as the contract's is what makes the generated imports (`from waypost.v1 import …`) right.
"""

import shutil
from pathlib import Path

from setuptools import setup

HERE = Path(__file__).resolve().parent
CONTRACT = HERE.parent.parent / "proto"
GENERATED = HERE / "src" / "waypost" / "v1"


def generate() -> None:
    """Writes `src/waypost/v1` anew from `proto/waypost/v1`.

    `google/rpc` is not generated: googleapis-common-protos has it.
    """
    import grpc_tools
    from grpc_tools import protoc

    files = sorted((CONTRACT / "waypost" / "v1").glob("*.proto"))
    if not files:
        raise SystemExit(f"waypost is built from its repository: there is no contract in {CONTRACT}")
    shutil.rmtree(GENERATED, ignore_errors=True)
    GENERATED.mkdir()
    (GENERATED / "__init__.py").write_text('"""The contract, generated from proto/waypost/v1."""\n')
    out = HERE / "src"
    well_known = Path(grpc_tools.__file__).parent / "_proto"
    arguments = [f"--proto_path={CONTRACT}", f"--proto_path={well_known}"]
    arguments += [f"--{kind}_out={out}" for kind in ("python", "pyi", "grpc_python")]
    failed = protoc.main(["protoc", *arguments, *(str(file.relative_to(CONTRACT)) for file in files)])
    if failed:
        raise SystemExit(f"the contract in {CONTRACT} does not compile, or {out} cannot be written")


generate()
setup()
