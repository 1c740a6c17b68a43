"""Results as lines of plain text."""

from __future__ import annotations

from collections.abc import Iterator

from madrob_console.archive.results import MANUAL_START
from madrob_console.names import terminal_safe
from scoring.result import Indicator, Result

_NONE = "-"


def result_lines(result: Result) -> Iterator[str]:
    """A result as a table for people."""
    yield f"{_outcome(result)}, ruleset {result.ruleset}"
    for indicator in result.indicators:
        yield f"{_name(indicator)} {_value(indicator):>12}  {indicator.reason or indicator.unit}"
    yield from _notes(result)


def comparison_lines(result: Result, other: Result) -> Iterator[str]:
    """The results of one run by two rulesets, side by side; the difference is other - result."""
    yield _outcome(result)
    yield f"{'':<30} {result.ruleset:>14} {other.ruleset:>14} {'difference':>14}"
    for one, two in zip(result.indicators, other.indicators, strict=True):
        values = f"{_value(one):>14} {_value(two):>14}"
        yield f"{_name(one)} {values} {_difference(one, two):>14}  {one.unit}"
    for each in (result, other):
        for indicator in each.indicators:
            if indicator.reason is not None:
                yield f"{_name(indicator).rstrip()}, {each.ruleset}: {indicator.reason}"
    yield from _notes(result)


def difference(one: Indicator, two: Indicator) -> float | int | None:
    """By how much the second is larger, in their unit; None where one has no value."""
    return None if one.value is None or two.value is None else two.value - one.value


def _outcome(result: Result) -> str:
    return terminal_safe(f"outcome: {result.ending.outcome} ({result.ending.reason})")


def _notes(result: Result) -> Iterator[str]:
    for note in (MANUAL_START, *result.quality.remarks):
        yield terminal_safe(f"note: {note}")


def _name(indicator: Indicator) -> str:
    return f"{indicator.name.replace('_', ' '):<30}"


def _value(indicator: Indicator) -> str:
    return _NONE if indicator.value is None else _number(indicator.value, "")


def _difference(one: Indicator, two: Indicator) -> str:
    by = difference(one, two)
    if by is None:
        return _NONE
    return _number(by, "+") if by else "="


def _number(value: float, sign: str) -> str:
    return f"{value:{sign}d}" if isinstance(value, int) else f"{value:{sign}.6f}"
