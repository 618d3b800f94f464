"""A stream of frames with threads: one keeps the connection, gRPC's own sends, the caller gives and reads."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import grpc

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


class FrameStream:
    """An open stream: `send` frames, iterate for answers, in one thread or two. Made by `Client.open_stream`.

    When the connection breaks, or the server is killed and started again, the stream goes on: each frame
    becomes part of the session once. As a context manager it ends by `close`, or by `cancel` if there is an
    exception.
    """

    def __init__(
        self,
        stub: Any,
        server: Address,
        plan: StreamPlan,
        *,
        window: int = WINDOW,
        max_held_bytes: int = MAX_HELD_BYTES,
        on_answer: Callable[[Answer], None] | None = None,
    ) -> None:
        self._stub, self._server, self._plan, self._on_answer = stub, server, plan, on_answer
        self._ledger = Ledger(window, max_held_bytes)
        self._changed = threading.Condition()
        self._unread: deque[Answer] = deque()
        self._session: Session | None = None
        self._error: MonoslamError | None = None
        self._call: Any = None
        self._connection: object | None = None
        self._closing = self._cancelled = self._finished = False
        self._thread = threading.Thread(target=self._run, name=f"monoslam {plan.session_id}", daemon=True)
        self._thread.start()
        with self._changed:
            self._changed.wait_for(lambda: self._session is not None or self._finished)
        self._raise_error()

    @property
    def session(self) -> Session:
        """The session as it was when the stream opened, at last."""
        assert self._session is not None, "the stream was opened"
        return self._session

    @property
    def n_missing(self) -> int:
        """Frames that a killed server lost and that were not held any more; 0 unless `max_held_bytes` was too
        little."""
        return self._ledger.n_missing

    def send(
        self, image: Any, timestamp_ns: int | None = None, *, channels: str = "rgb", wait: bool = True
    ) -> int | None:
        """Gives a frame, or an image with its time (now, if left out), and returns its number. Waits while
        the server is busy; without `wait` the frame is left out instead and `None` returned."""
        frame = image if isinstance(image, Frame) else _frame(image, timestamp_ns, channels)
        with self._changed:
            if len(self._unread) >= MAX_UNREAD:
                raise MonoslamError(
                    f"{MAX_UNREAD} answers wait to be read; iterate over the stream, or give on_answer"
                )
            if not wait and not self._ledger.has_room and not self._finished:
                return None
            self._changed.wait_for(lambda: self._ledger.has_room or self._finished or self._closing)
            self._raise_error()
            if self._finished or self._closing:
                raise MonoslamError("the stream is closed")
            sequence = self._ledger.add(frame)
            self._changed.notify_all()
            return sequence

    def track(self, image: Any, timestamp_ns: int | None = None, *, channels: str = "rgb") -> Answer:
        """Gives a frame and waits for its answer; earlier answers that were not read are passed over."""
        sequence = self.send(image, timestamp_ns, channels=channels)
        for answer in self:
            if answer.sequence == sequence:
                return answer
        raise MonoslamError("the stream ended before the frame was answered")

    def __iter__(self) -> Iterator[Answer]:
        """Answers in the order of frames, until every frame is answered after `finish`, or for ever."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._unread or self._finished)
                if not self._unread:
                    self._raise_error()
                    return
                answer = self._unread.popleft()
            yield answer

    def finish(self) -> None:
        """There are no more frames; answers still come."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()

    def close(self) -> None:
        """Waits until every frame is answered and in the server's database."""
        self.finish()
        self._thread.join()
        self._raise_error()

    def cancel(self) -> None:
        """Ends at once; frames without an answer may or may not become part of the session."""
        with self._changed:
            self._cancelled = True
            if self._call is not None:
                self._call.cancel()
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def __enter__(self) -> FrameStream:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.cancel()

    def fail(self, error: MonoslamError) -> None:
        """Ends with an error that whoever reads or sends is told."""
        with self._changed:
            self._error = self._error or error
        self.cancel()

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            self._keep_connected()
        except MonoslamError as error:
            self._error = self._error or error
        except Exception as error:  # whatever the caller's on_answer raises
            self._error = MonoslamError(f"on_answer failed: {error!r}")
            self._error.__cause__ = error
        finally:
            with self._changed:
                self._finished = True
                self._changed.notify_all()

    def _keep_connected(self) -> None:
        n_attempts = 0
        while True:
            n_before = self._ledger.n_answered
            try:
                self._connect_once()
                if self._cancelled or self._is_durable():
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
            with self._changed:
                self._changed.wait_for(lambda: self._cancelled, timeout=wait_s)

    def _connect_once(self) -> None:
        """Serves one connection from its opening to its end."""
        connection = object()
        with self._changed:
            if self._cancelled:
                return
            self._ledger.disconnected()
            self._connection = connection
            self._call = self._stub.StreamFrames(self._requests(connection))
        responses = self._call
        try:
            session = opened_session(next(responses, None))
            with self._changed:
                self._session = session
                self._ledger.opened(session.next_sequence)
                self._changed.notify_all()
            for response in responses:
                self._take(_convert.answer(response))
        except grpc.RpcError as error:
            raise from_rpc_error(str(self._server), error) from None
        finally:
            with self._changed:
                self._connection = None
                self._ledger.disconnected()
                self._changed.notify_all()
            responses.cancel()
        with self._changed:
            if not self._cancelled and not (self._closing and self._ledger.is_answered):
                raise UnreachableError(f"the server at {self._server} ended the stream early")

    def _take(self, answer: Answer) -> None:
        with self._changed:
            is_first = self._ledger.note(answer)
            if is_first and self._on_answer is None:
                self._unread.append(answer)
            self._changed.notify_all()
        if is_first and self._on_answer is not None:
            self._on_answer(answer)

    def _requests(self, connection: object) -> Iterator[pb.StreamFramesRequest]:
        """What is sent over one connection; gRPC takes the next message when the last has gone."""
        yield self._plan.open_message(again=self._session is not None)
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._is_over(connection) or self._ledger.has_next)
                taken = None if self._connection is not connection else self._ledger.take()
            if taken is None or self._cancelled:
                return
            try:
                message = frame_message(*taken)
            except FrameError as error:
                self._error = error
                self._call.cancel()
                return
            yield message

    def _is_over(self, connection: object) -> bool:
        """Whether nothing more is to be sent over this connection."""
        is_opened = self._ledger.is_open
        return self._cancelled or self._connection is not connection or (self._closing and is_opened)

    def _is_durable(self) -> bool:
        """Waits until the last tracked frame is in the database; false if the server has lost it."""
        wanted, deadline = self._ledger.last_result, time.monotonic() + DURABLE_TIMEOUT_S
        while wanted is not None and not self._cancelled:
            try:
                message = self._stub.GetSession(pb.GetSessionRequest(session_id=self._plan.session_id))
            except grpc.RpcError as error:
                raise from_rpc_error(str(self._server), error) from None
            session = _convert.session(message)
            if session.durable_sequence is not None and session.durable_sequence >= wanted:
                break
            if session.next_sequence <= wanted:
                return False
            if time.monotonic() > deadline:
                raise ProtocolError(f"frame {wanted} is not in the database after {DURABLE_TIMEOUT_S:.0f} s")
            time.sleep(DURABLE_POLL_S)
        return True


def _frame(image: Any, timestamp_ns: int | None, channels: str) -> Frame:
    return Frame(image, time.time_ns() if timestamp_ns is None else timestamp_ns, channels)
