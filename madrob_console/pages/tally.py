"""Standings: the indicators of each team, in each condition and in all, over its valid runs.

Only completed and timed-out runs enter, and the execution time only of completed ones.
"""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

from madrob_console.archive.history import rank
from madrob_console.common.formatting import listed as first_of
from madrob_console.referee.flags import serious, undecided
from madrob_console.referee.run_summary import VOID, RunSummary
from madrob_console.referee.team_list import TeamName
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import DOUBTED, Uncertainty, distinguishable

ALIKE = "~"
"""Mark of a mean that is not distinguishable from another team's."""

_MOST_NAMED = 4
"""Limit of named teams from which a mean is not distinguishable; others are counted."""


@dataclass(frozen=True, slots=True)
class Aggregate:
    """The values of one indicator over several runs, in its unit.

    Attributes:
        deviation: the sample standard deviation (n - 1 in the denominator); None for one value.
        count: how many values; at least 1.
        uncertainty: of the mean, by measurement or by the scatter of the values, whichever is
            larger; None = that of a value is not known.
    """

    mean: float
    median: float
    deviation: float | None
    smallest: float
    largest: float
    count: int
    uncertainty: Uncertainty | None = None

    @classmethod
    def of(
        cls, values: Sequence[float], uncertainties: Sequence[Uncertainty | None] = ()
    ) -> Aggregate | None:
        """The aggregate of values with their uncertainties; None without values, or on overflow."""
        if not values:
            return None
        try:
            mean, median = _mean_and_median(values)
            deviation = _deviation(values, mean) if len(values) > 1 else None
        except OverflowError:
            return None
        uncertainty = Uncertainty.of_mean(uncertainties, deviation)
        return cls(mean, median, deviation, min(values), max(values), len(values), uncertainty)

    @classmethod
    def of_means(cls, parts: Sequence[Aggregate]) -> Aggregate | None:
        """Over different conditions; None without any, or on overflow.

        Their scatter is no part of the mean's uncertainty.
        """
        if not parts:
            return None
        try:
            mean, median = _mean_and_median([part.mean for part in parts])
        except OverflowError:
            return None
        spread = Uncertainty.of_mean([part.uncertainty for part in parts])
        count = sum(part.count for part in parts)
        smallest, largest = (min(p.smallest for p in parts), max(p.largest for p in parts))
        return cls(mean, median, None, smallest, largest, count, spread)


def _mean_and_median(values: Sequence[float]) -> tuple[float, float]:
    """Raises OverflowError where the sum of values is beyond the range of numbers."""
    median = float(statistics.median(values))
    if not math.isfinite(median):
        raise OverflowError
    return statistics.fmean(values), median


def _deviation(values: Sequence[float], mean: float) -> float:
    """As `statistics.stdev`, which computes with fractions and takes ten times as long."""
    return math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (len(values) - 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """The runs of one team, counted and aggregated.

    Runs under different rulesets stand apart: their numbers do not compare (protocol section 9).

    Attributes:
        team: its name; empty = it has none.
        other_names: in its runs; those runs count all the same.
        completed, timeout: valid runs.
        aborted: invalid runs.
        voided: runs that the referee voided, however they ended; the other counts are without them.
        interrupted: runs cut off by a failure.
        without_result: current runs, and runs that wait for the referee.
        counted: how many runs the aggregates are of.
        flagged: valid runs with a serious flag.
        undecided: those of them that wait for a decision of the referee.
        open_protests: runs with an undecided protest, even if they do not count: not final.
        aggregates: by indicator; missing = no run has a value.
        doubts: number on the runs of the aggregates, by indicator, even without a value.
        alike: by indicator, the subjects whose means are not distinguishable from its own
            (protocol section 11); missing = none.
    """

    subject: int
    team: str
    ruleset: str
    other_names: tuple[str, ...] = ()
    testbeds: tuple[str, ...] = ()
    completed: int = 0
    timeout: int = 0
    aborted: int = 0
    voided: int = 0
    interrupted: int = 0
    without_result: int = 0
    counted: int = 0
    flagged: int = 0
    undecided: int = 0
    open_protests: int = 0
    aggregates: Mapping[IndicatorName, Aggregate] = field(default_factory=dict)
    doubts: Mapping[IndicatorName, int] = field(default_factory=dict)
    alike: Mapping[IndicatorName, tuple[int, ...]] = field(default_factory=dict)

    @property
    def not_final_words(self) -> str:
        count = self.open_protests
        return f"NOT FINAL: {count} PROTEST{'S' if count > 1 else ''} open" if count else ""

    @property
    def who(self) -> str:
        return f"{self.subject} {self.team}".rstrip()

    @property
    def flag_sign(self) -> str:
        """`P`: a protest is open, `!!`: the referee has to decide, `!`: a flag changes a score."""
        if self.open_protests:
            return "P"
        return "!!" if self.undecided else "!" if self.flagged else ""

    def signs(self, name: IndicatorName, *, of_mean: bool = True) -> str:
        """Signs behind a number of an indicator; only means have `ALIKE`."""
        doubted = DOUBTED if name in self.doubts else ""
        return doubted + (ALIKE if of_mean and name in self.alike else "")


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing(Tally):
    """One team in one condition; `best` is its best valid run, if it has one."""

    condition: int
    best: RunSummary | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Overall(Tally):
    """One team in all its conditions together; every condition weighs the same."""

    conditions: tuple[int, ...]


_T = TypeVar("_T", bound=Tally)


def counts(tally: Tally) -> Iterator[str]:
    for count, word in (
        (tally.completed, "completed"),
        (tally.timeout, "timeout"),
        (tally.aborted, "INVALID"),
        (tally.voided, VOID),
        (tally.interrupted, "INTERRUPTED"),
        (tally.without_result, "without a result yet"),
    ):
        if count:
            yield f"{count} {word}"
    if tally.not_final_words:
        yield tally.not_final_words


def subjects_text(subjects: Sequence[int]) -> str:
    """The first of some teams: `2, 5`, or `2, 5, 7, 8 and 12 more`."""
    return first_of([*map(str, subjects)], _MOST_NAMED)


class _Key(NamedTuple):
    subject: int
    condition: int
    ruleset: str


_Groups = Mapping[_Key, Sequence[RunSummary]]


def standings(
    runs: Iterable[RunSummary],
    *,
    official: bool = True,
    best: int = 0,
    listed: Mapping[int, str] | None = None,
) -> tuple[Standing, ...]:
    """The standings by subject and condition.

    A run with a damaged result never counts, nor does a replay. A run without a result is counted
    as such wherever its team has a standing. Official and practice runs are never mixed.

    `best` is how many valid runs enter the aggregates: those with the highest capability level,
    completed before timed out, then with the least execution time of completed ones. 0 = all. The
    counts are of all runs. `listed` maps subjects to teams; a team that is not in it has the name
    of its latest run.
    """
    groups = _grouped(runs, official=official)
    names = _names(groups, listed or {})
    standings = [
        Standing(
            condition=key.condition,
            best=min((run for run in groups[key] if run.valid), key=rank, default=None),
            **_tally(key, names, [groups[key]], best),
        )
        for key in sorted(groups)
    ]
    if best == 1:  # the uncertainty of a run is not that of the best of some
        return tuple(standings)
    return _told_apart(standings, lambda standing: (standing.condition, standing.ruleset))


def leaders_first(standings: Iterable[Standing]) -> list[Standing]:
    """By condition, in each by the teams' best runs as `rank` orders them; of equal ones by number.

    Screens, commands and pages order teams by this alone.
    """
    return sorted(
        standings,
        key=lambda standing: (
            standing.condition,
            standing.ruleset,
            _place(standing),
            standing.subject,
        ),
    )


def leaders(standings: Iterable[Standing]) -> list[Standing]:
    """The best of each condition, each one of several that are equal."""
    of: dict[tuple[int, str], list[Standing]] = defaultdict(list)
    for standing in standings:
        if standing.best is not None:
            of[standing.condition, standing.ruleset].append(standing)
    least = {key: min(map(_place, teams)) for key, teams in of.items()}
    return [
        standing
        for key, teams in of.items()
        for standing in teams
        if _place(standing) == least[key]
    ]


def _place(standing: Standing) -> tuple[float, bool, float]:
    """Level, completed or not, time; which of two equal runs was the first does not count."""
    return (math.inf, True, math.inf) if standing.best is None else rank(standing.best)[:3]


def overall(
    runs: Iterable[RunSummary],
    *,
    official: bool = True,
    best: int = 0,
    listed: Mapping[int, str] | None = None,
) -> tuple[Overall, ...]:
    """The standings by subject, over all conditions; `best` runs of each condition enter.

    A mean is that of the means of those conditions in which each team has one: times of different
    conditions do not compare.
    """
    groups = _grouped(runs, official=official)
    names = _names(groups, listed or {})
    of_team: dict[tuple[int, str], list[_Key]] = defaultdict(list)
    of_rules: dict[str, list[Mapping[int, Mapping[IndicatorName, Aggregate]]]] = defaultdict(list)
    for key in sorted(groups):
        of_team[key.subject, key.ruleset].append(key)
    single = {key: _tally(key, names, [groups[key]], best)["aggregates"] for key in groups}
    for (_, ruleset), keys in of_team.items():
        of_rules[ruleset].append({key.condition: single[key] for key in keys})
    teams = []
    for (_, ruleset), keys in of_team.items():
        tally = _tally(keys[0], names, [groups[key] for key in keys], best)
        tally["aggregates"] = {}
        for name in IndicatorName:
            having = [{n for n, of in each.items() if name in of} for each in of_rules[ruleset]]
            common = set.intersection(*filter(None, having)) if any(having) else set()
            means = [
                single[key][name] for key in keys if key.condition in common and name in single[key]
            ]
            if (aggregate := Aggregate.of_means(means)) is not None:
                tally["aggregates"][name] = aggregate
        teams.append(Overall(conditions=tuple(key.condition for key in keys), **tally))
    return _told_apart(teams, lambda team: team.ruleset)


def _grouped(runs: Iterable[RunSummary], *, official: bool) -> _Groups:
    groups: dict[_Key, list[RunSummary]] = defaultdict(list)
    unfinished: list[RunSummary] = []
    for run in runs:
        if run.problem is not None or run.never_ran or run.twin:
            continue
        if run.outcome is None:
            unfinished.append(run)
        elif run.official if official else run.practice:
            groups[_key(run)].append(run)
    for run in unfinished:
        if _key(run) in groups and not (official and run.practice):
            groups[_key(run)].append(run)
    return groups


def _key(run: RunSummary) -> _Key:
    return _Key(run.subject, run.condition, run.ruleset)


def _names(groups: _Groups, listed: Mapping[int, str]) -> Mapping[int, TeamName]:
    of: dict[int, list[RunSummary]] = defaultdict(list)
    for key, runs in groups.items():
        of[key.subject] += runs
    return {
        subject: TeamName.of(
            listed.get(subject, ""),
            (run.team for run in sorted(runs, key=lambda run: (run.started, run.folder))),
        )
        for subject, runs in of.items()
    }


def _tally(
    key: _Key,
    names: Mapping[int, TeamName],
    groups: Iterable[Sequence[RunSummary]],
    best: int,
) -> dict[str, Any]:
    team = names[key.subject]
    outcomes: list[Outcome | None] = []
    voided = protests = 0
    counted: list[RunSummary] = []
    flagged: list[RunSummary] = []
    testbeds: set[str] = set()
    for runs in groups:
        testbeds.update(run.testbed for run in runs if run.testbed)
        outcomes += [run.outcome for run in runs if not run.voided]
        voided += sum(run.voided for run in runs)
        protests += sum(run.protest_filed is not None for run in runs)
        valid = sorted((run for run in runs if run.valid), key=rank)
        flagged += [run for run in valid if serious(run.flags)]
        counted += valid[:best] if best else valid
    aggregates = {name: aggregate_of(counted, name) for name in IndicatorName}
    doubts = {name: sum(run.doubts.get(name, 0) for run in counted) for name in IndicatorName}
    return {
        "subject": key.subject,
        "team": team.name,
        "other_names": team.others,
        "testbeds": tuple(sorted(testbeds)),
        "ruleset": key.ruleset,
        "completed": outcomes.count(Outcome.COMPLETED),
        "timeout": outcomes.count(Outcome.TIMEOUT),
        "aborted": outcomes.count(Outcome.ABORTED),
        "voided": voided,
        "interrupted": outcomes.count(Outcome.INTERRUPTED),
        "without_result": outcomes.count(None),
        "counted": len(counted),
        "flagged": len(flagged),
        "undecided": sum(bool(undecided(run.flags)) for run in flagged),
        "open_protests": protests,
        "aggregates": {name: aggregate for name, aggregate in aggregates.items() if aggregate},
        "doubts": {name: count for name, count in doubts.items() if count},
    }


def aggregate_of(runs: Iterable[RunSummary], name: IndicatorName) -> Aggregate | None:
    """An indicator over some runs; the execution time over the completed ones of them."""
    if name is IndicatorName.EXECUTION_TIME:
        runs = (run for run in runs if run.outcome is Outcome.COMPLETED)
    having = [run for run in runs if name in run.values]
    values = [run.values[name] for run in having]
    return Aggregate.of(values, [run.uncertainties.get(name) for run in having])


def _told_apart(tallies: Sequence[_T], beside: Callable[[_T], Hashable]) -> tuple[_T, ...]:
    """The tallies with `alike`; those with the same `beside` are compared, one of each subject."""
    groups: dict[Hashable, list[_T]] = defaultdict(list)
    for tally in tallies:
        groups[beside(tally)].append(tally)
    return tuple(replace(tally, alike=_alike(tally, groups[beside(tally)])) for tally in tallies)


def _alike(tally: Tally, others: Iterable[Tally]) -> Mapping[IndicatorName, tuple[int, ...]]:
    alike = {
        name: sorted(
            other.subject
            for other in others
            if other.subject != tally.subject and _is_tie(mean, other.aggregates.get(name))
        )
        for name, mean in tally.aggregates.items()
    }
    return {name: tuple(subjects) for name, subjects in alike.items() if subjects}


def _is_tie(aggregate: Aggregate, other: Aggregate | None) -> bool:
    return other is not None and not distinguishable(
        aggregate.mean, other.mean, aggregate.uncertainty, other.uncertainty
    )
