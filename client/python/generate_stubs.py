#!/usr/bin/env python3
"""Writes src/monoslam/v1 from the gRPC contract; with --check, says whether it is stale.

Needs grpcio-tools of the version that pyproject.toml names: pip install './client/python[stubs]'.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from grpc_tools import protoc

PACKAGE = Path(__file__).resolve().parent
CONTRACTS = PACKAGE.parents[1] / "proto"
CONTRACT = "monoslam/v1/slam.proto"
SUFFIXES = ["_pb2.py", "_pb2.pyi", "_pb2_grpc.py"]


def generate(out: Path) -> None:
    options = [f"--python_out={out}", f"--pyi_out={out}", f"--grpc_python_out={out}"]
    if protoc.main(["protoc", f"-I{CONTRACTS}", *options, CONTRACT]) != 0:
        sys.exit("protoc failed")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; fail if the files are stale")
    if not parser.parse_args().check:
        generate(PACKAGE / "src")
        return
    stem = CONTRACT.removesuffix(".proto")
    with tempfile.TemporaryDirectory() as folder:
        generate(Path(folder))
        names = [stem + suffix for suffix in SUFFIXES]
        stale = [n for n in names if (Path(folder) / n).read_bytes() != (PACKAGE / "src" / n).read_bytes()]
    if stale:
        sys.exit(f"stale: {', '.join(stale)}; run python client/python/generate_stubs.py and commit them")


if __name__ == "__main__":
    main()
