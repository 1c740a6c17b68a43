"""The teams of a competition in the order of their best runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from madrob_console.archive.history import RunSummary, rank
from madrob_console.publishing.site_content import (
    Alike,
    SiteContent,
    alike_among,
    best_of,
)
from madrob_console.standings.competition import RulesetStandings
from madrob_console.standings.tally import Overall
from scoring.protocol import Outcome


@dataclass(frozen=True)
class BestRuns:
    """What stands for each team by one ruleset.

    Attributes:
        teams: as `TEAMS_ORDER` says.
        conditions: the numbers of those that were run.
        of_team: subject -> condition -> its best run, where it has a valid one.
        alike: in what these are not distinguishable within their condition.
    """

    teams: Sequence[Overall]
    conditions: Sequence[int]
    of_team: Mapping[int, Mapping[int, RunSummary]]
    alike: Alike

    @classmethod
    def of(cls, content: SiteContent, group: RulesetStandings) -> BestRuns:
        """Those of the teams of a ruleset.

        Args:
            content: of the site.
            group: the standings by that ruleset.
        """
        numbers = [condition.number for condition in group.conditions]
        best = {
            team.subject: {
                number: found
                for number in numbers
                if (found := best_of(content.runs_of(team.subject, number, group.ruleset)))
            }
            for team in group.overall
        }
        alike = {
            folder: names
            for number in numbers
            for folder, names in alike_among(
                [of_team[number] for of_team in best.values() if number in of_team]
            ).items()
        }
        ordered = sorted(group.overall, key=lambda team: _order(best[team.subject], team.subject))
        return cls(ordered, numbers, best, alike)


def _order(best: Mapping[int, RunSummary], subject: int) -> tuple[float, ...]:
    """Highest level, then in how many conditions the team reached it, and completed; its number."""
    levels = [-rank(run)[0] for run in best.values()]
    highest = max(levels, default=-1.0)
    completed = sum(run.outcome is Outcome.COMPLETED for run in best.values())
    return -highest, -levels.count(highest), -completed, subject
