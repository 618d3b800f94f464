"""A stream of frames for asyncio: what `_stream` does with threads, with tasks."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import AsyncIterator
from typing import Any

import grpc
import grpc.aio

from . import _convert
from ._ledger import MAX_HELD_BYTES, WINDOW, Ledger
from ._wire import (
    DURABLE_POLL_S,
    DURABLE_TIMEOUT_S,
    MAX_ATTEMPTS,
    MAX_UNREAD,
    Address,
    StreamPlan,
    backoff_s,
    frame_message,
    opened_session,
)
from .errors import FrameError, MonoslamError, ProtocolError, UnreachableError, from_rpc_error
from .model import Answer, Session
from .sources import Frame
from .v1 import slam_pb2 as pb

_log = logging.getLogger("monoslam")


class AsyncFrameStream:
    """As `FrameStream`: `await send(…)` frames and iterate for answers, in one task or two."""

    def __init__(
        self,
        stub: Any,
        server: Address,
        plan: StreamPlan,
        *,
        window: int = WINDOW,
        max_held_bytes: int = MAX_HELD_BYTES,
    ) -> None:
        self._stub, self._server, self._plan = stub, server, plan
        self._ledger = Ledger(window, max_held_bytes)
        self._changed = asyncio.Condition()
        self._unread: deque[Answer] = deque()
        self._session: Session | None = None
        self._error: MonoslamError | None = None
        self._call: Any = None
        self._connection: object | None = None
        self._closing = self._cancelled = self._finished = False
        self._task = asyncio.create_task(self._run())

    async def opened(self) -> None:
        """Waits until the server has the stream ready."""
        async with self._changed:
            await self._changed.wait_for(lambda: self._session is not None or self._finished)
        self._raise_error()

    @property
    def session(self) -> Session:
        """The session as it was when the stream opened, at last."""
        assert self._session is not None, "the stream was opened"
        return self._session

    @property
    def n_missing(self) -> int:
        """See `FrameStream.n_missing`."""
        return self._ledger.n_missing

    async def send(
        self, image: Any, timestamp_ns: int | None = None, *, channels: str = "rgb", wait: bool = True
    ) -> int | None:
        """See `FrameStream.send`."""
        now = time.time_ns() if timestamp_ns is None else timestamp_ns
        frame = image if isinstance(image, Frame) else Frame(image, now, channels)
        async with self._changed:
            if len(self._unread) >= MAX_UNREAD:
                raise MonoslamError(f"{MAX_UNREAD} answers wait to be read; iterate over the stream")
            if not wait and not self._ledger.has_room and not self._finished:
                return None
            await self._changed.wait_for(lambda: self._ledger.has_room or self._finished or self._closing)
            self._raise_error()
            if self._finished or self._closing:
                raise MonoslamError("the stream is closed")
            sequence = self._ledger.add(frame)
            self._changed.notify_all()
            return sequence

    async def track(self, image: Any, timestamp_ns: int | None = None, *, channels: str = "rgb") -> Answer:
        """See `FrameStream.track`."""
        sequence = await self.send(image, timestamp_ns, channels=channels)
        async for answer in self:
            if answer.sequence == sequence:
                return answer
        raise MonoslamError("the stream ended before the frame was answered")

    async def __aiter__(self) -> AsyncIterator[Answer]:
        """See `FrameStream.__iter__`."""
        while True:
            async with self._changed:
                await self._changed.wait_for(lambda: self._unread or self._finished)
                if not self._unread:
                    self._raise_error()
                    return
                answer = self._unread.popleft()
            yield answer

    async def finish(self) -> None:
        """There are no more frames; answers still come."""
        async with self._changed:
            self._closing = True
            self._changed.notify_all()

    async def close(self) -> None:
        """Waits until every frame is answered and in the server's database."""
        await self.finish()
        await self._task
        self._raise_error()

    async def cancel(self) -> None:
        """Ends at once; frames without an answer may or may not become part of the session."""
        async with self._changed:
            self._cancelled = True
            if self._call is not None:
                self._call.cancel()
            self._changed.notify_all()
        await self._task

    async def fail(self, error: MonoslamError) -> None:
        """Ends with an error that whoever reads or sends is told."""
        self._error = self._error or error
        await self.cancel()

    async def __aenter__(self) -> AsyncFrameStream:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            await self.close()
        else:
            await self.cancel()

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error

    async def _run(self) -> None:
        try:
            await self._keep_connected()
        except MonoslamError as error:
            self._error = self._error or error
        finally:
            async with self._changed:
                self._finished = True
                self._changed.notify_all()

    async def _keep_connected(self) -> None:
        n_attempts = 0
        while True:
            n_before = self._ledger.n_answered
            try:
                await self._connect_once()
                if self._cancelled or await self._is_durable():
                    return
                error: MonoslamError = UnreachableError(
                    f"the server at {self._server} lost frames that it had answered"
                )
            except MonoslamError as failed:
                error = failed
            if self._cancelled or self._error is not None:
                return
            n_attempts = 1 if self._ledger.n_answered > n_before else n_attempts + 1
            if not error.is_passing or self._session is None or n_attempts > MAX_ATTEMPTS:
                raise error
            wait_s = backoff_s(n_attempts)
            _log.warning("%s; again in %.1f s", error, wait_s)
            async with self._changed:
                try:
                    await asyncio.wait_for(self._changed.wait_for(lambda: self._cancelled), wait_s)
                except asyncio.TimeoutError:
                    pass

    async def _connect_once(self) -> None:
        """Serves one connection from its opening to its end."""
        connection = object()
        async with self._changed:
            if self._cancelled:
                return
            self._ledger.disconnected()
            self._connection = connection
            self._call = call = self._stub.StreamFrames(self._requests(connection))
        try:
            first = await call.read()
            session = opened_session(None if first is grpc.aio.EOF else first)
            async with self._changed:
                self._session = session
                self._ledger.opened(session.next_sequence)
                self._changed.notify_all()
            while (response := await call.read()) is not grpc.aio.EOF:
                await self._take(_convert.answer(response))
        except grpc.RpcError as error:
            raise from_rpc_error(str(self._server), error) from None
        except asyncio.CancelledError:
            # Of the call, by us; that of the task itself goes on.
            if not self._cancelled and self._error is None:
                raise
        finally:
            async with self._changed:
                self._connection = None
                self._ledger.disconnected()
                self._changed.notify_all()
            call.cancel()
        is_ended_by_us = self._cancelled or self._error is not None
        if not is_ended_by_us and not (self._closing and self._ledger.is_answered):
            raise UnreachableError(f"the server at {self._server} ended the stream early")

    async def _take(self, answer: Answer) -> None:
        async with self._changed:
            if self._ledger.note(answer):
                self._unread.append(answer)
            self._changed.notify_all()

    async def _requests(self, connection: object) -> AsyncIterator[pb.StreamFramesRequest]:
        """What is sent over one connection; gRPC takes the next message when the last has gone."""
        yield self._plan.open_message(again=self._session is not None)
        while True:
            async with self._changed:
                await self._changed.wait_for(lambda: self._is_over(connection) or self._ledger.has_next)
                taken = None if self._connection is not connection else self._ledger.take()
            if taken is None or self._cancelled:
                return
            try:
                message = await asyncio.to_thread(frame_message, *taken)
            except FrameError as error:
                self._error = error
                self._call.cancel()
                return
            yield message

    def _is_over(self, connection: object) -> bool:
        """Whether nothing more is to be sent over this connection."""
        is_closed = self._closing and self._ledger.is_open
        return self._cancelled or self._connection is not connection or is_closed

    async def _is_durable(self) -> bool:
        """Waits until the last tracked frame is in the database; false if the server has lost it."""
        wanted, deadline = self._ledger.last_result, time.monotonic() + DURABLE_TIMEOUT_S
        while wanted is not None and not self._cancelled:
            try:
                request = pb.GetSessionRequest(session_id=self._plan.session_id)
                session = _convert.session(await self._stub.GetSession(request))
            except grpc.RpcError as error:
                raise from_rpc_error(str(self._server), error) from None
            if session.durable_sequence is not None and session.durable_sequence >= wanted:
                break
            if session.next_sequence <= wanted:
                return False
            if time.monotonic() > deadline:
                raise ProtocolError(f"frame {wanted} is not in the database after {DURABLE_TIMEOUT_S:.0f} s")
            await asyncio.sleep(DURABLE_POLL_S)
        return True
