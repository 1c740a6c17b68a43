"""The pages of a site: overview, plan, conditions, teams."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

from markupsafe import Markup

from madrob_console.archive.folders import INDEX_PAGE
from madrob_console.common.formatting import format_span
from madrob_console.common.names import terminal_safe
from madrob_console.pages.competition import RulesetStandings
from madrob_console.pages.notes import NO_UNCERTAINTY_NOTE, UNCERTAINTY_NOTE
from madrob_console.pages.plan_text import PLAN_NOTES, summary_words
from madrob_console.pages.site_content import (
    ORDER,
    PLAN,
    TEAMS_ORDER,
    BestRuns,
    SiteContent,
    beside,
    condition_place,
    team_csv,
    team_place,
    zip_place,
)
from madrob_console.pages.site_drawings import PLOTS_NOTE, unit_and_direction, value_plots
from madrob_console.pages.tally import counts
from madrob_console.pages.templates import path_link, render
from madrob_console.referee.competition_plan import PlanProgress
from madrob_console.referee.flags import FlagKind, serious
from madrob_console.referee.run_summary import PROTEST_OPEN, RunSummary, condition_words
from scoring.indicator_table import IndicatorName, unit_text
from scoring.protocol import Condition, Outcome
from scoring.result import DOUBTED

DOWNLOADS = {
    "data/standings.csv": "the standings",
    "data/standings.json": "the standings with units and reasons",
    "data/runs.csv": "a row for each run",
    "data/indicators.csv": "a row for each run and indicator",
    "data/events.csv": "a row for each event",
    "data/steps.csv": "a row for each run and step",
}

_LATEST, _NEXT = 8, 3

_MOST_CELLS = 240
"""Teams times conditions in one table: a larger one is too wide for any screen."""

_LEVEL_FIRST = sorted(IndicatorName, key=lambda name: name is not IndicatorName.CAPABILITY_LEVEL)

_CLOSING_WORDS = {
    "protested": "PROTESTED by the team",
    PROTEST_OPEN: "NOT FINAL: a PROTEST is open",
}
"""Longer words than a list has room for."""

_FAILED_NOTE = (
    "A run that failed is grey and says so. What stands in capitals does not count, with the "
    "reason below its table."
)


@dataclass(frozen=True, slots=True)
class Links:
    """Links from the page at `place` of the site; words alone where nothing is to be linked."""

    content: SiteContent
    place: str

    def ways(self, *more: Markup) -> Markup:
        """The pages that all pages lead to."""
        content = self.content
        fixed = [
            path_link(beside(self.place, name), words)
            for name, words in ((INDEX_PAGE, "overview"), (PLAN, "plan"))
            if name != self.place and (name != PLAN or content.plan is not None)
        ]
        entries = Markup("").join(Markup("{} ").format(entry) for entry in (*fixed, *more))
        return Markup('<nav aria-label="This competition">{}</nav>').format(entries)

    def team(self, subject: int) -> Markup:
        name = terminal_safe(self.content.team_name(subject))
        words = Markup("{} <bdi>{}</bdi>").format(subject, name)
        has_page = subject in self.content.of_team
        return path_link(beside(self.place, team_place(subject)), words) if has_page else words

    def condition(self, number: int) -> Markup:
        words = Markup("condition {}").format(number)
        has_page = number in self.content.conditions
        return path_link(beside(self.place, condition_place(number)), words) if has_page else words

    def run(self, run: RunSummary, words: str) -> Markup:
        whole = Markup('<span class="whole">{}</span>').format(words)
        target = self.content.places.get(run.folder)
        return path_link(beside(self.place, target), whole) if target else whole


def _task_of(number: int) -> str:
    """Task of a condition: `Sudden Force, pull, from CW to CCW`."""
    return ", ".join(filter(None, reversed(condition_words(number))))


def _outcome_notes(run: RunSummary) -> str:
    said_elsewhere = (FlagKind.VOID, FlagKind.PRACTICE, FlagKind.PROTEST)
    words = [flag.words for flag in serious(run.flags) if flag.kind not in said_elsewhere]
    if run.closing != "final" and (run.valid or run.protest_filed is not None):
        words.insert(0, _CLOSING_WORDS.get(run.closing, run.closing))
    return "; ".join(words)


def _why(run: RunSummary) -> str:
    return run.why_left_out if run.problem is None else "its result cannot be used"


_TOLD: Mapping[str, Any] = {
    "completed": Outcome.COMPLETED,
    "counts": counts,
    "execution_time": IndicatorName.EXECUTION_TIME,
    "level_first": _LEVEL_FIRST,
    "outcome_notes": _outcome_notes,
    "task_of": _task_of,
    "unit_and_direction": unit_and_direction,
    "value_heads": [
        f"{name.words.partition(' of ')[0]}, {unit_text(name.spec.unit)}" for name in _LEVEL_FIRST
    ],
    "why": _why,
}

_NOTES = {
    "DOUBTED": f"{DOUBTED}: a value that is doubted.",
    "ORDER": ORDER,
    "TEAMS_ORDER": TEAMS_ORDER,
    "PLAN_NOTES": PLAN_NOTES,
    "PLOTS_NOTE": PLOTS_NOTE,
}


def _page(
    template: str,
    content: SiteContent,
    place: str,
    tab: str = "",
    **values: Any,  # noqa: ANN401
) -> str:
    """`tab` stands before the competition in the browser's tab; empty = the competition alone."""
    links = Links(content, place)
    means = {"who": lambda tally: links.team(tally.subject), "notes": _NOTES}
    return render(template, **{**_TOLD, **means, **values}, content=content, links=links, tab=tab)


def _progress(plan: PlanProgress | None) -> dict[str, Any]:
    if plan is None:
        return {}
    late = plan.last_delay // 60
    return {
        "plan_summary": summary_words(plan),
        "upcoming": list(islice(plan.upcoming(), _NEXT)),
        "late": format_span(60 * late) if late else "",
    }


def overview_page(content: SiteContent, written: str) -> str:
    groups = content.standings.groups
    return _page(
        "overview.html",
        content,
        INDEX_PAGE,
        written=written,
        groups=[(group, BestRuns.of(group)) for group in groups],
        latest=list(islice(reversed(content.runs), _LATEST)),
        downloads=DOWNLOADS,
        most_cells=_MOST_CELLS,
        **_progress(content.plan),
    )


def plan_page(content: SiteContent, plan: PlanProgress) -> str:
    extra = [task for task in plan.tasks if not task.planned]
    values = {"lines": plan.lines, "extra": extra, **_progress(plan)}
    return _page("plan.html", content, PLAN, "Plan", **values)


def condition_page(content: SiteContent, number: int) -> str:
    """All teams in a condition beside each other."""
    place, condition = condition_place(number), Condition.from_number(number)
    name = f"Condition {number}, {condition.benchmark_type}"
    groups = [group for group in content.standings.groups if condition in group.conditions]
    links = Links(content, place)
    shown_groups = [_group(content, links, group, condition) for group in groups]
    return _page(
        "condition.html", content, place, name, condition=condition, name=name, groups=shown_groups
    )


def _group(
    content: SiteContent, links: Links, group: RulesetStandings, condition: Condition
) -> dict[str, object]:
    ordered = group.conditions[condition]
    runs_of_team = {
        content.who(standing.subject): content.runs_of(
            standing.subject, condition.number, group.ruleset
        )
        for standing in ordered
    }
    return {
        "group": group,
        "best": [
            (run, [links.team(run.subject), links.run(run, f"run {run.run_number}")])
            for standing in ordered
            if (run := standing.best) is not None
        ],
        "plots": value_plots(runs_of_team),
    }


def team_page(content: SiteContent, subject: int) -> str:
    """A team's runs by condition, and their indicators."""
    place, runs = team_place(subject), content.of_team[subject]
    of: dict[int, list[RunSummary]] = defaultdict(list)
    for run in runs:
        of[run.condition].append(run)
    return _page(
        "team.html",
        content,
        place,
        f"Team {content.who(subject)}",
        subject=subject,
        standings=[
            (group, team)
            for group in content.standings.groups
            for team in group.overall
            if team.subject == subject
        ],
        testbeds=_testbeds(content, subject),
        zip=beside(place, zip_place(subject)),
        csv=beside(place, team_csv(subject)),
        slots=[
            slot
            for slot in (content.plan.upcoming() if content.plan else ())
            if slot.task.subject == subject
        ],
        by_condition=sorted(of.items()),
        plots=list(value_plots({f"condition {n}": some for n, some in sorted(of.items())})),
        notes={**_NOTES, "TEAM_NOTES": list(_notes(runs))},
    )


def _testbeds(content: SiteContent, subject: int) -> list[str]:
    return sorted({run.testbed for run in content.of_team[subject] if run.testbed})


def _notes(runs: Sequence[RunSummary]) -> Iterator[str]:
    yield _FAILED_NOTE
    yield UNCERTAINTY_NOTE
    if any(run.values and not run.uncertainties for run in runs):
        yield NO_UNCERTAINTY_NOTE
