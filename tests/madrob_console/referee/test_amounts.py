from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.referee.amounts import counted, listed, size_words, span_words


@pytest.mark.parametrize(
    ("size", "words"),
    [
        (0, "0 B"),
        (999, "999 B"),
        (730_000, "730 kB"),
        (2_200_000, "2.2 MB"),
        (5_000_000, "5.0 MB"),
        (999_960_000, "1.0 GB"),
        (500_000_000, "500 MB"),
        (1_234_000_000_000, "1234 GB"),
    ],
)
def test_a_size_is_told_in_the_unit_that_says_something(size: int, words: str) -> None:
    assert size_words(size) == words


@given(st.integers(1, 10**15))
def test_no_size_is_told_as_nothing(size: int) -> None:
    number, _ = size_words(size).split()
    assert float(number) > 0.9


@pytest.mark.parametrize(
    ("span", "words"),
    [
        (0.3, "1 s"),
        (59.9, "59 s"),
        (60, "1 min"),
        (68.4, "1 min 8 s"),
        (299.9, "4 min 59 s"),
        (300, "5 min"),
        (3599, "59 min"),
        (3900, "1 h 05 min"),
        (47 * 3600 + 3599, "47 h 59 min"),
        (3 * 86400 - 1, "2 days"),
    ],
)
def test_a_span_is_told_in_units_that_say_something(span: float, words: str) -> None:
    assert span_words(span) == words


def test_of_many_names_the_first_are_told() -> None:
    assert [listed("abcd"[:n]) for n in (1, 2, 4)] == ["a", "a, b", "a, b and 2 more"]


def test_one_is_one() -> None:
    assert [counted(number, "topic") for number in (0, 1, 2)] == ["0 topics", "1 topic", "2 topics"]
