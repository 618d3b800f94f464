"""What the synchronous and the asynchronous client share: addresses, requests, waits."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

from . import _convert, images
from .errors import AddressError, FrameError, ProtocolError
from .model import Camera, Session, SessionOptions
from .sources import Frame
from .v1 import slam_pb2 as pb

DEFAULT_SERVER = "http://127.0.0.1:50051"
DEFAULT_HTTP_PORT = 8080
HTTP_PORT_HEADER = "x-monoslam-http-port"
"""In which the server tells the port of its HTTP interface with every answer."""

MAX_ATTEMPTS = 16
"""Attempts at a connection without a frame answered in between, before a stream is given up. With the waits
below about a minute, long enough for a server to start again and load a session."""
FIRST_BACKOFF_S = 0.2
MAX_BACKOFF_S = 5.0

DURABLE_TIMEOUT_S = 60.0
"""How long the server may take after the last answer to have everything in its database."""
DURABLE_POLL_S = 0.02

MAX_UNREAD = 10_000
"""Answers that wait to be read, at most: beyond it, sending is refused."""

PAGE_SIZE = 1000

CHANNEL_OPTIONS = [
    # Whole maps come in pieces; a keyframe's image or an export may be larger than gRPC's 4 MB.
    ("grpc.max_receive_message_length", -1),
    ("grpc.max_send_message_length", -1),
    # A server that does not answer a ping for this long is gone.
    ("grpc.keepalive_time_ms", 10_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    # The stream has its own waits; gRPC's, of up to two minutes, would come on top.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.min_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1_000),
    ("grpc.use_local_subchannel_pool", 1),
]

Policy = Literal["lossless", "realtime"]
"""What the server does with frames that come faster than it tracks: hold the client back, or drop the
oldest."""
Mode = Literal["map", "localize"]
"""Whether frames extend the map, or are only located in it."""
MapFormat = Literal["ply", "json", "colmap", "mcap", "transforms"]

_POLICIES = {"lossless": pb.STREAM_POLICY_LOSSLESS, "realtime": pb.STREAM_POLICY_REALTIME}
_MODES = {"map": pb.STREAM_MODE_MAP_AND_LOCALIZE, "localize": pb.STREAM_MODE_LOCALIZE_ONLY}
FORMATS = {
    "ply": [pb.MAP_FORMAT_PLY],
    "json": [pb.MAP_FORMAT_JSON],
    "mcap": [pb.MAP_FORMAT_MCAP],
    "transforms": [pb.MAP_FORMAT_TRANSFORMS],
    "colmap": [pb.MAP_FORMAT_COLMAP_CAMERAS, pb.MAP_FORMAT_COLMAP_IMAGES, pb.MAP_FORMAT_COLMAP_POINTS3D],
}


@dataclass(frozen=True)
class Address:
    """Where a server's gRPC interface is."""

    host: str
    port: int
    scheme: str = "http"

    @staticmethod
    def parse(text: str) -> Address:
        """Of `http://HOST:PORT`, `https://HOST:PORT` or `HOST:PORT`."""
        try:
            parts = urlsplit(text if "://" in text else f"http://{text}")
            host, port = parts.hostname, parts.port
        except ValueError:
            host, port, parts = None, None, urlsplit("")
        if parts.scheme not in ("http", "https") or not host or not port or parts.path not in ("", "/"):
            raise AddressError(f"`{text}` is not the address of a server: http[s]://HOST:PORT expected")
        return Address(host, port, parts.scheme)

    @property
    def target(self) -> str:
        """As gRPC wants it."""
        return f"{self._bracketed}:{self.port}"

    def http(self, port: int) -> str:
        """The HTTP interface on the same host."""
        return f"{self.scheme}://{self._bracketed}:{port}"

    @property
    def _bracketed(self) -> str:
        return f"[{self.host}]" if ":" in self.host else self.host

    def __str__(self) -> str:
        return self.http(self.port)


@dataclass(frozen=True)
class StreamPlan:
    """What to stream into, and how."""

    session_id: str
    policy: Policy
    mode: Mode
    take_over: bool

    def __post_init__(self) -> None:
        if self.policy not in _POLICIES or self.mode not in _MODES:
            raise ValueError('policy is "lossless" or "realtime", mode is "map" or "localize"')

    def open_message(self, again: bool) -> pb.StreamFramesRequest:
        """The first message of a connection; at a further one the server may not know yet that the last is
        gone."""
        return pb.StreamFramesRequest(
            open=pb.OpenStream(
                session_id=self.session_id,
                policy=_POLICIES[self.policy],
                mode=_MODES[self.mode],
                take_over=self.take_over or again,
            )
        )


def frame_message(sequence: int, frame: Frame) -> pb.StreamFramesRequest:
    """Raises FrameError if the image cannot be read."""
    try:
        image = images.message(frame.image, frame.channels)
    except FrameError as error:
        raise FrameError(f"frame {sequence}: {error}") from error
    return pb.StreamFramesRequest(
        frame=pb.Frame(sequence=sequence, timestamp_ns=frame.timestamp_ns, image=image)
    )


def opened_session(response: pb.StreamFramesResponse | None) -> Session:
    if response is None or response.WhichOneof("message") != "opened":
        raise ProtocolError("the server's answer cannot be used: a stream must begin with `opened`")
    return _convert.session(response.opened.session)


def backoff_s(n_attempts: int) -> float:
    return float(min(FIRST_BACKOFF_S * 2 ** min(n_attempts - 1, 30), MAX_BACKOFF_S))


def create_request(
    session_id: str, camera: Camera | None, options: SessionOptions | None, map: str
) -> pb.CreateSessionRequest:
    return pb.CreateSessionRequest(
        session_id=session_id,
        camera=None if camera is None else _convert.camera_message(camera),
        options=_convert.options_message(options),
        map=map,
    )


def localize_request(session_id: str, image: images.ImageLike, channels: str) -> pb.LocalizeRequest:
    return pb.LocalizeRequest(session_id=session_id, image=images.message(image, channels))


def trajectory_request(session_id: str, kind: Any, submap: int | str | None) -> pb.GetTrajectoryRequest:
    """The trajectory of one submap, of the largest, or of all."""
    request = pb.GetTrajectoryRequest(session_id=session_id, kind=kind)
    if submap == "largest":
        request.submaps = pb.SUBMAP_SELECTION_LARGEST
    elif isinstance(submap, int):
        request.submap_id = submap
    elif submap not in (None, "all"):
        raise ValueError(f'{submap!r} is no choice of submaps: a number, "largest" or "all"')
    return request


def region(
    bbox: Any | None, near: Any | None, radius: float | None, min_observations: int, submap_id: int | None
) -> dict[str, Any]:
    """The conditions that questions for points and for lines share; corners and places as three numbers."""
    given: dict[str, Any] = {"min_observations": min_observations, "radius": radius, "submap_id": submap_id}
    if bbox is not None:
        low, high = (_vector(corner) for corner in bbox)
        given["bbox"] = pb.BoundingBox(min=low, max=high)
    if near is not None:
        given["near"] = _vector(near)
    return {name: value for name, value in given.items() if value is not None}


def http_port(metadata: Any) -> int:
    """The port of the HTTP interface, as the headers of an answer tell it."""
    told = dict(metadata or ()).get(HTTP_PORT_HEADER, "")
    return int(told) if str(told).isdigit() else DEFAULT_HTTP_PORT


def _vector(numbers: Any) -> pb.Vector3:
    x, y, z = (float(number) for number in numbers)
    return pb.Vector3(x=x, y=y, z=z)


def export_path(format: MapFormat, path: str | PathLike[str], name: str) -> Path:
    """Where a file of an export goes; a model of several files goes into a folder, made if it is not
    there."""
    if format != "colmap":
        return Path(path)
    Path(path).mkdir(parents=True, exist_ok=True)
    # The server's name, but never a path out of the folder.
    return Path(path) / Path(name).name
