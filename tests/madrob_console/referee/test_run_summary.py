"""A run in a list: whether it counts, whether it can be compared, and its words."""

from __future__ import annotations

from typing import Any

import pytest

from madrob_console.referee.run_summary import RunSummary, condition_words
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from tests.madrob_console.run_folders import summary

LEVEL, TIME = IndicatorName.CAPABILITY_LEVEL, IndicatorName.EXECUTION_TIME
VALUES = {LEVEL: 6, TIME: 13.857}
WHOLE: dict[str, Any] = {"values": VALUES, "source": "ros", "outcome": Outcome.COMPLETED}


@pytest.mark.parametrize(
    ("changes", "words", "valid", "comparable"),
    [
        ({}, "level 6, completed in 13.8570 s", True, True),
        ({"doubts": {TIME: 2}}, "level 6, completed in 13.8570? s", True, True),
        ({"values": {LEVEL: 6}}, "level 6, completed in - s", True, True),
        ({"outcome": Outcome.TIMEOUT, "reason": "300 s"}, "level 6, timeout", True, False),
        ({"outcome": Outcome.ABORTED, "reason": "fire"}, "INVALID: fire", False, False),
        ({"outcome": Outcome.ABORTED}, "INVALID", False, False),
        ({"outcome": Outcome.INTERRUPTED}, "INTERRUPTED", False, False),
        ({"voided": True, "reason": "unsafe"}, "VOID: unsafe", False, False),
        ({"outcome": None}, "unfinished", False, False),
        ({"outcome": None, "never_ran": "no start"}, "never ran", False, False),
        ({"outcome": None, "voided": True}, "unfinished", False, False),
        ({"problem": "no JSON", "voided": True}, "DAMAGED", False, False),
        ({"twin": "other"}, "TWICE", False, False),
    ],
)
def test_the_words_of_a_run_say_whether_and_how_it_counts(
    changes: dict[str, Any], words: str, valid: bool, comparable: bool
) -> None:
    run = summary(3, 1, **(WHOLE | changes))
    assert (run.result_words, run.valid, run.comparable) == (words, valid, comparable)
    assert run.outcome_word in words
    if run.outcome is not Outcome.COMPLETED:  # none of its times is compared with another
        assert run.value_words(TIME) == run.outcome_word


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"outcome": None}, "no result yet: it goes on, or the referee decides on it"),
        ({"outcome": Outcome.ABORTED}, "the referee gave no reason"),
        ({"outcome": Outcome.INTERRUPTED}, "the machine failed"),
        ({"outcome": Outcome.ABORTED, "reason": "fire"}, "fire"),
        ({"problem": "no JSON", "reason": "fire"}, "no JSON"),
        ({"folder": "mine", "twin": "other"}, "mine is the same run as other, which counts"),
    ],
)
def test_a_run_that_is_left_out_says_why(changes: dict[str, Any], why: str) -> None:
    plain: dict[str, Any] = {
        "folder": "f",
        "subject": 3,
        "condition": 1,
        "run_number": 1,
        "started": 0,
    }
    assert RunSummary(**plain | changes).why_left_out == why


@pytest.mark.parametrize(
    ("source", "competition", "practice", "official"),
    [
        ("ros", "", False, True),
        ("ros", "Cup", True, False),
        ("simulated", "Cup", False, False),
        ("simulated", "REHEARSAL Cup", False, True),
        ("simulated", "REHEARSAL Cup", True, False),
        ("replay", "REHEARSAL Cup", False, False),
        (None, "", False, False),
    ],
)
def test_a_run_is_official_on_a_real_testbed_or_in_a_rehearsal(
    source: str | None, competition: str, practice: bool, official: bool
) -> None:
    run = summary(3, 1, source=source, competition=competition, practice=practice)
    assert run.official is official


@pytest.mark.parametrize(
    ("changes", "closing"),
    [
        ({"final": False}, "not final"),
        ({"final": True}, "final"),
        ({"final": True, "team_word": "protested"}, "protested"),
        ({"final": False, "team_word": "protested"}, "not final"),
        ({"final": True, "protest_filed": 0.0}, "PROTEST"),
    ],
)
def test_a_result_is_final_when_it_is_signed_and_no_protest_is_open(
    changes: dict[str, Any], closing: str
) -> None:
    assert summary(3, 1, **changes).closing == closing


def test_a_condition_has_words_and_a_number_that_is_none_has_not() -> None:
    assert condition_words(1) == ("pull, from CCW to CW", "No Force")
    assert condition_words(21) == condition_words(0) == ("", "")
