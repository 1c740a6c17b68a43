"""Results as lines of plain text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from madrob_console.archive.result_document import MANUAL_START
from madrob_console.common.names import terminal_safe
from madrob_console.referee.flags import Flag, common_reason, data_remarks
from scoring.result import (
    Indicator,
    Result,
    difference_text,
    uncertainty_text,
    value_text,
    without_zeros,
)

_DECIMALS = 6
"""Times since the epoch, from which values are computed, have no more."""

_NONE, _SPREAD = "-", "+-"


def result_lines(result: Result, flags: Sequence[Flag] = ()) -> Iterator[str]:
    yield f"{_outcome(result)}, ruleset {result.ruleset}"
    yield from flag_lines(flags)
    if reason := common_reason(result.indicators):
        yield f"indicators: none: {reason}"
    for name, indicator in () if reason else result.indicators.items():
        sign, spread = indicator.sign or " ", uncertainty_text(indicator.uncertainty)
        words = indicator.reason or " ".join(filter(None, (spread, indicator.unit)))
        yield f"{name.words:<30} {_value(indicator):>12}{sign} {words}"
    yield from doubt_lines(result)
    yield from _notes(result)


def doubt_lines(result: Result) -> Iterator[str]:
    for words, on in result.doubts.items():
        yield terminal_safe(f"doubt: {words} ({', '.join(name.words for name in on)})")


def flag_lines(flags: Sequence[Flag]) -> Iterator[str]:
    if flags:
        yield terminal_safe(f"flags: {'; '.join(flag.words for flag in flags)}")


def comparison_lines(results: Sequence[Result], flags: Sequence[Flag] = ()) -> Iterator[str]:
    """The results of one run by several rulesets, side by side.

    Each but the first is followed by its difference to the first, whose value is subtracted.
    """
    first, *others = results
    yield _outcome(first)
    yield from flag_lines(flags)
    heads = [first.ruleset, _SPREAD]
    for other in others:
        heads += [other.ruleset, _SPREAD, "difference"]
    rows = [["", *heads, ""]]
    for name, indicator in first.indicators.items():
        cells = [name.words, *_value_and_spread(indicator)]
        for two in (other.indicators[name] for other in others):
            cells += [*_value_and_spread(two), _difference(indicator, two)]
        rows.append([*cells, indicator.unit])
    yield from _aligned(rows)
    for each in results:
        if reason := common_reason(each.indicators):
            yield f"indicators, {each.ruleset}: {reason}"
        for name, indicator in () if reason else each.indicators.items():
            if indicator.reason is not None:
                yield f"{name.words}, {each.ruleset}: {indicator.reason}"
    yield from dict.fromkeys(text for each in results for text in doubt_lines(each))
    yield from _notes(first)


def difference(first: Indicator, second: Indicator) -> float | int | None:
    """The second value minus the first, in their unit; None where one has no value."""
    return None if first.value is None or second.value is None else second.value - first.value


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
    for note in (MANUAL_START, *data_remarks(result.quality)):
        yield terminal_safe(f"note: {note}")


def _value(indicator: Indicator) -> str:
    """With the digits that its uncertainty leaves; where that is 0, all significant ones."""
    value, uncertainty = indicator.value, indicator.uncertainty
    if value is None:
        return _NONE
    if uncertainty is None:
        return _number(value)
    return value_text(value, uncertainty) if uncertainty.expanded else without_zeros(_number(value))


def _difference(first: Indicator, second: Indicator) -> str:
    """With the digits that the larger of the two uncertainties leaves."""
    by = difference(first, second)
    if by is None:
        return _NONE
    if not by:
        return "="
    return difference_text(by, (first.uncertainty, second.uncertainty), _DECIMALS)


def _number(value: float) -> str:
    return f"{value:d}" if isinstance(value, int) else f"{value:.{_DECIMALS}f}"
