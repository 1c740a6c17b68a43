"""Results as lines of plain text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from madrob_console.archive.result_document import MANUAL_START
from madrob_console.names import terminal_safe
from madrob_console.referee.flags import Flag, common_reason
from scoring.result import (
    Indicator,
    Result,
    difference_text,
    uncertainty_text,
    value_text,
    without_zeros,
)

_DECIMALS = 6
"""Times of the epoch, of which values are made, have no more."""

_NONE, _SPREAD = "-", "+-"


def result_lines(result: Result, found: Sequence[Flag] = ()) -> Iterator[str]:
    """A result as a table for people, its flags first."""
    yield f"{_outcome(result)}, ruleset {result.ruleset}"
    yield from flag_lines(found)
    if reason := common_reason(result.indicators):
        yield f"indicators: none: {reason}"
    for name, indicator in () if reason else result.indicators.items():
        sign, spread = indicator.sign or " ", uncertainty_text(indicator.uncertainty)
        words = indicator.reason or " ".join(filter(None, (spread, indicator.unit)))
        yield f"{name.words:<30} {_value(indicator):>12}{sign} {words}"
    yield from doubt_lines(result)
    yield from _notes(result)


def doubt_lines(result: Result) -> Iterator[str]:
    """Each doubt with the indicators that it is on."""
    for words, on in result.doubts.items():
        yield terminal_safe(f"doubt: {words} ({', '.join(name.words for name in on)})")


def flag_lines(found: Sequence[Flag]) -> Iterator[str]:
    """What a decision on a run hangs on, on one line; none where nothing does."""
    if found:
        yield terminal_safe(f"flags: {'; '.join(flag.words for flag in found)}")


def comparison_lines(results: Sequence[Result], found: Sequence[Flag] = ()) -> Iterator[str]:
    """The results of one run by several rulesets, side by side.

    Beside each but the first stands its difference to the first: that one's value is subtracted.
    """
    first, *others = results
    yield _outcome(first)
    yield from flag_lines(found)
    heads = [first.ruleset, _SPREAD]
    for other in others:
        heads += [other.ruleset, _SPREAD, "difference"]
    rows = [["", *heads, ""]]
    for name, one in first.indicators.items():
        cells = [name.words, *_value_and_spread(one)]
        for two in (other.indicators[name] for other in others):
            cells += [*_value_and_spread(two), _difference(one, two)]
        rows.append([*cells, one.unit])
    yield from _aligned(rows)
    for each in results:
        if reason := common_reason(each.indicators):
            yield f"indicators, {each.ruleset}: {reason}"
        for name, indicator in () if reason else each.indicators.items():
            if indicator.reason is not None:
                yield f"{name.words}, {each.ruleset}: {indicator.reason}"
    yield from dict.fromkeys(text for each in results for text in doubt_lines(each))
    yield from _notes(first)


def difference(one: Indicator, two: Indicator) -> float | int | None:
    """By how much the second is larger, in their unit; None where one has no value."""
    return None if one.value is None or two.value is None else two.value - one.value


def _aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Rows as lines: the first and the last column to the left, all others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for first, *cells, last in rows:
        middle = "".join(
            f"  {cell:>{width}}" for cell, width in zip(cells, widths[1:-1], strict=True)
        )
        yield f"{first:<{widths[0]}}{middle}  {last}".rstrip()


def _value_and_spread(indicator: Indicator) -> tuple[str, str]:
    spread = uncertainty_text(indicator.uncertainty).removeprefix(f"{_SPREAD} ")
    return f"{_value(indicator)}{indicator.sign}", spread


def _outcome(result: Result) -> str:
    return terminal_safe(f"outcome: {result.outcome} ({result.ended})")


def _notes(result: Result) -> Iterator[str]:
    if result.rest is not None:
        yield f"handle at rest: {result.rest.words}"
    for note in (MANUAL_START, *result.quality.remarks):
        yield terminal_safe(f"note: {note}")


def _value(indicator: Indicator) -> str:
    """With the digits that it has: where its uncertainty is 0, all that mean something."""
    value, known = indicator.value, indicator.uncertainty
    if value is None:
        return _NONE
    if known is None:
        return _number(value)
    return value_text(value, known) if known.expanded else without_zeros(_number(value))


def _difference(one: Indicator, two: Indicator) -> str:
    """With the digits that the larger of the two uncertainties leaves."""
    by = difference(one, two)
    if by is None:
        return _NONE
    if not by:
        return "="
    return difference_text(by, (one.uncertainty, two.uncertainty), _DECIMALS)


def _number(value: float) -> str:
    return f"{value:d}" if isinstance(value, int) else f"{value:.{_DECIMALS}f}"
