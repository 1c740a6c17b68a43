from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.amounts import counted, listed, size_words


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


def test_of_many_names_the_first_are_told() -> None:
    assert [listed("abcd"[:n]) for n in (1, 2, 4)] == ["a", "a, b", "a, b and 2 more"]


def test_one_is_one() -> None:
    assert [counted(number, "topic") for number in (0, 1, 2)] == ["0 topics", "1 topic", "2 topics"]
