"""The client whose calls wait."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import grpc

from . import _access, _convert, _http, _wire, arrays
from ._ledger import MAX_HELD_BYTES, WINDOW
from ._stream import FrameStream
from .errors import FrameError, MonoslamError, from_rpc_error
from .images import ImageLike
from .model import Answer, Camera, Event, Localization, Session, SessionOptions
from .sources import Frame
from .v1 import slam_pb2 as pb


class Client:
    """A connection to a server, made with the first call. May be used from several threads; a context
    manager."""

    def __init__(
        self,
        server: str = _wire.DEFAULT_SERVER,
        *,
        token: str | None = None,
        ca: str | PathLike[str] | None = None,
    ) -> None:
        """`token` is what `monoslam-server token create` printed, by default that of MONOSLAM_TOKEN; `ca` a file
        of certificates, PEM, that the server's must be or be vouched for by, by default that of MONOSLAM_CA or
        the system's. Raises AddressError if `server` is not `http://HOST:PORT` or `https://HOST:PORT`."""
        self._access = _access.Access.of(server, token, ca)
        self.server = self._access.server
        self._channel = self._access.channel(grpc)
        self._stub: Any = _access.Calls(self._channel, self._access)

    def close(self) -> None:
        """Ends the connection."""
        self._channel.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def create_session(
        self,
        session_id: str,
        camera: Camera | None,
        options: SessionOptions | None = None,
        *,
        map: str = "",
    ) -> Session:
        """Makes a session for one camera; with an empty id the server chooses one. With `map`, a session's id,
        the camera extends that one's map beside its camera and at the same time; it may then be `None` if it is
        like the map's own, and options that concern the map are refused. Raises ExistsError, InvalidError,
        NotFoundError."""
        request = _wire.create_request(session_id, camera, options, map)
        return _convert.session(self._ask(self._stub.CreateSession, request))

    def session(self, session_id: str) -> Session | None:
        """The session as it is now; `None` if there is none."""
        try:
            message = self._ask(self._stub.GetSession, pb.GetSessionRequest(session_id=session_id))
        except MonoslamError as error:
            if getattr(error, "code", "") == "SESSION_NOT_FOUND":
                return None
            raise
        return _convert.session(message)

    def sessions(self) -> list[Session]:
        """All sessions in the order of their ids."""
        found: list[Session] = []
        request = pb.ListSessionsRequest(page_size=_wire.PAGE_SIZE)
        while True:
            page = self._ask(self._stub.ListSessions, request)
            found += map(_convert.session, page.sessions)
            if not page.next_page_token:
                return found
            request.page_token = page.next_page_token

    def delete_session(self, session_id: str) -> None:
        """Deletes a session with its map; one that extends another's map with its trajectory alone. Raises
        NotFoundError, or BusyError while a writer is connected or others extend its map."""
        self._ask(self._stub.DeleteSession, pb.DeleteSessionRequest(session_id=session_id))

    def update_session(self, session_id: str, options: SessionOptions) -> Session:
        """Changes options from the next stream on; what is `None` stays."""
        message = _convert.options_message(options)
        request = pb.UpdateSessionRequest(session_id=session_id, options=message)
        return _convert.session(self._ask(self._stub.UpdateSession, request))

    def set_scale(self, session_id: str, meters_per_unit: float | None) -> Session:
        """Says how many meters a map unit is; `None` frees the scale."""
        request = pb.SetScaleRequest(session_id=session_id, metres_per_unit=meters_per_unit)
        return _convert.session(self._ask(self._stub.SetScale, request))

    def localize(self, session_id: str, image: ImageLike, *, channels: str = "rgb") -> Localization:
        """Locates one image in a stored map without changing it. A place that is not found is an answer."""
        request = _wire.localize_request(session_id, image, channels)
        return _convert.localization(self._ask(self._stub.Localize, request))

    def open_stream(
        self,
        session_id: str,
        *,
        policy: _wire.Policy = "lossless",
        mode: _wire.Mode = "map",
        take_over: bool = False,
        window: int = WINDOW,
        max_held_bytes: int = MAX_HELD_BYTES,
        on_answer: Callable[[Answer], None] | None = None,
    ) -> FrameStream:
        """Opens a stream of frames, to be given one by one. `take_over` ends the stream of a present writer
        instead of raising BusyError. `on_answer` is called with each answer, from a thread of the stream."""
        plan = _wire.StreamPlan(session_id, policy, mode, take_over)
        return FrameStream(
            self._stub,
            self.server,
            plan,
            window=window,
            max_held_bytes=max_held_bytes,
            on_answer=on_answer,
        )

    def stream(
        self,
        session_id: str,
        frames: Iterable[Frame],
        *,
        policy: _wire.Policy = "lossless",
        mode: _wire.Mode = "map",
        take_over: bool = False,
        resume: bool = False,
    ) -> Iterator[Answer]:
        """Streams frames and yields each one's answer; ends when all are answered and in the server's
        database.

        Frames are taken as the server tracks them. `resume` leaves out those that are not later than the
        session's last frame: the same recording goes on where it ended.
        """
        with self.open_stream(session_id, policy=policy, mode=mode, take_over=take_over) as stream:
            known_ns = stream.session.last_timestamp_ns if resume else None
            feeding = threading.Thread(target=_feed, args=(stream, frames, known_ns), daemon=True)
            feeding.start()
            yield from stream

    def watch(self, session_id: str) -> Iterator[Event]:
        """What happens in a session: the session first, then events as they come, until the server shuts
        down."""
        call = self._stub.WatchMap(pb.WatchMapRequest(session_id=session_id))
        try:
            for message in self._read(call):
                yield _convert.event(message)
        finally:
            call.cancel()

    def points(
        self,
        session_id: str,
        *,
        bbox: Any | None = None,
        near: Any | None = None,
        radius: float | None = None,
        min_observations: int = 0,
        submap_id: int | None = None,
    ) -> arrays.Points:
        """Points of the stored map; every condition given must hold. `bbox` is two corners, `near` needs
        `radius`."""
        region = _wire.region(bbox, near, radius, min_observations, submap_id)
        request = pb.QueryPointsRequest(session_id=session_id, **region)
        return arrays.points(self._read(self._stub.QueryPoints(request)))

    def lines(
        self,
        session_id: str,
        *,
        bbox: Any | None = None,
        near: Any | None = None,
        radius: float | None = None,
        min_observations: int = 0,
        submap_id: int | None = None,
        primitive_id: int | None = None,
    ) -> arrays.Lines:
        """Lines of the stored map, conditions as for points; `primitive_id`: those of this direction."""
        region = _wire.region(bbox, near, radius, min_observations, submap_id)
        request = pb.QueryLinesRequest(session_id=session_id, primitive_id=primitive_id, **region)
        return arrays.lines(self._read(self._stub.QueryLines(request)))

    def primitives(self, session_id: str, *, submap_id: int | None = None) -> arrays.Primitives:
        """Global primitives of the stored map."""
        request = pb.ListPrimitivesRequest(session_id=session_id, submap_id=submap_id)
        return arrays.primitives(self._read(self._stub.ListPrimitives(request)))

    def keyframes(self, session_id: str) -> arrays.Keyframes:
        """Keyframes of the stored map."""
        request = pb.ListKeyframesRequest(session_id=session_id)
        return arrays.keyframes(self._read(self._stub.ListKeyframes(request)))

    def trajectory(
        self, session_id: str, *, keyframes: bool = False, submap: int | str | None = None
    ) -> arrays.Trajectory:
        """Poses of all frames that have one, or of keyframes only, as the map stands now.

        Submaps do not share a frame of reference: `submap` is the number of one, "largest" or "all" (the
        default); `n_left_out` of the answer says how many poses are in the others.
        """
        kind = pb.TRAJECTORY_KIND_KEYFRAMES if keyframes else pb.TRAJECTORY_KIND_FRAMES
        request = _wire.trajectory_request(session_id, kind, submap)
        return arrays.trajectory(self._read(self._stub.GetTrajectory(request)))

    def map(self, session_id: str) -> arrays.Map:
        """Everything above at once."""
        return arrays.Map(
            points=self.points(session_id),
            lines=self.lines(session_id),
            primitives=self.primitives(session_id),
            keyframes=self.keyframes(session_id),
            trajectory=self.trajectory(session_id),
        )

    def keyframe_image(self, session_id: str, keyframe_id: int) -> bytes:
        """A keyframe's image as it was sent, PNG or JPEG (raw pixels come as PNG). Asked of the HTTP
        interface."""
        return _http.keyframe_image(self.http_address(), self._access, session_id, keyframe_id)

    def export(
        self,
        session_id: str,
        format: _wire.MapFormat,
        path: str | PathLike[str],
        *,
        submap_id: int | None = None,
    ) -> list[Path]:
        """Writes the map to a file of that path: "ply", "json", "mcap" for Foxglove, "transforms" for nerfstudio;
        "colmap" as three text files into a folder of that path. Returns what was written."""
        written: list[Path] = []
        for number in _wire.FORMATS[format]:
            request = pb.ExportMapRequest(session_id=session_id, format=number, submap_id=submap_id)
            parts = self._read(self._stub.ExportMap(request))
            name = next(parts).file.name
            target = _wire.export_path(format, path, name)
            with target.open("wb") as file:
                file.writelines(part.data for part in parts)
            written.append(target)
        return written

    def http_address(self) -> str:
        """The server's HTTP interface: on the same host, at the port the server tells."""
        request = pb.ListSessionsRequest(page_size=1)
        try:
            _, call = self._stub.ListSessions.with_call(request)
        except grpc.RpcError as error:
            raise from_rpc_error(str(self.server), error) from None
        return self.server.http(_wire.http_port(call.initial_metadata()))

    def _ask(self, method: Any, request: Any) -> Any:
        try:
            return method(request)
        except grpc.RpcError as error:
            raise from_rpc_error(str(self.server), error) from None

    def _read(self, call: Any) -> Iterator[Any]:
        try:
            yield from call
        except grpc.RpcError as error:
            raise from_rpc_error(str(self.server), error) from None


def _feed(stream: FrameStream, frames: Iterable[Frame], known_ns: int | None) -> None:
    """Gives a stream its frames; if they cannot be had, whoever reads the stream is told."""
    try:
        for frame in frames:
            if known_ns is None or frame.timestamp_ns > known_ns:
                stream.send(frame)
        stream.finish()
    except FrameError as error:
        stream.fail(error)
    except MonoslamError:
        pass  # The stream has ended, and its reader knows why.
    except Exception as error:  # whatever the caller's frames raise
        failure = FrameError(f"the source of frames failed: {error!r}")
        failure.__cause__ = error
        stream.fail(failure)
