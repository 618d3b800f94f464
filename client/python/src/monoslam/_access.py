"""What a client shows to a server, and what it asks of it: a token, and certificates."""

from __future__ import annotations

import os
import ssl
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import grpc

from . import _wire
from .errors import AddressError
from .v1.slam_pb2_grpc import SlamServiceStub


@dataclass(frozen=True)
class Access:
    """How to get in."""

    server: _wire.Address
    token: str | None = field(default=None, repr=False)
    ca: bytes | None = None
    """Certificates in PEM that the server's must be or be vouched for by; without any, the system's."""

    @staticmethod
    def of(server: str, token: str | None, ca: str | PathLike[str] | None) -> Access:
        """What is not given is taken from MONOSLAM_TOKEN and MONOSLAM_CA."""
        address = _wire.Address.parse(server)
        token = token if token is not None else os.environ.get("MONOSLAM_TOKEN")
        file = ca if ca is not None else os.environ.get("MONOSLAM_CA")
        try:
            pem = Path(file).read_bytes() if file else None
        except OSError as error:
            raise AddressError(f"the certificates in {file} cannot be read: {error}") from None
        return Access(address, token.strip() if token else None, pem)

    @property
    def is_encrypted(self) -> bool:
        return self.server.scheme == "https"

    def channel(self, grpc_module: Any) -> Any:
        """A channel of `grpc` or `grpc.aio`."""
        if not self.is_encrypted:
            return grpc_module.insecure_channel(self.server.target, options=_wire.CHANNEL_OPTIONS)
        credentials = grpc.ssl_channel_credentials(root_certificates=self.ca)
        return grpc_module.secure_channel(self.server.target, credentials, options=_wire.CHANNEL_OPTIONS)

    @property
    def headers(self) -> dict[str, str]:
        return {"authorization": f"Bearer {self.token}"} if self.token else {}

    def ssl_context(self) -> ssl.SSLContext | None:
        """For HTTP."""
        if not self.is_encrypted:
            return None
        return ssl.create_default_context(cadata=self.ca.decode("ascii") if self.ca else None)


class Calls:
    """The service's calls, each with the token."""

    def __init__(self, channel: Any, access: Access) -> None:
        stub = SlamServiceStub(channel)  # type: ignore[no-untyped-call, unused-ignore]
        for name, call in vars(stub).items():
            setattr(self, name, _Call(call, tuple(access.headers.items())))

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"the service has no call {name}")


class _Call:
    def __init__(self, call: Any, metadata: tuple[tuple[str, str], ...]) -> None:
        self._call, self._metadata = call, metadata

    def __call__(self, request: Any) -> Any:
        return self._call(request, metadata=self._metadata)

    def with_call(self, request: Any) -> Any:
        return self._call.with_call(request, metadata=self._metadata)
