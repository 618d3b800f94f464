"""What goes wrong between a client and its server. Every error's text is a sentence to be read."""

from __future__ import annotations

from dataclasses import dataclass

import grpc
from google.rpc import error_details_pb2, status_pb2

_DETAILS_HEADER = "grpc-status-details-bin"

# What gRPC makes of a connection that broke or never was; the server's own errors carry an ErrorInfo.
_OF_CONNECTION = {
    grpc.StatusCode.UNAVAILABLE,
    grpc.StatusCode.UNKNOWN,
    grpc.StatusCode.INTERNAL,
    grpc.StatusCode.CANCELLED,
}


class MonoslamError(Exception):
    """The base of all errors of this package."""

    @property
    def is_passing(self) -> bool:
        """Whether the same request may succeed later."""
        return False


class AddressError(MonoslamError):
    """The address is not one."""


class UnreachableError(MonoslamError):
    """The server cannot be reached, or the connection broke."""

    @property
    def is_passing(self) -> bool:
        return True


class ProtocolError(MonoslamError):
    """The server answered what the contract does not allow."""


class FrameError(MonoslamError):
    """A frame cannot be read or sent; nothing of it was streamed."""


@dataclass(frozen=True)
class Violation:
    """One field that is wrong."""

    field: str
    """Its path, such as `camera.fx`."""
    description: str
    """What is wrong with it, in a plain sentence."""


class RefusedError(MonoslamError):
    """The server said no."""

    def __init__(self, message: str, code: str, violations: tuple[Violation, ...] = ()) -> None:
        super().__init__(message)
        self.code = code
        """The stable name of the kind of error, such as `SESSION_EXISTS`."""
        self.violations = violations
        """The fields that are wrong."""

    @property
    def is_passing(self) -> bool:
        of_server = ("SHUTTING_DOWN", "STORAGE_FAILED", "OBJECTS_FAILED", "UNAVAILABLE")
        of_fleet = ("OWNED_ELSEWHERE", "OWNER_UNREACHABLE", "LEASE_LOST")
        return self.code in of_server or self.code in of_fleet


class NotFoundError(RefusedError):
    """There is no such session, keyframe or image."""


class ExistsError(RefusedError):
    """The session exists already."""


class InvalidError(RefusedError):
    """Something in the request cannot be used; `violations` says what."""


class BusyError(RefusedError):
    """Another writer is connected, other sessions extend the map, or the server has as much to do as it takes."""


_KINDS: dict[grpc.StatusCode, type[RefusedError]] = {
    grpc.StatusCode.NOT_FOUND: NotFoundError,
    grpc.StatusCode.ALREADY_EXISTS: ExistsError,
    grpc.StatusCode.INVALID_ARGUMENT: InvalidError,
}
_BUSY = {"WRITER_CONNECTED", "MAP_SHARED", "TOO_MANY_SESSIONS", "TOO_MANY_LOADED_SESSIONS", "TOO_BUSY"}


def from_rpc_error(server: str, error: grpc.RpcError) -> MonoslamError:
    """Sorts a failed call into what the server said and what befell the connection."""
    status: grpc.StatusCode = error.code()
    message: str = error.details() or status.name
    code, violations = _details(error)
    if code is None and ("HTTP status: 4" in message or "http2 status: 4" in message):
        return ProtocolError(
            f"what answers at {server} does not speak gRPC; is it the address of the HTTP interface?"
        )
    if code is None and status in _OF_CONNECTION:
        return UnreachableError(f"the server at {server} cannot be reached: {message}")
    kind = BusyError if code in _BUSY else _KINDS.get(status, RefusedError)
    return kind(message, code or status.name, violations)


def _details(error: grpc.RpcError) -> tuple[str | None, tuple[Violation, ...]]:
    """The server's code and violations, as google.rpc.Status carries them."""
    code: str | None = None
    violations: list[Violation] = []
    for key, value in error.trailing_metadata() or ():
        if key != _DETAILS_HEADER:
            continue
        status = status_pb2.Status.FromString(value)
        for detail in status.details:
            info, bad = error_details_pb2.ErrorInfo(), error_details_pb2.BadRequest()
            if detail.Unpack(info):
                code = info.reason
            elif detail.Unpack(bad):
                violations += [Violation(v.field, v.description) for v in bad.field_violations]
    return code, tuple(violations)
