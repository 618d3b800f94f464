"""Which frames of a stream are sent, answered, and safe in the server's database. No I/O, no threads.

A frame is held from when it is given until the server has it on disk (`durable_sequence`) or has said that it
will not be. When a connection breaks, the server tells at the next one which frame it expects
(`next_sequence`): what it never got, and what it had only in memory when it was killed, is sent again. Its
answer is given on once.
"""

from __future__ import annotations

from . import images
from .errors import ProtocolError
from .model import Answer, FrameResult
from .sources import Frame

WINDOW = 8
"""Frames without an answer, at most. The server queues four and decodes and tracks two; more would only be
held."""

MAX_HELD_BYTES = 256 << 20
"""Memory for frames that the server has answered and not yet saved: 800 gray images of 640 x 480. It saves
with each keyframe, so that more is needed only if the camera stands still for long. Then the oldest are let
go; should the server be killed just then, those are missing."""

CATCH_UP = 2
"""Frames on their way at the same time until those that are sent again are answered: a real-time server drops
the oldest when it cannot queue them."""

_FRAME_BYTES = 512
"""What holding a frame costs besides its pixels."""


class Ledger:
    """See the module."""

    def __init__(self, window: int = WINDOW, max_held_bytes: int = MAX_HELD_BYTES) -> None:
        self._window = window
        self._max_held_bytes = max_held_bytes
        self._held: dict[int, Frame] = {}
        self._n_held_bytes = 0
        self._first: int | None = None
        self._next_new = 0
        self._first_unanswered = 0
        self._cursor: int | None = None
        self._n_in_flight = 0
        self._again_to = self._answered_to = 0
        self._forgotten_to = -1
        self.last_result: int | None = None
        """The last frame that the server tracked or tried to, which is to become durable."""
        self.n_missing = 0
        """Frames that the server lost and that were not held any more."""

    @property
    def n_answered(self) -> int:
        return self._first_unanswered - (self._first or 0)

    @property
    def is_answered(self) -> bool:
        """Whether every frame has an answer."""
        return self._first_unanswered == self._next_new

    @property
    def is_open(self) -> bool:
        """Whether the server has told on this connection which frame it expects."""
        return self._cursor is not None

    @property
    def has_room(self) -> bool:
        return self._next_new - self._first_unanswered < self._window

    @property
    def has_next(self) -> bool:
        """Whether there is a frame to send on this connection."""
        if self._cursor is None or not self._held or self._is_catching_up:
            return False
        return next(reversed(self._held)) >= self._cursor

    @property
    def _is_catching_up(self) -> bool:
        """Whether frames that are sent again wait for their answers, and as many are on their way as may be."""
        return self._answered_to < self._again_to and self._n_in_flight >= CATCH_UP

    def disconnected(self) -> None:
        """Nothing is to be sent until the next `opened`."""
        self._cursor = None

    def opened(self, next_sequence: int) -> None:
        """A connection is open, and the server expects this frame."""
        if self._first is None:
            self._first = self._next_new = self._first_unanswered = next_sequence
        else:
            self.n_missing += max(0, self._forgotten_to - next_sequence + 1)
        # Frames that the server has, but whose answer was lost, are answered again and not tracked twice.
        self._cursor = min(self._first_unanswered, next_sequence)
        self._n_in_flight, self._again_to, self._answered_to = 0, self._next_new, self._cursor

    def add(self, frame: Frame) -> int:
        """Takes a frame and gives it the next number."""
        sequence = self._next_new
        self._next_new += 1
        self._held[sequence] = frame
        self._n_held_bytes += _cost(frame)
        while self._n_held_bytes > self._max_held_bytes:
            oldest = next(iter(self._held))
            if oldest >= self._first_unanswered:
                break
            self._release(oldest)
            self._forgotten_to = oldest
        return sequence

    def take(self) -> tuple[int, Frame] | None:
        """The next frame to send on this connection; `None` if there is none now."""
        while self._cursor is not None and self._cursor < self._next_new and not self._is_catching_up:
            sequence = self._cursor
            self._cursor += 1
            if sequence in self._held:
                self._n_in_flight += 1
                return sequence, self._held[sequence]
        return None

    def note(self, answer: Answer) -> bool:
        """Notes an answer; whether it is the first to its frame."""
        sequence = answer.sequence
        if self._first is None or not self._first <= sequence < self._next_new:
            raise ProtocolError(f"the server answered frame {sequence}, which was not sent")
        self._n_in_flight -= 1
        self._answered_to = sequence + 1
        is_first = sequence >= self._first_unanswered
        self._first_unanswered = max(self._first_unanswered, sequence + 1)
        if isinstance(answer, FrameResult):
            self.last_result = max(sequence, self.last_result or 0)
            self._saved(answer.durable_sequence)
        else:
            self._release(sequence)
        return is_first

    def _saved(self, durable_sequence: int | None) -> None:
        while durable_sequence is not None and self._held:
            oldest = next(iter(self._held))
            if oldest > durable_sequence:
                break
            self._release(oldest)

    def _release(self, sequence: int) -> None:
        frame = self._held.pop(sequence, None)
        if frame is not None:
            self._n_held_bytes -= _cost(frame)


def _cost(frame: Frame) -> int:
    return _FRAME_BYTES + images.n_held_bytes(frame.image)
