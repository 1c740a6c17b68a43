"""Requests on their way: in which order they are taken, and what becomes of those given up."""

from __future__ import annotations

import time
from concurrent.futures import Future

import pytest

from madrob_console.engine.live.lanes import Lanes
from madrob_console.engine.process.turns import Turn
from madrob_console.engine.shown.client import UnsureError, awaited
from madrob_console.engine.shown.requests import NO_ANSWER, UNSURE
from madrob_console.errors import MadrobError


def test_what_goes_first_goes_past_all_that_wait() -> None:
    lanes: Lanes[str] = Lanes()
    for word in ("note", "mark"):
        lanes.put(word, first=False)
    taken = []
    for item in lanes.waiting():
        taken.append(item)
        if item == "note":
            lanes.put("abort", first=True)
            lanes.put("late note", first=False)
    assert taken == ["note", "abort", "mark"]
    assert lanes.next() == "late note"


def test_a_closed_lane_takes_nothing_and_holds_nobody_up() -> None:
    lanes: Lanes[str] = Lanes()
    lanes.put("note", first=False)
    assert lanes.close() == ["note"]
    assert not lanes.put("abort", first=True)
    assert lanes.next() is None
    assert list(lanes.waiting()) == []


def test_what_was_given_up_before_its_turn_never_begins() -> None:
    turn = Turn(lambda done: done(None), time.monotonic() + 60.0, Future())
    with pytest.raises(MadrobError, match=NO_ANSWER):
        awaited(turn.answer, 0.0)
    assert not turn.begin()


def test_what_comes_too_late_never_begins() -> None:
    turn = Turn(lambda done: done(None), time.monotonic() - 0.001, Future())
    assert not turn.begin()
    with pytest.raises(MadrobError, match=NO_ANSWER):
        turn.answer.result()


def test_nobody_is_told_that_nothing_was_done_of_what_has_begun() -> None:
    turn = Turn(lambda done: done(None), time.monotonic() + 60.0, Future())
    assert turn.begin()
    with pytest.raises(UnsureError, match=UNSURE):
        awaited(turn.answer, 0.0)
