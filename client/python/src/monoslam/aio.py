"""The client for asyncio: the same calls, to be awaited.

async with AsyncClient("http://127.0.0.1:50051") as client:
    async for answer in client.stream("kitchen", Folder.open("path/to/recording")):
        print(answer.sequence, answer.pose)
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, AsyncIterator, Iterable
from os import PathLike
from pathlib import Path
from typing import Any

import grpc
import grpc.aio

from . import _access, _convert, _http, _wire, arrays
from ._async_stream import AsyncFrameStream
from ._ledger import MAX_HELD_BYTES, WINDOW
from .errors import FrameError, MonoslamError, from_rpc_error
from .images import ImageLike
from .model import Answer, Camera, Event, Localization, Session, SessionOptions
from .sources import Frame
from .v1 import slam_pb2 as pb

__all__ = ["AsyncClient", "AsyncFrameStream"]

_END = object()


class AsyncClient:
    """As `Client`, each call a coroutine. Make it inside a running event loop."""

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
        self._channel = self._access.channel(grpc.aio)
        self._stub: Any = _access.Calls(self._channel, self._access)

    async def close(self) -> None:
        """Ends the connection."""
        await self._channel.close()

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def create_session(
        self,
        session_id: str,
        camera: Camera | None,
        options: SessionOptions | None = None,
        *,
        map: str = "",
    ) -> Session:
        """See `Client.create_session`."""
        request = _wire.create_request(session_id, camera, options, map)
        return _convert.session(await self._ask(self._stub.CreateSession, request))

    async def session(self, session_id: str) -> Session | None:
        """See `Client.session`."""
        try:
            request = pb.GetSessionRequest(session_id=session_id)
            return _convert.session(await self._ask(self._stub.GetSession, request))
        except MonoslamError as error:
            if getattr(error, "code", "") == "SESSION_NOT_FOUND":
                return None
            raise

    async def sessions(self) -> list[Session]:
        """See `Client.sessions`."""
        found: list[Session] = []
        request = pb.ListSessionsRequest(page_size=_wire.PAGE_SIZE)
        while True:
            page = await self._ask(self._stub.ListSessions, request)
            found += map(_convert.session, page.sessions)
            if not page.next_page_token:
                return found
            request.page_token = page.next_page_token

    async def delete_session(self, session_id: str) -> None:
        """See `Client.delete_session`."""
        await self._ask(self._stub.DeleteSession, pb.DeleteSessionRequest(session_id=session_id))

    async def update_session(self, session_id: str, options: SessionOptions) -> Session:
        """See `Client.update_session`."""
        message = _convert.options_message(options)
        request = pb.UpdateSessionRequest(session_id=session_id, options=message)
        return _convert.session(await self._ask(self._stub.UpdateSession, request))

    async def set_scale(self, session_id: str, meters_per_unit: float | None) -> Session:
        """See `Client.set_scale`."""
        request = pb.SetScaleRequest(session_id=session_id, metres_per_unit=meters_per_unit)
        return _convert.session(await self._ask(self._stub.SetScale, request))

    async def localize(self, session_id: str, image: ImageLike, *, channels: str = "rgb") -> Localization:
        """See `Client.localize`."""
        request = await asyncio.to_thread(_wire.localize_request, session_id, image, channels)
        return _convert.localization(await self._ask(self._stub.Localize, request))

    async def open_stream(
        self,
        session_id: str,
        *,
        policy: _wire.Policy = "lossless",
        mode: _wire.Mode = "map",
        take_over: bool = False,
        window: int = WINDOW,
        max_held_bytes: int = MAX_HELD_BYTES,
    ) -> AsyncFrameStream:
        """See `Client.open_stream`: `async with await client.open_stream(…) as stream`."""
        plan = _wire.StreamPlan(session_id, policy, mode, take_over)
        stream = AsyncFrameStream(self._stub, self.server, plan, window=window, max_held_bytes=max_held_bytes)
        await stream.opened()
        return stream

    async def stream(
        self,
        session_id: str,
        frames: Iterable[Frame] | AsyncIterable[Frame],
        *,
        policy: _wire.Policy = "lossless",
        mode: _wire.Mode = "map",
        take_over: bool = False,
        resume: bool = False,
    ) -> AsyncIterator[Answer]:
        """See `Client.stream`. Frames that are not asynchronous are fetched in a thread, so that they may
        block."""
        async with await self.open_stream(
            session_id, policy=policy, mode=mode, take_over=take_over
        ) as stream:
            known_ns = stream.session.last_timestamp_ns if resume else None
            feeding = asyncio.create_task(_feed(stream, frames, known_ns))
            try:
                async for answer in stream:
                    yield answer
            finally:
                feeding.cancel()
                await asyncio.gather(feeding, return_exceptions=True)

    async def watch(self, session_id: str) -> AsyncIterator[Event]:
        """See `Client.watch`."""
        call = self._stub.WatchMap(pb.WatchMapRequest(session_id=session_id))
        try:
            async for message in self._read(call):
                yield _convert.event(message)
        finally:
            call.cancel()

    async def points(
        self,
        session_id: str,
        *,
        bbox: Any | None = None,
        near: Any | None = None,
        radius: float | None = None,
        min_observations: int = 0,
        submap_id: int | None = None,
    ) -> arrays.Points:
        """See `Client.points`."""
        region = _wire.region(bbox, near, radius, min_observations, submap_id)
        request = pb.QueryPointsRequest(session_id=session_id, **region)
        return arrays.points(await self._all(self._stub.QueryPoints(request)))

    async def lines(
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
        """See `Client.lines`."""
        region = _wire.region(bbox, near, radius, min_observations, submap_id)
        request = pb.QueryLinesRequest(session_id=session_id, primitive_id=primitive_id, **region)
        return arrays.lines(await self._all(self._stub.QueryLines(request)))

    async def primitives(self, session_id: str, *, submap_id: int | None = None) -> arrays.Primitives:
        """See `Client.primitives`."""
        request = pb.ListPrimitivesRequest(session_id=session_id, submap_id=submap_id)
        return arrays.primitives(await self._all(self._stub.ListPrimitives(request)))

    async def keyframes(self, session_id: str) -> arrays.Keyframes:
        """See `Client.keyframes`."""
        request = pb.ListKeyframesRequest(session_id=session_id)
        return arrays.keyframes(await self._all(self._stub.ListKeyframes(request)))

    async def trajectory(
        self, session_id: str, *, keyframes: bool = False, submap: int | str | None = None
    ) -> arrays.Trajectory:
        """See `Client.trajectory`."""
        kind = pb.TRAJECTORY_KIND_KEYFRAMES if keyframes else pb.TRAJECTORY_KIND_FRAMES
        request = _wire.trajectory_request(session_id, kind, submap)
        return arrays.trajectory(await self._all(self._stub.GetTrajectory(request)))

    async def map(self, session_id: str) -> arrays.Map:
        """See `Client.map`."""
        return arrays.Map(
            points=await self.points(session_id),
            lines=await self.lines(session_id),
            primitives=await self.primitives(session_id),
            keyframes=await self.keyframes(session_id),
            trajectory=await self.trajectory(session_id),
        )

    async def keyframe_image(self, session_id: str, keyframe_id: int) -> bytes:
        """See `Client.keyframe_image`."""
        http = await self.http_address()
        return await asyncio.to_thread(_http.keyframe_image, http, self._access, session_id, keyframe_id)

    async def export(
        self,
        session_id: str,
        format: _wire.MapFormat,
        path: str | PathLike[str],
        *,
        submap_id: int | None = None,
    ) -> list[Path]:
        """See `Client.export`."""
        written: list[Path] = []
        for number in _wire.FORMATS[format]:
            request = pb.ExportMapRequest(session_id=session_id, format=number, submap_id=submap_id)
            parts = self._read(self._stub.ExportMap(request))
            target = _wire.export_path(format, path, (await anext(parts)).file.name)
            with target.open("wb") as file:
                async for part in parts:
                    file.write(part.data)
            written.append(target)
        return written

    async def http_address(self) -> str:
        """See `Client.http_address`."""
        call = self._stub.ListSessions(pb.ListSessionsRequest(page_size=1))
        try:
            await call
            return self.server.http(_wire.http_port(await call.initial_metadata()))
        except grpc.RpcError as error:
            raise from_rpc_error(str(self.server), error) from None

    async def _ask(self, method: Any, request: Any) -> Any:
        try:
            return await method(request)
        except grpc.RpcError as error:
            raise from_rpc_error(str(self.server), error) from None

    async def _read(self, call: Any) -> AsyncIterator[Any]:
        try:
            async for message in call:
                yield message
        except grpc.RpcError as error:
            raise from_rpc_error(str(self.server), error) from None

    async def _all(self, call: Any) -> list[Any]:
        return [message async for message in self._read(call)]


async def _feed(
    stream: AsyncFrameStream, frames: Iterable[Frame] | AsyncIterable[Frame], known_ns: int | None
) -> None:
    """Gives a stream its frames; if they cannot be had, whoever reads the stream is told."""
    try:
        async for frame in frames if isinstance(frames, AsyncIterable) else _in_thread(frames):
            if known_ns is None or frame.timestamp_ns > known_ns:
                await stream.send(frame)
        await stream.finish()
    except FrameError as error:
        await stream.fail(error)
    except MonoslamError:
        pass  # The stream has ended, and its reader knows why.
    except Exception as error:  # whatever the caller's frames raise
        failure = FrameError(f"the source of frames failed: {error!r}")
        failure.__cause__ = error
        await stream.fail(failure)


async def _in_thread(frames: Iterable[Frame]) -> AsyncIterator[Frame]:
    """The frames, each fetched in a thread: reading a camera blocks."""
    iterator = iter(frames)
    while (frame := await asyncio.to_thread(next, iterator, _END)) is not _END:
        assert isinstance(frame, Frame), "frames are of the class Frame"
        yield frame
