"""Which frames are sent again, held and let go, without a server."""

from __future__ import annotations

import numpy as np
import pytest

from monoslam import Frame, FrameDropped, FrameResult, ProtocolError, Scale, TrackingState
from monoslam._ledger import Ledger


def frame(i: int, n_bytes: int = 100) -> Frame:
    return Frame(np.zeros((1, n_bytes), dtype=np.uint8), i)


def result(sequence: int, durable: int | None = None) -> FrameResult:
    state, scale = TrackingState.TRACKED, Scale.UP_TO_SCALE
    return FrameResult(sequence, sequence, state, "", None, scale, 0, durable_sequence=durable)


def sent(ledger: Ledger) -> list[int]:
    taken = iter(ledger.take, None)
    return [sequence for sequence, _ in taken]


def opened_with(n: int, next_sequence: int = 0, **limits: int) -> Ledger:
    ledger = Ledger(**limits)
    ledger.opened(next_sequence)
    for i in range(n):
        ledger.add(frame(i))
    return ledger


def test_frames_are_sent_once_and_go_on_behind_those_that_are_there() -> None:
    ledger = opened_with(3, next_sequence=7)
    assert sent(ledger) == [7, 8, 9] and not ledger.has_next
    assert [ledger.note(result(i)) for i in (7, 8, 9)] == [True] * 3
    assert ledger.is_answered and ledger.last_result == 9


def test_what_a_killed_server_lost_is_sent_again_and_answered_once() -> None:
    ledger = opened_with(6)
    sent(ledger)
    for i in range(4):
        ledger.note(result(i, durable=1))
    ledger.disconnected()
    assert not ledger.has_next
    # It had answered 2 and 3, which are not on its disk, and never answered 4 and 5.
    ledger.opened(2)
    # Two at a time: a real-time server would drop what it cannot queue.
    assert sent(ledger) == [2, 3] and not ledger.has_next
    assert [ledger.note(result(i)) for i in (2, 3)] == [False, False] and ledger.has_next
    assert sent(ledger) == [4, 5]
    ledger.add(frame(6))
    assert sent(ledger) == [] and not ledger.has_next
    assert [ledger.note(result(i)) for i in (4, 5)] == [True, True]
    assert sent(ledger) == [6]
    assert ledger.n_missing == 0


def test_an_answer_that_was_lost_is_asked_for_again() -> None:
    ledger = opened_with(3)
    sent(ledger)
    ledger.note(result(0))
    ledger.disconnected()
    # The server has tracked all three.
    ledger.opened(3)
    assert sent(ledger) == [1, 2]


def test_dropped_frames_are_not_sent_again() -> None:
    ledger = opened_with(3)
    sent(ledger)
    ledger.note(result(0))
    ledger.note(FrameDropped(1, "too slow"))
    ledger.disconnected()
    ledger.opened(0)
    assert sent(ledger) == [0, 2]


def test_frames_wait_while_the_window_is_full() -> None:
    ledger = opened_with(2, window=2)
    assert not ledger.has_room
    sent(ledger)
    ledger.note(result(0))
    assert ledger.has_room


def test_the_memory_of_held_frames_is_bounded_and_what_is_missing_is_told() -> None:
    ledger = Ledger(window=2, max_held_bytes=4000)
    ledger.opened(0)
    for i in range(20):
        ledger.add(frame(i))
        sent(ledger)
        ledger.note(result(i))
        assert ledger._n_held_bytes <= 4000
    ledger.disconnected()
    ledger.opened(0)
    again = []
    while taken := sent(ledger):
        again += taken
        for sequence in taken:
            ledger.note(result(sequence))
    assert again == list(range(again[0], 20)) and 0 < len(again) < 20
    assert ledger.n_missing == again[0]


def test_an_answer_to_no_frame_is_noticed() -> None:
    ledger = opened_with(1)
    with pytest.raises(ProtocolError, match="frame 5, which was not sent"):
        ledger.note(result(5))
