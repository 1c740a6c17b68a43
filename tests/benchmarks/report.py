"""A ratio: our way beside another one, measured in the same go.

The pace of a machine differs from day to day by more than any change of the program.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import median
from textwrap import shorten

_WIDTHS = {"figure": 40, "unit": 8, "ours": 8, "beside it": 32, "ratio": 7, "goal": 9, "": 7}
"""Of the columns: a row is told before the next one is known."""
ADDITIONS = 10_000_000
LONGEST_PROBLEM = 120  # characters
_RIGHT = ("ours", "ratio", "goal")


class Verdict(StrEnum):
    """What became of a goal."""

    MET = "met"
    NOT_MET = "NOT MET"
    FAILED = "FAILED"


@dataclass(frozen=True, slots=True)
class Figure:
    """One thing that was measured several times, and so was something else beside it.

    Attributes:
        beside: what the something else is.
        others: its values.
        goal: the largest ratio of the medians.
        at_least: more is better: it is the smallest ratio.
        problem: why nothing could be measured, in words; empty = it could.
    """

    name: str
    unit: str = ""
    values: Sequence[float] = ()
    beside: str = ""
    others: Sequence[float] = ()
    goal: float = 0.0
    at_least: bool = False
    problem: str = ""

    @property
    def ratio(self) -> float | None:
        """The median over that of the others; None without one of them."""
        if not self.values or not self.others or not median(self.others):
            return None
        return median(self.values) / median(self.others)

    @property
    def verdict(self) -> Verdict:
        """Whether the goal is met; what has no ratio was not measured."""
        if self.ratio is None:
            return Verdict.FAILED
        good = self.ratio >= self.goal if self.at_least else self.ratio <= self.goal
        return Verdict.MET if good else Verdict.NOT_MET


def machine() -> str:
    """What it was measured on, in words."""
    began = time.perf_counter()
    total = 0
    for number in range(ADDITIONS):
        total += number
    took = time.perf_counter() - began
    return f"{os.cpu_count()} cores, ten million additions in a Python loop take {took:.2f} s."


def head() -> str:
    """The first two lines of the table."""
    rule = "|".join("-" * (width + 2) for width in _WIDTHS.values())
    return f"{_line(list(_WIDTHS))}\n|{rule}|"


def row(figure: Figure) -> str:
    """The line of a figure; what could not be measured says why."""
    if figure.ratio is None:
        why = shorten(figure.problem or "without values", LONGEST_PROBLEM)
        return _line([figure.name, figure.unit, "-", why, "-", "", figure.verdict])
    return _line(
        [
            figure.name,
            figure.unit,
            f"{median(figure.values):.4g}",
            f"{figure.beside} {median(figure.others):.4g}",
            f"{figure.ratio:.2f}x",
            f"{'>=' if figure.at_least else '<='} {figure.goal:.3g}x",
            figure.verdict,
        ]
    )


def _line(cells: Sequence[str]) -> str:
    aligned = (
        cell.rjust(width) if name in _RIGHT else cell.ljust(width)
        for cell, (name, width) in zip(cells, _WIDTHS.items(), strict=True)
    )
    return f"| {' | '.join(aligned)} |"
