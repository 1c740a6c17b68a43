"""The screen in the hall: read from some metres away, by nobody who can scroll."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from madrob_console.archive.history import RunSummary
from madrob_console.publishing.best_runs import BestRuns
from madrob_console.publishing.site_content import HALL, SiteContent
from madrob_console.publishing.site_frame import (
    condition_link,
    site_page,
    team_link,
)
from madrob_console.report.explanations import NONE
from madrob_console.report.markup import (
    NOTHING,
    Content,
    Markup,
    element,
    listed,
    said,
    section,
    table,
)
from madrob_console.standings.competition import SIGNS
from madrob_console.standings.plan_table import summary_words
from madrob_console.standings.tally import ALIKE, Overall
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import value_text

REFRESH = 15
"""The screen is loaded again after so long at least, s."""

_LEAF_TIME = 10
"""Where not all teams fit, the next ones come after so long, s; all have been there at a reload."""

_TEAMS, _CONDITIONS = 12, 4  # of a leaf: so many can be read from 6 m
_LATEST, _LATEST_ALONE, _NEXT = 4, 7, 2


@dataclass(frozen=True, slots=True)
class _Leaf:
    """What of the standings is seen at once."""

    ruleset: str
    found: BestRuns
    teams: Sequence[Overall]
    conditions: Sequence[int]

    @property
    def words(self) -> Iterator[str]:
        """Which part of the standings it is; nothing of what is all of it."""
        everyone, every = [team.subject for team in self.found.teams], self.found.conditions
        if len(self.teams) < len(everyone):
            yield f"teams {_part([team.subject for team in self.teams], everyone)}"
        if len(self.conditions) < len(every):
            yield f"conditions {_part(self.conditions, every)}"
        if self.ruleset:
            yield f"ruleset {self.ruleset}"


def _part(some: Sequence[int], every: Sequence[int]) -> str:
    """Which of them it is, counted from 1: `13-24 of 40`."""
    first, last = every.index(some[0]) + 1, every.index(some[-1]) + 1
    return f"{first if first == last else f'{first}-{last}'} of {len(every)}"


def hall_page(content: SiteContent, written: str) -> str:
    """What a screen in the hall shows: it is loaded again by itself, and its leaves turn.

    Args:
        content: of the site.
        written: when, in words.
    """
    leaves = list(_leaves(content))
    lasting = max(REFRESH, _LEAF_TIME * len(leaves) if len(leaves) > 1 else 0)
    shown = [_leaf(content, leaf, number, len(leaves)) for number, leaf in enumerate(leaves)]
    parts = (
        element("div", shown or element("p", "No run counts yet."), class_="leaves"),
        element("div", _plan(content), section("Latest results", _latest(content))),
    )
    return site_page(
        content,
        HALL,
        said(content.standings.title or "Results"),
        element("div", parts, class_="hall"),
        title="Hall",
        head=(
            element("meta", http_equiv="refresh", content=str(lasting)),
            element("style", _turning(len(leaves))) if len(leaves) > 1 else NOTHING,
        ),
        lines=(f"As of {written}. This page is loaded again every {lasting} s.",),
    )


def _leaves(content: SiteContent) -> Iterator[_Leaf]:
    groups = content.standings.groups
    for group in groups:
        found = BestRuns.of(content, group)
        for first in range(0, len(found.teams), _TEAMS):
            for column in range(0, max(1, len(found.conditions)), _CONDITIONS):
                yield _Leaf(
                    group.ruleset if len(groups) > 1 else "",
                    found,
                    found.teams[first : first + _TEAMS],
                    found.conditions[column : column + _CONDITIONS],
                )


def _turning(leaves: int) -> Markup:
    """The style by which one leaf after the other is seen on a screen, without a script."""
    return Markup(
        f"@keyframes leaf {{ 0% {{ visibility: visible }} {100 / leaves:.4f}% "
        "{ visibility: hidden } }\n"
        "@media screen and (min-width: 60rem) { .leaf { visibility: hidden; "
        f"animation: leaf {leaves * _LEAF_TIME}s step-end infinite }} }}\n"
    )


def _leaf(content: SiteContent, leaf: _Leaf, number: int, leaves: int) -> Markup:
    found = leaf.found

    def row(team: Overall) -> Iterator[Content]:
        badge = (element("strong", "NOT FINAL"), " ") if team.open_protests else NOTHING
        yield badge, team_link(content, HALL, team.subject)
        for condition in leaf.conditions:
            run = found.of_team[team.subject].get(condition)
            alike = run and IndicatorName.EXECUTION_TIME in found.alike.get(run.folder, ())
            yield NONE if run is None else _words(run, ALIKE if alike else "")

    part = ", ".join(leaf.words)
    heads = (condition_link(content, HALL, condition) for condition in leaf.conditions)
    caption = (
        element("b", f"Standings: {part}. " if part else "Standings. "),
        "Level, and time in s if completed. ",
        SIGNS.partition(":")[0],
    )
    return element(
        "div",
        table(("team", *heads), map(row, leaf.teams), class_="runs", caption=caption),
        class_="leaf",
        style=f"animation-delay: {number * _LEAF_TIME}s" if leaves > 1 else "",
    )


def _words(run: RunSummary, alike: str = "") -> Iterator[Content]:
    """Level, and time if completed, of a valid run; else in a word why it is none."""
    if run.valid:
        yield element("b", _number(run, IndicatorName.CAPABILITY_LEVEL)), " "
    if run.valid and run.outcome is Outcome.COMPLETED:
        yield _number(run, IndicatorName.EXECUTION_TIME) + alike
    else:
        yield element("small", run.outcome_word)


def _number(run: RunSummary, name: IndicatorName) -> str:
    """A value in the digits that its uncertainty leaves; that itself stands on the other pages."""
    value, known = run.values.get(name), run.uncertainties.get(name)
    if value is None:
        return NONE
    text = f"{value:.2f}" if known is None and not name.spec.counts else value_text(value, known)
    return text + run.sign(name)


def _plan(content: SiteContent) -> Content:
    plan = content.plan
    if plan is None or not plan.planned:
        return NOTHING
    done = plan.planned - plan.left
    bar = element(
        "progress", value=str(done), max=str(plan.planned), aria_label="Attempts of the plan done"
    )
    upcoming = [
        (
            element("span", team_link(content, HALL, one.task.subject)),
            condition_link(content, HALL, one.task.condition),
        )
        for one in islice(plan.upcoming(), _NEXT)
    ]
    following = (element("p", "Next:"), listed(upcoming, "")) if upcoming else NOTHING
    return section("Plan", element("p", summary_words(plan)), bar, following)


def _latest(content: SiteContent) -> Content:
    planned = content.plan is not None and content.plan.planned
    entries = [
        (
            element("span", team_link(content, HALL, run.subject)),
            condition_link(content, HALL, run.condition),
            ": ",
            *_words(run),
            element("strong", " NOT FINAL") if run.protest_due is not None else NOTHING,
        )
        for run in islice(reversed(content.runs), _LATEST if planned else _LATEST_ALONE)
    ]
    return listed(entries, "None yet.")
