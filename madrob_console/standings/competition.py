"""A competition's standings: which runs count, which do not and why (protocol sections 2 and 9)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from msgspec.structs import replace

from madrob_console.archive.history import RunSummary, time_words
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe
from madrob_console.referee.flags import undecided, weighty
from madrob_console.referee.protests import deadline_words
from madrob_console.standings.tally import ALIKE, Aggregate, Overall, Standing, overall, standings
from madrob_console.standings.testbeds_apart import how_testbeds_differ
from scoring.indicator_table import WITH_EXTREMES, IndicatorName
from scoring.protocol import Condition, Outcome
from scoring.result import DOUBTED, decimals_left

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
        official: official runs; else practice runs, which count for nothing.
        best: how many runs of each team in each condition enter; 0 = all.
        groups: one a ruleset, by its name; their numbers do not compare.
        left_out: invalid, interrupted, unfinished and damaged runs, oldest first.
        flagged: valid runs with a flag that weighs, oldest first.
        provisional: valid runs whose result is not final yet.
        protested: valid runs against whose final result the team protested.
        open_protests: runs, also such as do not count, with a protest that is not decided, what is
            due first first.
        apart: in what the testbeds of the valid runs differ, in a sentence; empty = in nothing.
    """

    made: float
    competitions: tuple[str, ...]
    official: bool
    best: int
    groups: tuple[RulesetStandings, ...]
    left_out: tuple[LeftOut, ...]
    flagged: tuple[RunSummary, ...]
    provisional: int
    protested: int
    open_protests: tuple[RunSummary, ...] = ()
    apart: str = ""

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
        if self.apart:
            remarks.append(self.apart)
        remarks += self._other_names()
        if self.provisional:
            remarks.append(f"Not final: {self.provisional} of the valid runs.")
        if count := sum(bool(undecided(run.flags)) for run in self.flagged):
            remarks.append(f"UNDECIDED: {count} of the valid runs wait for the referee.")
        for run in self.open_protests:
            due = deadline_words(run.protest_due or self.made, self.made, time_words)
            remarks.append(
                f"PROTEST open against run {run.run_number} of subject {run.subject} in condition "
                f"{run.condition}: NOT FINAL until it is decided, {due}."
            )
        if self.protested:
            remarks.append(f"PROTESTED by the team: {self.protested} of the valid runs.")
        return tuple(remarks)

    def _other_names(self) -> Iterator[str]:
        """Teams whose runs carry several names."""
        teams = {team.subject: team for group in self.groups for team in group.overall}
        for team in (teams[subject] for subject in sorted(teams)):
            if team.other_names:
                names = ", ".join(f"'{name}'" for name in team.other_names)
                yield f"Runs of {team.who} under other names count as well: {names}."

    @property
    def basis(self) -> str:
        """Which runs the numbers are of."""
        kind = "official" if self.official else "practice"
        if not self.best:
            return f"Over all valid {kind} runs."
        return (
            f"Over the best {self.best} valid {kind} runs of each team in each condition: highest "
            "capability level, completed before timed out, least execution time."
        )


SIGNS = f"{DOUBTED} doubted   {ALIKE} not distinguishable from another team: unrounded +- overlap"
"""What stands behind numbers, where there is no room for more."""

BY_NUMBER = "Teams stand in the order of their numbers: the protocol makes no ranking."
"""What the order of the standings means."""

NUMBER_NOTES = (
    "Execution time: completed runs only. std: sample standard deviation (n - 1).",
    f"min and max are told of {WITH_EXTREMES}, as EUROBENCH does.",
    "All conditions together: every run weighs the same.",
    "+-: of the mean, by measurement alone, rounded up. How much runs vary: std.",
    f"{SIGNS}.",
)
"""How to read the numbers."""

NOTES = (BY_NUMBER, *NUMBER_NOTES)
"""The same, and the order."""


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

    A run without a result does not tell its competition: it is always listed, and counted as
    interrupted where its team has a standing; not among official runs where it is known to be
    practice. So is a damaged one, only listed.

    Args:
        runs: from a history.
        made: now, s since the epoch.
        competition: only runs of the competition of this name; None = all.
        official: as for `standings`.
        best: as for `standings`.
        listed: as for `standings`.

    Raises:
        MadrobError: no run is of this competition.
    """
    names, entering = entering_runs(runs, competition, official=official)
    groups = _groups(entering, official=official, best=best, listed=listed or {})
    teams = {team.subject: team.team for group in groups for team in group.overall}

    def named(run: RunSummary) -> RunSummary:
        return replace(run, team=teams.get(run.subject, run.team))

    left_out = [
        LeftOut(named(run), why_left_out(run))
        for run in entering
        if not run.valid and not run.never_ran
    ]
    return CompetitionStandings(
        made=made,
        competitions=tuple(names),
        official=official,
        best=best,
        groups=groups,
        left_out=tuple(left_out),
        flagged=tuple(named(run) for run in entering if run.valid and weighty(run.flags)),
        provisional=sum(run.valid and not run.final for run in entering),
        protested=sum(run.valid and run.closing == "protested" for run in entering),
        open_protests=tuple(
            sorted(
                (named(run) for run in entering if run.protest_due is not None),
                key=lambda run: run.protest_due or 0.0,
            )
        ),
        apart=how_testbeds_differ(entering),
    )


def entering_runs(
    runs: Sequence[RunSummary], competition: str | None, *, official: bool
) -> tuple[Sequence[str], Sequence[RunSummary]]:
    """The names of the competitions, and their runs whether they count or not.

    Args:
        runs: as for `competition_standings`.
        competition: likewise.
        official: likewise.

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
        if (not _told(run) and not (official and run.practice))
        or (_told(run) and _of_kind(run, official=official) and run.competition in names)
    ]
    return names, entering


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


def statistics_text(
    aggregate: Aggregate | None, name: IndicatorName, width: int = 12
) -> dict[str, str]:
    """`statistics_of` as text; what there is not is missing.

    All have the digits of their indicator, so that those of all teams are aligned, but none that
    the mean's uncertainty does not leave; the standard deviation, often less than 1, one more.

    Args:
        aggregate: of some runs; None = none has a value.
        name: of the indicator.
        width: of each text, characters.
    """
    decimals, known = name.spec.decimals, aggregate.uncertainty if aggregate else None
    left = decimals_left(known) if known is not None and known.expanded else decimals
    return {
        word: _statistic_text(value, min(decimals, left + (word == "std")), width)
        for word, value in statistics_of(aggregate, name).items()
        if value is not None
    }


def _statistic_text(value: float, decimals: int, width: int) -> str:
    """Smallest and largest counts are as they are; what is too wide is in powers of ten."""
    text = str(value) if isinstance(value, int) else f"{value:.{decimals}f}"
    if len(text) <= width:
        return text
    powers = f"{value:.1e}"
    return powers if len(powers) <= width else f"{value:.0e}"


def _groups(
    runs: Sequence[RunSummary], *, official: bool, best: int, listed: Mapping[int, str]
) -> tuple[RulesetStandings, ...]:
    together = overall(runs, official=official, best=best, listed=listed)
    single = standings(runs, official=official, best=best, listed=listed)
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


def why_left_out(run: RunSummary) -> str:
    """Why a run does not count, in words."""
    if run.problem is not None:
        return run.problem
    if run.twin:
        return run.why_twin
    if run.outcome is None:
        return "no result yet: it goes on, or waits for a decision in `madrob console`"
    if run.reason:
        return run.reason
    aborted = run.outcome is Outcome.ABORTED
    return "the referee gave no reason" if aborted else "the machine failed"
