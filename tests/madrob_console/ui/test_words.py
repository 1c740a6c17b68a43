from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from madrob_console.referee.run_times import relative_text
from madrob_console.ui.look.words import (
    clock_text,
    fitted,
    minutes_text,
    size_text,
    wrapped,
)
from scoring.result import value_text

TEXTS = st.text(st.characters(categories=["L", "N", "P", "Zs", "So"]), max_size=60)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0, "0:00.0"),
        (0.3, "0:00.3"),
        (59.999, "0:59.9"),
        (63.04, "1:03.0"),
        (-4.25, "-0:04.2"),
        (-0.04, "0:00.0"),
        (86400.0, "1440:00.0"),
    ],
)
def test_a_clock_never_runs_ahead(seconds: float, text: str) -> None:
    assert clock_text(seconds) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(300.0, "5:00"), (299.2, "5:00"), (0.1, "0:01"), (0.0, "0:00"), (-3.0, "0:00")],
)
def test_time_to_go_is_zero_only_when_none_is_left(seconds: float, text: str) -> None:
    assert minutes_text(seconds) == text


@pytest.mark.parametrize(
    ("at", "start", "text"),
    [
        (None, 1.0, "-"),
        (1.0, None, "-"),
        (1_700_000_003.25, 1_700_000_000.0, "3.250"),
        (5000.0, 0.0, "5000.0"),
    ],
)
def test_times_count_from_the_start(at: float | None, start: float | None, text: str) -> None:
    assert relative_text(at, start) == text


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (0, "0 B"),
        (999, "999 B"),
        (1000, "1.0 kB"),
        (99_949, "99.9 kB"),
        (123_456, "123 kB"),
        (999_499, "999 kB"),
        (999_600, "1.0 MB"),
        (41_000_000_000, "41.0 GB"),
        (2_500_000_000_000, "2.5 TB"),
    ],
)
def test_sizes_have_the_unit_that_people_read(size: int, text: str) -> None:
    assert size_text(size) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (6, "6"),
        (0.0, "0.0000"),
        (17.43216, "17.4322"),
        (0.00123, "1.2300e-03"),
        (2e7, "2.0000e+07"),
    ],
)
def test_values_keep_four_decimals(value: float, text: str) -> None:
    assert value_text(value) == text


@given(TEXTS, st.integers(1, 40))
def test_a_fitted_text_takes_exactly_its_cells(text: str, width: int) -> None:
    shown = fitted(text, width)
    assert cell_len(shown) == width
    if cell_len(text) > width:
        assert "…" in shown
    else:
        assert shown.rstrip(" ") == text.rstrip(" ")


@given(TEXTS, st.integers(2, 40))
def test_wrapping_loses_nothing_and_stays_inside(text: str, width: int) -> None:
    lines = wrapped(text, width)
    assert all(cell_len(line) <= width for line in lines)
    assert "".join("".join(lines).split()) == "".join(text.split())
