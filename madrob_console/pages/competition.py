"""Teams and conditions compared, each testbed apart."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
from msgspec.structs import replace

from madrob_console.archive.collection import the_competition
from madrob_console.archive.history import of_competition
from madrob_console.common.formatting import listed as first_of
from madrob_console.common.names import is_rehearsal
from madrob_console.pages.notes import PRACTICE_STANDINGS, REHEARSED
from madrob_console.pages.tally import (
    ALIKE,
    Aggregate,
    Overall,
    Standing,
    leaders_first,
    overall,
    standings,
)
from madrob_console.referee.flags import serious, undecided
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import WITH_EXTREMES, IndicatorName
from scoring.protocol import Condition, Thresholds
from scoring.result import DOUBTED, decimals_left


def how_testbeds_differ(runs: Iterable[RunSummary]) -> str:
    """Differences between the testbeds of the valid runs, in a sentence; empty = none.

    Compared are the rulesets, the numbers of the settings (`thresholds`) and the sampling rates of
    the door, as far as results state them.
    """
    of: dict[str, list[RunSummary]] = defaultdict(list)
    for run in runs:
        if run.valid:
            of[run.testbed].append(run)
    if len(of) < 2:
        return ""
    facts = {name or "(no name)": dict(_testbed_facts(of[name])) for name in sorted(of)}
    keys = dict.fromkeys(key for of_testbed in facts.values() for key in of_testbed)
    differing = [words for key in keys if (words := _differing(key, facts))]
    return f"The testbeds differ: {'; '.join(differing)}." if differing else ""


def _differing(key: str, facts: Mapping[str, Mapping[str, str]]) -> str:
    """Values of each testbed, where not all known ones are the same."""
    values = {name: having[key] for name, having in facts.items() if key in having}
    if len(set(values.values())) < 2:
        return ""
    return f"{key} {', '.join(f'{value} ({name})' for name, value in values.items())}"


def _testbed_facts(runs: Sequence[RunSummary]) -> Iterator[tuple[str, str]]:
    yield "ruleset", " and ".join(sorted({run.ruleset for run in runs}))
    rates = [run.rate for run in runs if run.rate is not None]
    if rates:
        yield "sampling rate", f"{statistics.median(rates):.0f} Hz"
    every = (run.thresholds for run in runs if run.thresholds is not None)
    unlike = {msgspec.json.encode(thresholds): thresholds for thresholds in every}.values()
    if unlike:
        for name, usual in Thresholds().numbers.items():
            values = {_text(thresholds.get(name, usual)) for thresholds in unlike}
            yield name, " and ".join(sorted(values))


def _text(value: Any) -> str:  # noqa: ANN401  a number of the settings, or several
    return f"{value:g}" if isinstance(value, int | float) else "/".join(f"{v:g}" for v in value)


CONDITION_NUMBERS = range(1, 21)
"""All conditions (protocol section 1)."""


@dataclass(frozen=True, slots=True)
class RulesetStandings:
    """All teams under one ruleset."""

    ruleset: str
    overall: tuple[Overall, ...]
    conditions: Mapping[Condition, tuple[Standing, ...]]


@dataclass(frozen=True, slots=True)
class CompetitionStandings:
    """The standings of one competition.

    Attributes:
        made: s since the epoch.
        title: the competition's name; empty = none was set.
        official: runs that count, of a rehearsal in it only; else practice runs.
        best: how many runs of each team in each condition enter; 0 = all.
        groups: one a ruleset, by its name; their numbers do not compare.
        left_out: invalid, interrupted, unfinished and damaged runs, oldest first.
        flagged: valid runs with a serious flag, oldest first.
        provisional: valid runs whose result is not final yet.
        protested: valid runs against whose final result the team protested.
        open_protests: undecided, the first filed first; also of runs that do not count.
        apart: differences between the testbeds of the valid runs; empty = none.
        renamed: teams whose runs carry several names, a sentence each.
    """

    made: float
    title: str
    official: bool
    best: int
    groups: tuple[RulesetStandings, ...]
    left_out: tuple[RunSummary, ...]
    flagged: tuple[RunSummary, ...]
    provisional: int
    protested: int
    open_protests: tuple[RunSummary, ...] = ()
    apart: str = ""
    renamed: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """`official`, `rehearsal` or `practice`."""
        counting = "rehearsal" if is_rehearsal(self.title) else "official"
        return counting if self.official else "practice"

    @property
    def banner(self) -> str:
        """What stands above everything else; empty = it is official."""
        rehearsal = REHEARSED if is_rehearsal(self.title) else ""
        return " ".join(filter(None, (rehearsal, "" if self.official else PRACTICE_STANDINGS)))

    @property
    def remarks(self) -> tuple[str, ...]:
        remarks = []
        if len(self.groups) > 1:
            names = ", ".join(group.ruleset for group in self.groups)
            remarks.append(
                f"Runs under several rulesets stand apart, do not compare them: {names}."
            )
        if self.apart:
            remarks.append(self.apart)
        remarks += self.renamed
        if self.provisional:
            remarks.append(f"Not final: {self.provisional} of the valid runs.")
        if count := sum(bool(undecided(run.flags)) for run in self.flagged):
            remarks.append(f"UNDECIDED: {count} of the valid runs, for the referee to decide.")
        for run in self.open_protests:
            remarks.append(
                f"PROTEST open against run {run.run_number} of subject {run.subject} in condition "
                f"{run.condition}: NOT FINAL until it is decided."
            )
        if self.protested:
            remarks.append(f"PROTESTED by the team: {self.protested} of the valid runs.")
        return tuple(remarks)

    @property
    def basis(self) -> str:
        if not self.best:
            return f"Over all valid {self.kind} runs."
        return (
            f"Over the best {self.best} valid {self.kind} runs of each team in each condition: "
            "highest capability level, completed before timed out, least execution time of "
            "completed ones."
        )


SIGNS = f"{DOUBTED} doubted   {ALIKE} a tie with another team within unrounded uncertainty"

FLAG_SIGNS = "P protest open   !! the referee has to decide   ! a flag changes a score"

BY_BEST = "Each team's best run: level, then time. The protocol makes no ranking."

LEADER_FIRST = "In each condition the leader stands first. The protocol makes no ranking."

NUMBER_NOTES = (
    "Execution time: completed runs only. std: sample standard deviation (n - 1).",
    f"min and max are told of {WITH_EXTREMES}, as EUROBENCH does.",
    "All conditions together: the mean of the means of those in which each team has a value.",
    "+-: of the mean, rounded up: by measurement, or Student's t std / sqrt(runs) if larger.",
    f"{SIGNS}.",
)

NOTES = (LEADER_FIRST, *NUMBER_NOTES)


def competition_standings(
    runs: Sequence[RunSummary],
    *,
    made: float,
    competition: str | None = None,
    official: bool = True,
    best: int = 0,
    listed: Mapping[int, str] | None = None,
) -> CompetitionStandings:
    """The standings over all teams.

    A run without a result is listed, and counted as such where its team has a standing, but not
    among official runs if it is known to be practice. A damaged run is only listed, as practice if
    it lies there. A run whose files do not name a competition may be of any. `made` is in s since
    the epoch. `competition` None = there is only one, else MadrobError.
    """
    title, entering = entering_runs(runs, competition, official=official)
    groups = _groups(entering, official=official, best=best, listed=listed or {})
    teams = {team.subject: team for group in groups for team in group.overall}

    def named(run: RunSummary) -> RunSummary:
        team = teams.get(run.subject)
        return run if team is None else replace(run, team=team.team)

    return CompetitionStandings(
        made=made,
        title=title,
        official=official,
        best=best,
        groups=groups,
        left_out=tuple(named(run) for run in entering if not run.valid and not run.never_ran),
        flagged=tuple(named(run) for run in entering if run.valid and serious(run.flags)),
        provisional=sum(run.valid and not run.final for run in entering),
        protested=sum(run.valid and run.closing == "protested" for run in entering),
        open_protests=tuple(
            sorted(
                (named(run) for run in entering if run.protest_filed is not None),
                key=lambda run: run.protest_filed or 0.0,
            )
        ),
        apart=how_testbeds_differ(entering),
        renamed=tuple(
            words for subject in sorted(teams) for words in _renamed(teams[subject], entering)
        ),
    )


def _renamed(team: Overall, runs: Iterable[RunSummary]) -> Iterator[str]:
    for name in team.other_names:
        which = [
            f"run {run.run_number} in condition {run.condition}"
            for run in runs
            if (run.subject, run.team) == (team.subject, name)
        ]
        yield f"Under another name, '{name}', {team.who} also has {first_of(which, 3)}."


def entering_runs(
    runs: Sequence[RunSummary], competition: str | None, *, official: bool
) -> tuple[str, Sequence[RunSummary]]:
    """The competition's name and all its runs; arguments as for `competition_standings`."""
    wanted = [run for run in runs if _is_wanted(run, official=official)]
    title = the_competition([run for run in wanted if _has_result(run)] or wanted, competition)
    return title or "", of_competition(wanted, title)


def statistics_of(aggregate: Aggregate | None, name: IndicatorName) -> dict[str, float | None]:
    """EUROBENCH's aggregates of an indicator by name, `min` and `max` where it has them."""
    a = aggregate
    statistics = {
        "mean": a.mean if a else None,
        "median": a.median if a else None,
        "std": a.deviation if a else None,
    }
    if name.spec.extremes:
        statistics["min"] = a.smallest if a else None
        statistics["max"] = a.largest if a else None
    return statistics


_SINGLE = ("min", "max")


def statistics_text(
    aggregate: Aggregate | None, name: IndicatorName, width: int = 12
) -> dict[str, str]:
    """`statistics_of` as text of up to `width` characters; unknown ones are missing.

    All have the digits of their indicator, so that those of all teams are aligned. But for single
    values they have none that the mean's uncertainty does not leave; the standard deviation, often
    less than 1, has one more.
    """
    decimals, uncertainty = name.spec.decimals, aggregate.uncertainty if aggregate else None
    left = (
        decimals_left(uncertainty) if uncertainty is not None and uncertainty.expanded else decimals
    )
    return {
        word: _statistic_text(
            value, decimals if word in _SINGLE else min(decimals, left + (word == "std")), width
        )
        for word, value in statistics_of(aggregate, name).items()
        if value is not None
    }


def _statistic_text(value: float, decimals: int, width: int) -> str:
    """Smallest and largest counts are as they are; a text that is too wide is in powers of ten."""
    text = str(value) if isinstance(value, int) else f"{value:.{decimals}f}"
    if len(text) <= width:
        return text
    powers = f"{value:.1e}"
    return powers if len(powers) <= width else f"{value:.0e}"


def best_text(of: Standing, name: IndicatorName) -> str:
    """An indicator of a team's best run, the only one that `of` is over; why it has no time."""
    aggregate = of.aggregates.get(name)
    if aggregate is None:
        return "timeout" if of.counted and name is IndicatorName.EXECUTION_TIME else "-"
    return f"{aggregate.mean:.0f}" if name.spec.counts else statistics_text(aggregate, name)["mean"]


def _groups(
    runs: Sequence[RunSummary], *, official: bool, best: int, listed: Mapping[int, str]
) -> tuple[RulesetStandings, ...]:
    together = overall(runs, official=official, best=best, listed=listed)
    single = leaders_first(standings(runs, official=official, best=best, listed=listed))
    return tuple(
        RulesetStandings(
            ruleset,
            tuple(standing for standing in together if standing.ruleset == ruleset),
            _by_condition(standing for standing in single if standing.ruleset == ruleset),
        )
        for ruleset in sorted({standing.ruleset for standing in together})
    )


def _by_condition(standings: Iterable[Standing]) -> dict[Condition, tuple[Standing, ...]]:
    of: dict[int, list[Standing]] = {}
    for standing in standings:
        of.setdefault(standing.condition, []).append(standing)
    return {Condition.from_number(number): tuple(of[number]) for number in sorted(of)}


def _has_result(run: RunSummary) -> bool:
    return run.problem is None and run.outcome is not None


def _is_wanted(run: RunSummary, *, official: bool) -> bool:
    if run.problem is not None:
        return run.practice is not official
    if run.outcome is None:
        return not (official and run.practice)
    return run.official if official else run.practice
