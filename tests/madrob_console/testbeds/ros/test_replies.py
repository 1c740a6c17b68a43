"""What callers of a service are told, in which order, and what a flood of calls can push out."""

from __future__ import annotations

import pytest

from madrob_console.testbeds.outside import CallAnswer
from madrob_console.testbeds.ros.neighbours import DEPTH, TOO_MANY, Replies

pytestmark = pytest.mark.pure

DONE = CallAnswer(success=True, message="Done: abort")


def told(replies: Replies) -> list[tuple[object, str]]:
    """Everything that is owed."""
    owed = []
    while (one := replies.take()) is not None:
        owed.append((one[0], one[1].message))
    return owed


def test_no_flood_of_refusals_takes_the_place_of_the_answer_to_an_abort_that_was_done() -> None:
    replies = Replies()
    replies.refuse("first")
    replies.answer("abort", DONE)
    for number in range(2 * DEPTH):
        replies.refuse(number)
    owed = told(replies)
    assert owed[0] == ("abort", "Done: abort")
    assert owed[1:] == [(number, TOO_MANY) for number in range(DEPTH, 2 * DEPTH)]


def test_answers_come_in_the_order_in_which_they_were_there() -> None:
    replies = Replies()
    for caller in ("one", "two"):
        replies.answer(caller, DONE)
    assert replies.answers == 2
    assert [caller for caller, _ in told(replies)] == ["one", "two"]
