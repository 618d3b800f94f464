"""A real server, built by `cargo build`, and rendered frames to stream into it.

PROGRAMS_DIR names the folder of the programs; by default the repository's target/debug.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from monoslam import Client, Folder

REPOSITORY = Path(__file__).resolve().parents[3]
PROGRAMS = Path(os.environ.get("PROGRAMS_DIR", REPOSITORY / "target" / "debug"))
EXAMPLES = REPOSITORY / "client" / "python" / "examples"

SERVING = re.compile(r"serving gRPC on (\S+) and HTTP on (\S+)")


def program(name: str) -> Path:
    path = PROGRAMS / name
    if not path.exists():
        pytest.skip(f"{path} is not built: cargo build --workspace --all-targets")
    return path


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Server:
    """A server process over a folder; it can be killed and started again at the same address."""

    def __init__(self, data_dir: Path, options: list[str] | None = None) -> None:
        self.data_dir = data_dir
        self.options = options or []
        self.grpc = f"127.0.0.1:{free_port()}"
        self.http = f"127.0.0.1:{free_port()}"
        self.process: subprocess.Popen[str] | None = None
        self.start()

    def start(self) -> None:
        options = ["--grpc-addr", self.grpc, "--http-addr", self.http, "--data-dir", str(self.data_dir), *self.options]
        log = (self.data_dir.parent / "server.log").open("a+")
        began = log.seek(0, os.SEEK_END)
        self.process = subprocess.Popen([program("monoslam-server"), *options], stderr=log, text=True)
        for _ in range(1000):
            log.seek(began)
            if SERVING.search(log.read()):
                log.close()
                return
            assert self.process.poll() is None, "the server ended"
            try:
                self.process.wait(0.02)
            except subprocess.TimeoutExpired:
                pass
        raise AssertionError("the server does not say that it serves")

    def kill(self) -> None:
        """SIGKILL."""
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def stop(self) -> None:
        assert self.process is not None
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.kill()

    @property
    def address(self) -> str:
        return f"http://{self.grpc}"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    server = Server(tmp_path / "data")
    yield server
    server.stop()


@pytest.fixture
def client(server: Server) -> Iterator[Client]:
    with Client(server.address) as client:
        yield client


N_FRAMES = 75


@pytest.fixture(scope="session")
def room_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rendered room with its truth, in the layout `folder`."""
    folder = tmp_path_factory.mktemp("recordings") / "room"
    options = ["--preset", "room-rich", "--seed", "1", "--frames", str(N_FRAMES), "--threads", "2"]
    command = [program("examples/render"), *options, "--out", folder]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return folder


@pytest.fixture(scope="session")
def room(room_path: Path) -> Folder:
    return Folder.open(room_path)


class Mapped:
    """A server that has streamed the room, shared by tests that only read."""

    def __init__(self, server: Server, client: Client, room: Folder) -> None:
        self.server, self.client, self.room, self.id = server, client, room, "room"
        client.create_session(self.id, room.camera)
        self.answers = list(client.stream(self.id, room))


@pytest.fixture(scope="session")
def mapped(tmp_path_factory: pytest.TempPathFactory, room: Folder) -> Iterator[Mapped]:
    server = Server(tmp_path_factory.mktemp("mapped") / "data")
    with Client(server.address) as client:
        yield Mapped(server, client, room)
    server.stop()
