"""A competition's standings: which runs count, which do not and why (protocol sections 2 and 9)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from madrob_console.archive.history import RunSummary
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe
from madrob_console.standings.tally import Aggregate, Overall, Standing, overall, standings
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, Outcome

CONDITION_NUMBERS = range(1, 21)
"""All that there are (section 1)."""


class LeftOut(NamedTuple):
    """A run that enters no aggregate, and why."""

    run: RunSummary
    why: str


@dataclass(frozen=True, slots=True)
class RulesetStandings:
    """All teams under one ruleset.

    Attributes:
        ruleset: its name.
        overall: each team in all its conditions together, by subject.
        conditions: by condition, in the order of their numbers, each team in it by subject.
    """

    ruleset: str
    overall: tuple[Overall, ...]
    conditions: Mapping[Condition, tuple[Standing, ...]]


@dataclass(frozen=True, slots=True)
class CompetitionStandings:
    """The standings of one competition, or of all runs of a results folder.

    Attributes:
        made: when, s since the epoch.
        competitions: the names that the runs carry; empty text = none was set.
        official: runs on the real testbed; else simulated ones, which count for nothing.
        best: how many runs of each team in each condition enter; 0 = all.
        groups: one a ruleset, by its name; their numbers do not compare.
        left_out: invalid, interrupted, unfinished and damaged runs, oldest first.
        provisional: valid runs whose result is not final yet.
        protested: valid runs against whose final result the team protested.
    """

    made: float
    competitions: tuple[str, ...]
    official: bool
    best: int
    groups: tuple[RulesetStandings, ...]
    left_out: tuple[LeftOut, ...]
    provisional: int
    protested: int

    @property
    def title(self) -> str:
        """The competition's name; empty for none or several."""
        return self.competitions[0] if len(self.competitions) == 1 else ""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What has to be known of the whole: competitions together, rulesets apart."""
        remarks = []
        if len(self.competitions) > 1:
            names = ", ".join(name or "(none was set)" for name in self.competitions)
            count = len(self.competitions)
            remarks.append(f"Runs of {count} competitions count together: {names}.")
        if len(self.groups) > 1:
            names = ", ".join(group.ruleset for group in self.groups)
            remarks.append(
                f"Runs under several rulesets stand apart, do not compare them: {names}."
            )
        if self.provisional:
            remarks.append(f"Provisional: {self.provisional} of the valid runs are not final yet.")
        if self.protested:
            remarks.append(f"PROTESTED by the team: {self.protested} of the valid runs.")
        return tuple(remarks)

    @property
    def basis(self) -> str:
        """Which runs the numbers are of."""
        kind = "official" if self.official else "SIMULATED"
        if not self.best:
            return f"Over all valid {kind} runs."
        return (
            f"Over the best {self.best} valid {kind} runs of each team in each condition: highest "
            "capability level, completed before timed out, least execution time."
        )


NOTES = (
    "Execution time: completed runs only. std: sample standard deviation (n - 1).",
    "All conditions together: every run weighs the same.",
    "Teams stand in the order of their numbers: the protocol makes no ranking.",
)
"""How to read the numbers."""


def competition_standings(
    runs: Sequence[RunSummary],
    *,
    made: float,
    competition: str | None = None,
    official: bool = True,
    best: int = 0,
) -> CompetitionStandings:
    """The standings over all teams.

    A run without a result tells neither competition nor where it came from: it is always listed,
    and counted as interrupted where its team has a standing. So is a damaged one, only listed.

    Args:
        runs: from a history.
        made: now, s since the epoch.
        competition: only runs of the competition of this name; None = all.
        official: as for `standings`.
        best: as for `standings`.

    Raises:
        MadrobError: no run is of this competition.
    """
    told = [run for run in runs if _told(run) and _of_kind(run, official=official)]
    names = sorted({run.competition for run in told})
    if competition is not None and competition not in names:
        known = ", ".join(f"'{terminal_safe(name)}'" for name in names) or "none"
        raise MadrobError(
            f"--competition '{terminal_safe(competition)}': no such runs; there are {known}"
        )
    if competition is not None:
        names = [competition]
    entering = [
        run
        for run in runs
        if not _told(run) or (_of_kind(run, official=official) and run.competition in names)
    ]
    left_out = [LeftOut(run, _why(run)) for run in entering if not run.valid]
    return CompetitionStandings(
        made=made,
        competitions=tuple(names),
        official=official,
        best=best,
        groups=_groups(entering, official=official, best=best),
        left_out=tuple(left_out),
        provisional=sum(run.valid and not run.final for run in entering),
        protested=sum(run.valid and run.closing == "protested" for run in entering),
    )


def statistics_of(aggregate: Aggregate | None, name: IndicatorName) -> dict[str, float | None]:
    """EUROBENCH's aggregates of an indicator by name, `min` and `max` where it has them."""
    a = aggregate
    found = {
        "mean": a.mean if a else None,
        "median": a.median if a else None,
        "std": a.deviation if a else None,
    }
    if name.spec.extremes:
        found["min"] = a.smallest if a else None
        found["max"] = a.largest if a else None
    return found


def _groups(
    runs: Sequence[RunSummary], *, official: bool, best: int
) -> tuple[RulesetStandings, ...]:
    together = overall(runs, official=official, best=best)
    single = standings(runs, official=official, best=best)
    return tuple(
        RulesetStandings(
            ruleset,
            tuple(one for one in together if one.ruleset == ruleset),
            _by_condition(one for one in single if one.ruleset == ruleset),
        )
        for ruleset in sorted({one.ruleset for one in together})
    )


def _by_condition(found: Iterable[Standing]) -> dict[Condition, tuple[Standing, ...]]:
    of: dict[int, list[Standing]] = {}
    for standing in found:
        of.setdefault(standing.condition, []).append(standing)
    return {Condition.from_number(number): tuple(of[number]) for number in sorted(of)}


def _told(run: RunSummary) -> bool:
    """Whether its result says what it is."""
    return run.problem is None and run.outcome is not None


def _of_kind(run: RunSummary, *, official: bool) -> bool:
    return run.official if official else run.practice


def _why(run: RunSummary) -> str:
    if run.problem is not None:
        return run.problem
    if run.outcome is None:
        return "no result yet: it goes on, or waits for a decision in `madrob console`"
    if run.reason:
        return run.reason
    aborted = run.outcome is Outcome.ABORTED
    return "the referee gave no reason" if aborted else "the machine failed"
