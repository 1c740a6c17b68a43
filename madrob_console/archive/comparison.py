"""What a stored result says against what its bag says: that is what an appeal is about."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from madrob_console.archive.result_reader import ListedResult, UnusableResultError, read_result
from madrob_console.names import terminal_safe
from scoring.indicator_table import IndicatorName
from scoring.result import Result

EQUAL = "equals the stored result to the last digit"
"""What is said of the result of a replay that differs in nothing."""

_DIGITS = (2, 3, 6)


def stored_result(path: Path) -> ListedResult | str:
    """The stored result of a run folder, or why there is none, in words; a bag alone has none."""
    try:
        return read_result(str(path))[0]
    except FileNotFoundError:
        return "no stored result lies beside the recording"
    except UnusableResultError as error:
        return terminal_safe(str(error))


def compared(stored: ListedResult | str, result: Result) -> str:
    """What a result is beside the stored one, in words; why there is none, where there is none.

    Digits are given until they tell two values apart.
    """
    if isinstance(stored, str):
        return stored
    found = tuple(_differences(stored, result))
    return f"differs from the stored result: {'; '.join(found)}" if found else EQUAL


def _differences(stored: ListedResult, result: Result) -> Iterator[str]:
    if stored.ruleset != result.ruleset:
        yield f"ruleset {result.ruleset}, stored {terminal_safe(stored.ruleset)}"
    if stored.outcome is not result.outcome:
        yield f"outcome {result.outcome}, stored {stored.outcome}"
    if stored.start != result.start:
        yield f"start {result.start - stored.start:+.6g} s from the stored one"
    for name in IndicatorName:
        value, part = result.indicators[name].value, stored.indicators.get(name)
        known = None if part is None else part.value
        if value != known:
            here, there = _apart(value, known)
            yield f"{name.replace('_', ' ')} {here}, stored {there}"


def _apart(value: float | None, stored: float | None) -> tuple[str, str]:
    """Two values that differ, with as many digits as it takes to see that."""
    for digits in _DIGITS:
        texts = _text(value, digits), _text(stored, digits)
        if texts[0] != texts[1]:
            return texts
    return repr(value), repr(stored)


def _text(value: float | None, digits: int) -> str:
    if value is None:
        return "none"
    return str(value) if isinstance(value, int) else f"{value:.{digits}f}"
