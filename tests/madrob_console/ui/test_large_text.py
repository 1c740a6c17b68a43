"""Large letters: every size of them, in blocks and in bars."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from madrob_console.ui.cells.large_text import HEIGHT, large_text, rows_of, width_of_large

SIZES = st.integers(1, 8)
DIGITS = "0123456789:.-?"
NAMES = st.text(
    "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz \u00fc\u00e5&+/'(),_-." + DIGITS,
    min_size=1,
)


@given(NAMES, SIZES)
def test_each_row_is_as_wide_as_is_said(text: str, size: int) -> None:
    rows = large_text(text, size)
    assert rows is not None
    assert len(rows) == rows_of(size)
    assert {cell_len(row) for row in rows} == {width_of_large(text, size)}


@given(st.text(DIGITS, min_size=1), SIZES)
def test_bars_of_ascii_take_the_same_cells(text: str, size: int) -> None:
    blocks, bars = large_text(text, size), large_text(text, size, ascii_only=True)
    assert bars is not None
    assert blocks is not None
    assert "".join(bars).isascii()
    assert [len(row) for row in bars] == [len(row) for row in blocks]


@pytest.mark.parametrize("size", range(1, 6))
@pytest.mark.parametrize("ascii_only", [False, True])
def test_no_two_digits_look_alike(size: int, *, ascii_only: bool) -> None:
    drawn = [large_text(digit, size, ascii_only=ascii_only) for digit in DIGITS]
    assert len({tuple(rows or ()) for rows in drawn}) == len(DIGITS)


@given(NAMES, st.integers(2, 6))
def test_a_larger_letter_has_the_same_points_each_larger(text: str, size: int) -> None:
    small, large = _points(large_text(text, 1)), _points(large_text(text, size))
    assert [row[::size] for row in large[: HEIGHT * size : size]] == small[:HEIGHT]


@pytest.mark.parametrize("text", ["", "\u9580", "Team \u9580", "a\x1bb"])
def test_of_other_scripts_there_are_no_large_letters(text: str) -> None:
    assert large_text(text, 1) is None


def test_words_have_no_bars() -> None:
    assert large_text("RUNNING", 1, ascii_only=True) is None


def _points(rows: list[str] | None) -> list[str]:
    """One character a point: `#` or a blank."""
    assert rows is not None
    points = []
    for row in rows:
        points.append("".join("#" if cell in "\u2580\u2588" else " " for cell in row))
        points.append("".join("#" if cell in "\u2584\u2588" else " " for cell in row))
    return points
