"""Compares a stored result with its bag, for an appeal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from madrob_console.archive.check import Difference, Grade, differences_between, library_words
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.result_reader import UnusableResultError, read_result
from madrob_console.common.names import terminal_safe
from scoring.indicator_table import IndicatorName
from scoring.result import Result, libraries_here

EQUAL = "equals the stored result to the last digit"

_DIGITS = (2, 3, 6)


@dataclass(frozen=True, slots=True)
class Comparison:
    """A result beside the stored one (protocol section 11); grade None = no stored one."""

    words: str
    grade: Grade | None = None

    @property
    def agrees(self) -> bool:
        return self.grade in {Grade.SAME, Grade.CLOSE}


def stored_result(path: Path) -> ResultDocument | str:
    """A bag alone has none; then why, in words."""
    try:
        return read_result(str(path))
    except FileNotFoundError:
        return "no stored result lies beside the recording"
    except UnusableResultError as error:
        return terminal_safe(str(error))


def compared(stored: ResultDocument | str, result: Result) -> Comparison:
    """With enough digits to tell two values apart."""
    if isinstance(stored, str):
        return Comparison(stored)
    differences = tuple(differences_between("", _appealed(stored), _appealed(result)))
    grade = Grade.worst(each.grade for each in differences)
    values = "; ".join(_beside_stored(each) for each in differences if each.grade is grade)
    match grade:
        case Grade.SAME:
            return Comparison(EQUAL, grade)
        case Grade.CLOSE:
            why = terminal_safe(library_words(stored.libraries, libraries_here()))
            return Comparison(f"equals the stored result to 1e-9: {values} ({why})", grade)
        case Grade.DIFFERS:
            return Comparison(f"differs from the stored result: {values}", grade)


def _appealed(result: Result) -> dict[str, Any]:
    """The fields of a result that an appeal is about."""
    indicators = {name: result.indicators.get(name) for name in IndicatorName}
    return {
        "ruleset": result.ruleset,
        "outcome": result.outcome,
        "start": result.start,
        "indicators": {
            name: {"value": indicator and indicator.value} for name, indicator in indicators.items()
        },
    }


def _beside_stored(difference: Difference) -> str:
    now, stored = difference.recomputed, difference.stored
    if difference.indicator is not None:
        here, there = distinct_texts(now, stored)
        return f"{difference.indicator.replace('_', ' ')} {here}, stored {there}"
    if difference.what == "start":
        return f"start {now - stored:+.6g} s from the stored one"
    return f"{difference.what} {now}, stored {terminal_safe(stored)}"


def distinct_texts(first: float | None, second: float | None) -> tuple[str, str]:
    """Two values, with as many digits as tell them apart."""
    for digits in _DIGITS:
        texts = _text(first, digits), _text(second, digits)
        if texts[0] != texts[1]:
            return texts
    return repr(first), repr(second)


def _text(value: float | None, digits: int) -> str:
    if value is None:
        return "none"
    return str(value) if isinstance(value, int) else f"{value:.{digits}f}"
