"""What a stored result says against what its bag says: that is what an appeal is about."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from madrob_console.archive.grades import Grade, libraries_told
from madrob_console.archive.listed_result import ListedResult
from madrob_console.archive.result_reader import UnusableResultError, read_result
from madrob_console.names import terminal_safe
from scoring.indicator_table import IndicatorName
from scoring.libraries import libraries_here
from scoring.result import Result

EQUAL = "equals the stored result to the last digit"
"""What is said of the result of a replay that differs in nothing."""

_DIGITS = (2, 3, 6)


@dataclass(frozen=True, slots=True)
class Comparison:
    """What a result is beside the stored one (protocol section 11).

    Attributes:
        words: all of it, on one line.
        grade: how far the two agree; None = there is none to compare with.
    """

    words: str
    grade: Grade | None = None

    @property
    def agrees(self) -> bool:
        """Whether nothing but the last digits differs."""
        return self.grade in {Grade.SAME, Grade.CLOSE}


def stored_result(path: Path) -> ListedResult | str:
    """The stored result of a run folder, or why there is none, in words; a bag alone has none."""
    try:
        return read_result(str(path))[0]
    except FileNotFoundError:
        return "no stored result lies beside the recording"
    except UnusableResultError as error:
        return terminal_safe(str(error))


def compared(stored: ListedResult | str, result: Result) -> Comparison:
    """What a result is beside the stored one; why there is none, where there is none.

    Digits are given until they tell two values apart.
    """
    if isinstance(stored, str):
        return Comparison(stored)
    found = tuple(_differences(stored, result))
    grade = Grade.worst(each for each, _ in found)
    values = "; ".join(words for each, words in found if each is grade)
    match grade:
        case Grade.SAME:
            return Comparison(EQUAL, grade)
        case Grade.CLOSE:
            told = terminal_safe(libraries_told(stored.libraries, libraries_here()))
            return Comparison(f"equals the stored result to 1e-9: {values} ({told})", grade)
        case Grade.DIFFERS:
            return Comparison(f"differs from the stored result: {values}", grade)


def _differences(stored: ListedResult, result: Result) -> Iterator[tuple[Grade, str]]:
    if stored.ruleset != result.ruleset:
        ruleset = terminal_safe(stored.ruleset)
        yield Grade.DIFFERS, f"ruleset {result.ruleset}, stored {ruleset}"
    if stored.outcome is not result.outcome:
        yield Grade.DIFFERS, f"outcome {result.outcome}, stored {stored.outcome}"
    if stored.start != result.start:
        yield Grade.DIFFERS, f"start {result.start - stored.start:+.6g} s from the stored one"
    for name in IndicatorName:
        value, part = result.indicators[name].value, stored.indicators.get(name)
        known = None if part is None else part.value
        if value != known:
            here, there = _apart(value, known)
            yield Grade.of(known, value), f"{name.replace('_', ' ')} {here}, stored {there}"


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
