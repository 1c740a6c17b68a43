"""Standings: the indicators of each team in each condition, over its valid runs.

Only completed and timed-out runs enter, and the execution time only of completed ones.
"""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from madrob_console.history import RunSummary
from scoring.protocol import Outcome
from scoring.result import IndicatorName

PRACTICE = "simulated"
"""The source of practice runs."""


@dataclass(frozen=True, slots=True)
class Aggregate:
    """The values of one indicator over several runs, in its unit.

    Attributes:
        mean, median: of the values.
        deviation: the sample standard deviation (n - 1 in the denominator); None for one value.
        smallest, largest: of the values.
        count: how many values; at least 1.
    """

    mean: float
    median: float
    deviation: float | None
    smallest: float
    largest: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Aggregate | None:
        """The aggregate; None without values, or beyond the range of numbers."""
        if not values:
            return None
        try:
            mean = statistics.fmean(values)
            deviation = statistics.stdev(values) if len(values) > 1 else None
            median = float(statistics.median(values))
        except OverflowError:
            return None
        if not math.isfinite(median):
            return None
        return cls(mean, median, deviation, min(values), max(values), len(values))


@dataclass(frozen=True, slots=True)
class Standing:
    """One team in one condition.

    Runs under different rulesets stand apart: their numbers do not compare (section 9).

    Attributes:
        subject, team, condition, ruleset: whose runs; the condition's number.
        completed, timeout: valid runs.
        aborted: invalid runs.
        interrupted: runs cut off by a failure, and runs without a result yet.
        aggregates: by indicator; missing = no run has a value.
    """

    subject: int
    team: str
    condition: int
    ruleset: str
    completed: int = 0
    timeout: int = 0
    aborted: int = 0
    interrupted: int = 0
    aggregates: Mapping[IndicatorName, Aggregate] = field(default_factory=dict)


class _Key(NamedTuple):
    subject: int
    condition: int
    team: str
    ruleset: str


def standings(
    runs: Iterable[RunSummary], *, official: bool = True, best: int = 0
) -> tuple[Standing, ...]:
    """The standings by subject and condition.

    A run with a damaged result never counts, nor does a replay. A run without a result does not
    say where it came from: it is counted as interrupted wherever its team has a standing.

    Args:
        runs: from a history.
        official: runs on the real testbed; else the simulated ones. The two are never mixed.
        best: how many valid runs enter the aggregates: those with the highest capability level,
            completed before timed out, then with the least execution time. 0 = all. The counts
            are of all runs.
    """
    groups: dict[_Key, list[RunSummary]] = defaultdict(list)
    unfinished: list[RunSummary] = []
    for run in runs:
        if run.problem is not None:
            continue
        if run.outcome is None:
            unfinished.append(run)
        elif run.official if official else run.source == PRACTICE:
            groups[_key(run)].append(run)
    for run in unfinished:
        if _key(run) in groups:
            groups[_key(run)].append(run)
    return tuple(_standing(key, groups[key], best) for key in sorted(groups))


def _key(run: RunSummary) -> _Key:
    return _Key(run.subject, run.condition, run.team, run.ruleset)


def _standing(key: _Key, runs: Sequence[RunSummary], best: int) -> Standing:
    outcomes = [run.outcome for run in runs]
    valid = sorted((run for run in runs if run.valid), key=_rank)
    counted = valid[:best] if best else valid
    found = {name: Aggregate.of(_values(counted, name)) for name in IndicatorName}
    return Standing(
        subject=key.subject,
        team=key.team,
        condition=key.condition,
        ruleset=key.ruleset,
        completed=outcomes.count(Outcome.COMPLETED),
        timeout=outcomes.count(Outcome.TIMEOUT),
        aborted=outcomes.count(Outcome.ABORTED),
        interrupted=outcomes.count(Outcome.INTERRUPTED) + outcomes.count(None),
        aggregates={name: aggregate for name, aggregate in found.items() if aggregate},
    )


def _rank(run: RunSummary) -> tuple[float, bool, float, float]:
    """Smaller is better; of equals the earlier run."""
    values = run.values
    return (
        -values.get(IndicatorName.CAPABILITY_LEVEL, -1),
        run.outcome is Outcome.TIMEOUT,
        values.get(IndicatorName.EXECUTION_TIME, float("inf")),
        run.started,
    )


def _values(runs: Iterable[RunSummary], name: IndicatorName) -> list[float]:
    if name is IndicatorName.EXECUTION_TIME:
        runs = (run for run in runs if run.outcome is Outcome.COMPLETED)
    return [run.values[name] for run in runs if name in run.values]
