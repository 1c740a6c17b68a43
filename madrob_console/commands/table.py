"""Results as lines of plain text."""

from __future__ import annotations

from collections.abc import Iterator

from madrob_console.engine.results import MANUAL_START
from scoring.result import Result


def result_lines(result: Result) -> Iterator[str]:
    """A result as a table for people."""
    yield f"outcome: {result.ending.outcome} ({result.ending.reason}), ruleset {result.ruleset}"
    for indicator in result.indicators:
        name = indicator.name.replace("_", " ")
        if indicator.value is None:
            yield f"{name:<30} {'-':>12}  {indicator.reason}"
        else:
            yield f"{name:<30} {_number(indicator.value):>12}  {indicator.unit}"
    yield f"note: {MANUAL_START}"
    for remark in result.quality.remarks:
        yield f"note: {remark}"


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6f}"
