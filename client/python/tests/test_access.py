"""Tokens and certificates, against a real server."""

from __future__ import annotations

import asyncio
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from monoslam import Camera, Client, MonoslamError
from monoslam.aio import AsyncClient

from conftest import Server, program

CAMERA = Camera.from_field_of_view(320, 240, 60.0)


def token(data_dir: Path, name: str, role: str, *options: str) -> str:
    command = [program("monoslam-server"), "token", "create", name, "--role", role, *options, "--data-dir", data_dir]
    made = subprocess.run(command, check=True, capture_output=True, text=True)
    return made.stdout.strip()


@pytest.fixture
def certificate(tmp_path: Path) -> Path:
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("there is no openssl to make a certificate with")
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    subject = ["-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1"]
    command = [openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", *subject]
    subprocess.run([*command, "-out", cert, "-keyout", key], check=True, capture_output=True)
    return cert


@pytest.fixture
def encrypted(tmp_path: Path, certificate: Path) -> Iterator[Server]:
    options = ["--tls-cert", str(certificate), "--tls-key", str(certificate.with_name("key.pem"))]
    server = Server(tmp_path / "data", options)
    yield server
    server.stop()


def test_a_token_opens_an_encrypted_server(encrypted: Server, certificate: Path) -> None:
    address = f"https://{encrypted.grpc}"
    writer = token(encrypted.data_dir, "robot", "writer")
    reader = token(encrypted.data_dir, "screen", "reader", "--owner", "robot")
    # The server notices new tokens within a second.
    with Client(address, token=writer, ca=certificate) as client:
        for attempt in range(50):
            try:
                client.create_session("kitchen", CAMERA)
                break
            except MonoslamError as error:
                assert getattr(error, "code", "") == "UNAUTHENTICATED" and attempt < 49
                time.sleep(0.1)
    with Client(address, token=reader, ca=certificate) as client:
        assert [session.id for session in client.sessions()] == ["kitchen"]
        with pytest.raises(MonoslamError, match="role writer"):
            client.delete_session("kitchen")
        with pytest.raises(MonoslamError, match="has no keyframe|not kept"):
            client.keyframe_image("kitchen", 1)
    with Client(address, ca=certificate) as client, pytest.raises(MonoslamError, match="token is needed"):
        client.sessions()

    async def asynchronously() -> list[str]:
        async with AsyncClient(address, token=reader, ca=certificate) as client:
            return [session.id for session in await client.sessions()]

    assert asyncio.run(asynchronously()) == ["kitchen"]
