"""Measurements beside their goals and baselines, as a table for people and JSON for programs.

A goal is a ratio to something that is measured beside it: the pace of a machine differs from day
to day by more than any change of the program.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import Any

_COLUMNS = {
    "figure": 46, "min": 7, "median": 7, "max": 7, "unit": 11, "beside it": 42, "ratio": 6,
    "goal": 8, "": 7, "before": 16,
}  # fmt: skip
"""Their widths: a row is told before the next one is known."""
_LEFT = ("figure", "unit", "", "beside it")


class Verdict(StrEnum):
    """What became of a goal."""

    MET = "met"
    NOT_MET = "NOT MET"
    FAILED = "FAILED"
    NO_GOAL = ""


@dataclass(frozen=True, slots=True)
class Goal:
    """What has to be reached.

    Attributes:
        times: largest ratio of the median to the baseline's (smallest if more is better); None =
            nothing may be there at all, in no single value.
        at_least: whether more is better.
    """

    times: float | None
    at_least: bool = False

    def text(self) -> str:
        """In words: `<= 2x`, or `none`."""
        sign = ">=" if self.at_least else "<="
        return "none" if self.times is None else f"{sign} {self.times:.3g}x"

    def met(self, values: Sequence[float], ratio: float | None) -> bool:
        """Whether the values, whose median is `ratio` times the baseline's, are good enough."""
        if self.times is None:
            return not any(values)
        if ratio is None:
            return False
        return ratio >= self.times if self.at_least else ratio <= self.times


@dataclass(frozen=True, slots=True)
class Baseline:
    """The same thing measured with something else in the same run."""

    name: str
    values: Sequence[float]


@dataclass(frozen=True, slots=True)
class Figure:
    """One thing that was measured several times.

    Attributes:
        name: what it is.
        unit: of all its values.
        values: as measured, in order.
        goal: None = it is only told.
        baseline: what it is compared with; None = nothing.
        problem: why it could not be measured, in words; empty = it could.
    """

    name: str
    unit: str = ""
    values: Sequence[float] = ()
    goal: Goal | None = None
    baseline: Baseline | None = None
    problem: str = ""

    @property
    def ratio(self) -> float | None:
        """The median over the baseline's median; None without one."""
        if self.baseline is None or not self.values or not self.baseline.values:
            return None
        below = median(self.baseline.values)
        return median(self.values) / below if below else None

    @property
    def verdict(self) -> Verdict:
        """Whether the goal is met; without values it is not."""
        if self.problem or not self.values:
            return Verdict.FAILED
        if self.goal is None:
            return Verdict.NO_GOAL
        return Verdict.MET if self.goal.met(self.values, self.ratio) else Verdict.NOT_MET


@dataclass(frozen=True, slots=True)
class Machine:
    """Where it was measured, and how busy the machine was otherwise.

    Attributes:
        cores: that this process may use.
        load: mean numbers of waiting processes over 1, 5 and 15 minutes.
    """

    cpu: str
    cores: int
    system: str
    versions: dict[str, str]
    load: tuple[float, float, float]

    def text(self) -> str:
        """Two lines."""
        versions = ", ".join(f"{name} {number}" for name, number in self.versions.items())
        first = f"{self.cpu}, {self.cores} cores, {self.system}"
        return f"{first}\n{versions}; load average {load_text(self.load)}"


def this_machine(packages: Sequence[str]) -> Machine:
    """This machine now, with the versions of Python and of `packages`."""
    return Machine(
        cpu=_cpu(),
        cores=len(os.sched_getaffinity(0)),
        system=f"{platform.system()} {platform.release()}",
        versions={"Python": platform.python_version()} | {p: _version(p) for p in packages},
        load=os.getloadavg(),
    )


@dataclass(frozen=True, slots=True)
class Report:
    """All figures of one go.

    Attributes:
        machine: before it.
        load_after: the load average after it.
    """

    machine: Machine
    figures: Sequence[Figure]
    load_after: tuple[float, float, float]

    @property
    def good(self) -> bool:
        """Whether everything was measured and every goal is met."""
        bad = (Verdict.NOT_MET, Verdict.FAILED)
        return all(figure.verdict not in bad for figure in self.figures)

    def document(self) -> dict[str, Any]:
        """Everything with the single values, as JSON values."""
        figures = [
            asdict(figure) | {"verdict": figure.verdict.value, "ratio": figure.ratio}
            for figure in self.figures
        ]
        machine = asdict(self.machine) | {"load_after": self.load_after}
        return {"machine": machine, "figures": figures}


Before = Mapping[tuple[str, str], Figure]
"""The figures of an earlier go, by name and unit."""


def read_before(path: Path) -> Before:
    """The figures that an earlier go has written."""
    figures = (
        Figure(
            figure["name"],
            figure["unit"],
            figure["values"],
            baseline=figure["baseline"] and Baseline(**figure["baseline"]),
        )
        for figure in json.loads(path.read_text())["figures"]
    )
    return {(figure.name, figure.unit): figure for figure in figures}


def head() -> str:
    """The first two lines of the table."""
    rule = "|".join("-" * (width + 2) for width in _COLUMNS.values())
    return f"{_line(list(_COLUMNS))}\n|{rule}|"


def row(figure: Figure, before: Figure | None = None) -> str:
    """The line of a figure, beside that of an earlier go."""
    values, baseline = figure.values, figure.baseline
    spread = (min(values), median(values), max(values)) if values else ()
    beside = baseline and baseline.values and f"{baseline.name} {_number(median(baseline.values))}"
    earlier = before and before.values and f"{_number(median(before.values))}{_times(before.ratio)}"
    return _line(
        [
            figure.name,
            *(map(_number, spread) if spread else ("-",) * 3),
            figure.unit,
            beside or "",
            _times(figure.ratio).strip(" ()"),
            figure.goal.text() if figure.goal else "",
            figure.verdict.value,
            earlier or "",
        ]
    )


def _line(cells: Sequence[str]) -> str:
    aligned = (
        cell.ljust(width) if name in _LEFT else cell.rjust(width)
        for cell, (name, width) in zip(cells, _COLUMNS.items(), strict=True)
    )
    return f"| {' | '.join(aligned)} |"


def _times(ratio: float | None) -> str:
    return "" if ratio is None else f" ({ratio:.2f}x)"


def load_text(numbers: Sequence[float]) -> str:
    """Load averages, as they are told."""
    return ", ".join(f"{number:.2f}" for number in numbers)


def _number(value: float) -> str:
    """Three digits or a little more."""
    size = abs(value)
    digits = 0 if size >= 100 else 1 if size >= 10 else 2 if size >= 1 else 3
    return f"{value:.{digits}f}"


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    models = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(models, platform.machine())


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
