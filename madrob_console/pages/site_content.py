"""What a site shows: runs, standings, places, best runs."""

from __future__ import annotations

import os
import posixpath
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import chain
from pathlib import Path

from madrob_console.archive.folders import REPORT_FILE
from madrob_console.common.plain_files import stamp_of
from madrob_console.pages.competition import CompetitionStandings, RulesetStandings
from madrob_console.pages.tally import Overall, leaders
from madrob_console.referee.competition_plan import PlanProgress
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome

PLAN = "plan.html"

ORDER = (
    "Ordered by capability level first, then completed before failed, then by the execution time "
    "of completed runs; a value of a failed run never brings it up."
)

TEAMS_ORDER = (
    "In each condition a team's best run: the highest capability level, completed before failed, "
    "then the least execution time. Teams are ordered by the sum of these levels, then by in how "
    "many conditions they completed a run; equal ones stand by their numbers. The protocol makes "
    "no ranking."
)


@dataclass(frozen=True)
class SiteContent:
    """A competition as its pages show it.

    Attributes:
        root: parent of the folders of the runs.
        runs: all of the competition, even if they do not count, oldest first, without duplicates.
        zips: the teams whose zip somebody has put on the site.
    """

    root: Path
    runs: Sequence[RunSummary]
    standings: CompetitionStandings
    plan: PlanProgress | None
    names: Mapping[int, str]
    software: str
    zips: frozenset[int] = frozenset()

    @property
    def title(self) -> str:
        kind = "" if self.standings.official else "PRACTICE "
        return f"{self.standings.title or 'MADROB'}: {kind}results"

    @cached_property
    def of_team(self) -> Mapping[int, Sequence[RunSummary]]:
        by_team: dict[int, list[RunSummary]] = defaultdict(list)
        for run in self.runs:
            by_team[run.subject].append(run)
        return {subject: by_team[subject] for subject in sorted(by_team)}

    @cached_property
    def conditions(self) -> Sequence[int]:
        """The numbers of conditions that were run and count."""
        groups = self.standings.groups
        return sorted({condition.number for group in groups for condition in group.conditions})

    @cached_property
    def with_result(self) -> Sequence[RunSummary]:
        """The runs that have a folder on the site."""
        return [run for run in self.runs if run.outcome is not None and run.problem is None]

    def folder_of(self, run: RunSummary) -> str:
        """A run folder's name, which two testbeds may share, and the end of the run's identity."""
        name = os.path.basename(run.folder)  # noqa: PTH119  of text
        own = re.fullmatch("[0-9a-f]{8}", run.run_id[-8:])
        folder = run.folder.encode(errors="surrogateescape")
        return f"runs/{name}_{own[0] if own else sha256(folder).hexdigest()[:8]}"

    @cached_property
    def places(self) -> Mapping[str, str]:
        """The page of each run that has one, its report, by the run's folder."""
        return {
            run.folder: f"{self.folder_of(run)}/{REPORT_FILE}"
            for run in self.with_result
            if stamp_of(f"{self.source(run)}/{REPORT_FILE}") is not None
        }

    def runs_of(self, subject: int, condition: int, ruleset: str) -> list[RunSummary]:
        return [
            run
            for run in self.of_team[subject]
            if run.condition == condition and run.ruleset == ruleset
        ]

    @cached_property
    def team_names(self) -> Mapping[int, str]:
        """As in the standings, else in the list of teams."""
        standing = {
            tally.subject: tally.team for of in self.standings.groups for tally in of.overall
        }
        return {**self.names, **{subject: team for subject, team in standing.items() if team}}

    def team_name(self, subject: int) -> str:
        """Empty where it has none."""
        return self.team_names.get(subject, "")

    def who(self, subject: int) -> str:
        return f"{subject} {self.team_name(subject)}".rstrip()

    def source(self, run: RunSummary) -> str:
        return os.path.join(self.root, run.folder)  # noqa: PTH118  of a hundred thousand


def team_place(subject: int) -> str:
    return f"teams/{subject:03d}.html"


def team_csv(subject: int) -> str:
    """Path of the table of a team's indicators."""
    return f"teams/{subject:03d}.csv"


def zip_place(subject: int) -> str:
    """Path of a team's zip, which `madrob export --output` may put there."""
    return f"downloads/team_{subject:03d}.zip"


def condition_place(number: int) -> str:
    return f"conditions/{number:02d}.html"


def beside(page: str, name: str) -> str:
    """Path of a file of the site relative to one of its pages."""
    return posixpath.relpath(name, posixpath.dirname(page) or ".")


@dataclass(frozen=True)
class BestRuns:
    """The best run of each team by one ruleset.

    Attributes:
        teams: in the order of `TEAMS_ORDER`.
        reached: by subject, what that order goes by: the sum of the levels of its best runs, and
            in how many conditions it completed one.
        of_team: subject -> condition -> its best run, where it has a valid one.
        leading: condition -> the best of these runs, each one of several that are equal.
    """

    teams: Sequence[Overall]
    reached: Mapping[int, tuple[int, int]]
    of_team: Mapping[int, Mapping[int, RunSummary]]
    leading: Mapping[int, Sequence[RunSummary]]

    @classmethod
    def of(cls, group: RulesetStandings) -> BestRuns:
        best: dict[int, dict[int, RunSummary]] = {team.subject: {} for team in group.overall}
        for standing in chain.from_iterable(group.conditions.values()):
            if standing.best is not None:
                best[standing.subject][standing.condition] = standing.best
        level = IndicatorName.CAPABILITY_LEVEL
        reached = {
            subject: (
                sum(int(run.values.get(level, 0)) for run in runs.values()),
                sum(run.outcome is Outcome.COMPLETED for run in runs.values()),
            )
            for subject, runs in best.items()
        }
        ordered = sorted(group.overall, key=lambda tally: tally.subject)
        ordered.sort(key=lambda tally: reached[tally.subject], reverse=True)
        leading = {
            condition.number: [standing.best for standing in leaders(standings) if standing.best]
            for condition, standings in group.conditions.items()
        }
        return cls(ordered, reached, best, leading)
