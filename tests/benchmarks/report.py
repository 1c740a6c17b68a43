"""Measurements beside their goals and baselines, as a table for people and JSON for programs."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import Any

_HEAD = ("figure", "min", "median", "max", "unit", "goal", "", "beside it", "ratio")
_LEFT = ("figure", "unit", "", "beside it")


class Verdict(StrEnum):
    """What became of a goal."""

    MET = "met"
    NOT_MET = "NOT MET"
    FAILED = "FAILED"
    NO_GOAL = ""


@dataclass(frozen=True, slots=True)
class Goal:
    """What every single value has to reach: the worst one decides.

    Attributes:
        limit: in the unit of the figure; None = no limit.
        at_least: whether more is better.
        times: largest ratio of the median to the baseline's (smallest if more is better); None =
            any.
    """

    limit: float | None = None
    at_least: bool = False
    times: float | None = None

    def text(self) -> str:
        """In words: `<= 0.5, <= 2x`."""
        sign = ">=" if self.at_least else "<="
        limit = [] if self.limit is None else [f"{sign} {self.limit:g}"]
        times = [] if self.times is None else [f"{sign} {self.times:g}x"]
        return ", ".join(limit + times)

    def reached(self, value: float, limit: float | None) -> bool:
        """Whether `value` is on the right side of `limit`."""
        return limit is None or (value >= limit if self.at_least else value <= limit)


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
        met = all(self.goal.reached(value, self.goal.limit) for value in self.values)
        if self.goal.times is not None:
            met &= self.ratio is not None and self.goal.reached(self.ratio, self.goal.times)
        return Verdict.MET if met else Verdict.NOT_MET


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
        return f"{first}\n{versions}; load average {_load(self.load)}"


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

    def text(self) -> str:
        """The machine, the table, and what could not be measured."""
        rows = [_HEAD, *map(_row, self.figures)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [_line(row, widths) for row in rows]
        rule = "|".join("-" * (width + 2) for width in widths)
        problems = [f"FAILED {f.name}: {f.problem}" for f in self.figures if f.problem]
        after = f"load average afterwards {_load(self.load_after)}"
        table = [lines[0], f"|{rule}|", *lines[1:]]
        return "\n".join([self.machine.text(), "", *table, *problems, "", after])

    def document(self) -> dict[str, Any]:
        """Everything with the single values, as JSON values."""
        figures = [
            asdict(figure) | {"verdict": figure.verdict.value, "ratio": figure.ratio}
            for figure in self.figures
        ]
        machine = asdict(self.machine) | {"load_after": self.load_after}
        return {"machine": machine, "figures": figures}


def _row(figure: Figure) -> tuple[str, ...]:
    values, baseline = figure.values, figure.baseline
    spread = (min(values), median(values), max(values)) if values else ()
    beside = baseline and baseline.values and f"{baseline.name} {_number(median(baseline.values))}"
    ratio = figure.ratio
    return (
        figure.name,
        *(map(_number, spread) if spread else ("-",) * 3),
        figure.unit,
        figure.goal.text() if figure.goal else "",
        figure.verdict.value,
        beside or "",
        "" if ratio is None else f"{ratio:.2f}x",
    )


def _line(row: Sequence[str], widths: Sequence[int]) -> str:
    cells = (
        cell.ljust(width) if name in _LEFT else cell.rjust(width)
        for name, cell, width in zip(_HEAD, row, widths, strict=True)
    )
    return f"| {' | '.join(cells)} |"


def _load(numbers: Sequence[float]) -> str:
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
    return next(models, platform.processor() or platform.machine())


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
