"""The pages of the whole competition: the overview and the plan."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

from madrob_console.archive.folders import INDEX_PAGE
from madrob_console.archive.history import RunSummary
from madrob_console.publishing.best_runs import BestRuns
from madrob_console.publishing.site_content import (
    HALL,
    PLAN,
    TEAMS_ORDER,
    Alike,
    SiteContent,
    beside,
)
from madrob_console.publishing.site_frame import (
    condition_link,
    outcome_cell,
    run_link,
    site_page,
    task_words_of,
    team_link,
    value_cell,
)
from madrob_console.referee.competition_plan import Attempts, PlanProgress
from madrob_console.report.explanations import NONE
from madrob_console.report.markup import (
    NOTHING,
    Content,
    Markup,
    element,
    link,
    listed,
    said,
    section,
    table,
)
from madrob_console.standings.competition import SIGNS, RulesetStandings
from madrob_console.standings.plan_table import NOTES, summary_words
from madrob_console.standings.tally import Overall
from madrob_console.standings.web_page import counts
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome

DOWNLOADS = {
    "data/standings.csv": "the standings",
    "data/standings.json": "the standings with units and reasons",
    "data/runs.csv": "a row for each run",
    "data/indicators.csv": "a row for each run and indicator",
    "data/events.csv": "a row for each event",
    "data/steps.csv": "a row for each run and step",
}
"""The tables for programs, and what they have."""

_LATEST, _NEXT = 8, 3


def overview_page(content: SiteContent, written: str) -> str:
    """The first page.

    Args:
        content: of the site.
        written: when, in words.
    """
    found = content.standings
    return site_page(
        content,
        INDEX_PAGE,
        "Results" if found.official else "PRACTICE results",
        _progress(content, INDEX_PAGE),
        _standings(content, INDEX_PAGE),
        section("Latest results", _latest(content, INDEX_PAGE)),
        section("Conditions", _conditions(content)),
        _more(content),
        lines=(
            f"As of {written}, {_count(content.runs)}",
            *(element("strong", said(remark)) for remark in found.remarks),
        ),
    )


def plan_page(content: SiteContent, plan: PlanProgress) -> str:
    """All of the plan, in its order.

    Args:
        content: of the site.
        plan: and how much of it is done.
    """
    extra = [one for one in plan.tasks if not one.planned]
    out = section("Out of plan", _plan_table(content, extra, "Runs that nobody planned"))
    return site_page(
        content,
        PLAN,
        "Plan",
        _progress(content, PLAN),
        section("All attempts", _plan_table(content, plan.lines, "In the order of the plan")),
        out if extra else NOTHING,
        title="Plan",
        lines=NOTES,
    )


def _count(runs: Sequence[RunSummary]) -> str:
    valid = sum(run.valid for run in runs)
    return f"{valid} valid of {len(runs)} runs."


def _progress(content: SiteContent, place: str) -> Content:
    plan = content.plan
    if plan is None or not plan.planned:
        return NOTHING
    done = plan.planned - plan.left
    bar = element(
        "progress", value=str(done), max=str(plan.planned), aria_label="Attempts of the plan done"
    )
    upcoming = [
        (
            team_link(content, place, one.task.subject),
            ", ",
            condition_link(content, place, one.task.condition),
            f" ({task_words_of(one.task.condition)}), attempt {one.number} of {one.planned}",
        )
        for one in islice(plan.upcoming(), _NEXT)
    ]
    following = (element("p", "Next:"), listed(upcoming, "")) if upcoming else NOTHING
    return section("Plan", element("p", summary_words(plan)), bar, following)


def _plan_table(content: SiteContent, lines: Sequence[Attempts], caption: str) -> Markup:
    def row(of: Attempts) -> Iterator[Content]:
        yield team_link(content, PLAN, of.task.subject)
        yield condition_link(content, PLAN, of.task.condition)
        yield task_words_of(of.task.condition)
        yield f"{of.done} of {of.planned}" if of.planned else str(of.done)
        yield str(of.valid)
        yield NONE if of.best_level is None else str(of.best_level)

    heads = ("team", "condition", "task", "done", "valid", "best level")
    return table(heads, map(row, lines), class_="runs", caption=caption)


def _standings(content: SiteContent, place: str) -> Content:
    groups = content.standings.groups
    if not groups:
        return section("Standings", element("p", "No run counts yet."))
    several = len(groups) > 1
    return [
        section(
            f"Standings, ruleset {group.ruleset}" if several else "Standings",
            element("p", f"{TEAMS_ORDER} {SIGNS}."),
            _group_table(content, place, group),
        )
        for group in groups
    ]


def _group_table(content: SiteContent, place: str, group: RulesetStandings) -> Markup:
    """A row a team: how far it came in each condition."""
    found = BestRuns.of(content, group)

    def row(team: Overall) -> Iterator[Content]:
        yield team_link(content, place, team.subject)
        for number in found.conditions:
            run = found.of_team[team.subject].get(number)
            yield NONE if run is None else _best_cell(content, place, run, found.alike)
        yield ", ".join(counts(team))

    heads = (condition_link(content, place, number) for number in found.conditions)
    return table(
        ("team", *heads, "runs"),
        map(row, found.teams),
        class_="runs",
        caption="level, and time if completed",
    )


def _best_cell(content: SiteContent, place: str, run: RunSummary, alike: Alike) -> Content:
    level = value_cell(run, IndicatorName.CAPABILITY_LEVEL)
    time = IndicatorName.EXECUTION_TIME
    words = ("level ", level)
    if run.outcome is Outcome.COMPLETED:
        return run_link(content, place, run, words), " ", value_cell(run, time, alike), " s"
    return run_link(content, place, run, words), f" {run.outcome_word}"


def _latest(content: SiteContent, place: str) -> Content:
    """The newest first; what has no result yet goes on, or waits for a decision."""
    entries = []
    for run in islice(reversed(content.runs), _LATEST):
        words = f"run {run.run_number}, {run.started_text}"
        entries.append(
            (
                team_link(content, place, run.subject),
                ", ",
                condition_link(content, place, run.condition),
                ", ",
                run_link(content, place, run, words),
                ": ",
                *_latest_words(run),
            )
        )
    return listed(entries, "None yet.")


def _latest_words(run: RunSummary) -> Iterator[Content]:
    if run.valid:
        yield "level ", value_cell(run, IndicatorName.CAPABILITY_LEVEL), ", "
        if run.outcome is Outcome.COMPLETED:
            yield value_cell(run, IndicatorName.EXECUTION_TIME), " s, "
    yield outcome_cell(run)


def _conditions(content: SiteContent) -> Content:
    entries = [
        (condition_link(content, INDEX_PAGE, number), f": {task_words_of(number)}")
        for number in content.conditions
    ]
    return listed(entries, "None yet.")


def _more(content: SiteContent) -> Markup:
    tables = [
        element("li", link(beside(INDEX_PAGE, name), name), f": {words}")
        for name, words in DOWNLOADS.items()
    ]
    hall = ("The hall's screen, which follows by itself: ", link(HALL, HALL), ".")
    return section("Downloads", element("ul", tables, class_="columns"), element("p", hall))
