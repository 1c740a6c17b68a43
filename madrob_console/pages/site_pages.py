"""The pages of a site: overview, conditions, teams, runs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from madrob_console.archive.folders import INDEX_PAGE, RESULT_FILE
from madrob_console.archive.history import RunSummary, rank
from madrob_console.archive.result_reader import earlier_issues
from madrob_console.archive.result_summary import ListedResult, PagedResult
from madrob_console.pages.competition import (
    PLAN_NOTES,
    SIGNS,
    RulesetStandings,
    summary_words,
    why_left_out,
)
from madrob_console.pages.markup import (
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
from madrob_console.pages.outputs import how_to_read, teams_table
from madrob_console.pages.shared_sections import (
    INVALID,
    MANUAL_START_NOTE,
    NO_UNCERTAINTY_NOTE,
    NONE,
    UNCERTAINTY_NOTE,
    VOIDED,
    date_text,
    indicator_section,
    issues,
    star,
    steps,
    task_text,
)
from madrob_console.pages.site_content import (
    ORDER,
    PLAN,
    TEAMS_ORDER,
    Alike,
    BestRuns,
    SiteContent,
    alike_among,
    beside,
    best_of,
    condition_place,
    team_place,
    zip_place,
)
from madrob_console.pages.site_frame import (
    BOXES_NOTE,
    CURVES_NOTE,
    boxes,
    condition_link,
    curves,
    outcome_cell,
    run_link,
    runs_table,
    site_page,
    task_words_of,
    team_link,
    value_cell,
)
from madrob_console.pages.tally import Overall, counts
from madrob_console.referee.competition_plan import Attempts, PlanProgress
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, Outcome

DOWNLOADS = {
    "data/standings.csv": "the standings",
    "data/standings.json": "the standings with units and reasons",
    "data/runs.csv": "a row for each run",
    "data/indicators.csv": "a row for each run and indicator",
    "data/events.csv": "a row for each event",
    "data/steps.csv": "a row for each run and step",
}

_LATEST, _NEXT = 8, 3


def overview_page(content: SiteContent, written: str) -> str:
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
        lines=PLAN_NOTES,
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
        yield f"{of.done - of.beyond} of {of.planned}" if of.planned else str(of.done)
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
    """The newest first; a run without a result is current, or waits for a decision."""
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
    return section("Downloads", element("ul", tables, class_="columns"))


# The page of a condition: all teams beside each other.


def condition_page(content: SiteContent, number: int) -> str:
    place, condition = condition_place(number), Condition.from_number(number)
    groups = [group for group in content.standings.groups if condition in group.conditions]
    several = len(groups) > 1
    return site_page(
        content,
        place,
        f"Condition {number}, {condition.benchmark_type}",
        [_group(content, place, group, condition, several=several) for group in groups],
        section("How to read the means", how_to_read()),
        title=f"Condition {number}, {condition.benchmark_type}",
        lines=(task_text(condition), content.standings.basis),
    )


_FAILED_ENTER = (
    "Timed-out runs enter these means, too, but not that of the execution time: a team's runs say "
    "how many there are."
)


def _group(
    content: SiteContent,
    place: str,
    group: RulesetStandings,
    condition: Condition,
    *,
    several: bool,
) -> Iterator[Markup]:
    rules = f", ruleset {group.ruleset}" if several else ""
    runs = {
        one.subject: content.runs_of(one.subject, condition.number, group.ruleset)
        for one in group.conditions[condition]
    }
    best = {subject: best_of(found) for subject, found in runs.items()}
    ordered = sorted(group.conditions[condition], key=lambda one: _order(best[one.subject]))

    def rows() -> Iterator[tuple[RunSummary, Sequence[Content]]]:
        for one in ordered:
            run = best[one.subject]
            if run is not None:
                team = team_link(content, place, one.subject)
                yield run, (team, run_link(content, place, run, f"run {run.run_number}"))

    yield section(
        f"The best run of each team{rules}",
        element("p", f"{ORDER} {SIGNS}."),
        runs_table(
            "team",
            rows(),
            ("run",),
            "The best valid run of each team",
            alike_among([run for run in best.values() if run is not None]),
        ),
    )
    yield section(
        f"All valid runs{rules}",
        element("p", BOXES_NOTE),
        boxes({one.subject: runs[one.subject] for one in ordered}, content.who),
    )
    yield section(
        f"Means{rules}",
        element("p", _FAILED_ENTER),
        teams_table(
            ordered,
            f"Condition {condition.number}, {condition.benchmark_type}{rules}",
            lambda tally: element("b", team_link(content, place, tally.subject)),
        ),
    )


def _order(best: RunSummary | None) -> tuple[float, ...]:
    """Teams without a valid run are last."""
    return (1.0,) if best is None else rank(best)


# The page of a team: its runs by condition, and its indicators over the day.


def team_page(content: SiteContent, subject: int) -> str:
    place, runs = team_place(subject), content.of_team[subject]
    name = content.team_name(subject)
    parts = [section("All runs, oldest first", _by_condition(content, place, runs))]
    if any(run.valid for run in runs):
        drawn = (element("p", CURVES_NOTE), curves(runs))
        parts.append(section("Over the day", drawn))
    return site_page(
        content,
        place,
        (f"Team {subject} ", said(name)),
        *parts,
        section("How to read it", *(element("small", one) for one in _notes(runs))),
        title=f"Team {content.who(subject)}",
        lines=_team_lines(content, place, subject, runs),
    )


_FAILED_NOTE = (
    "A run that failed is grey and says so. What stands in capitals does not count, with the "
    "reason below its table."
)


def _notes(runs: Sequence[RunSummary]) -> Iterator[str]:
    yield _FAILED_NOTE
    yield UNCERTAINTY_NOTE
    if any(run.values and not run.uncertainties for run in runs):
        yield NO_UNCERTAINTY_NOTE
    yield MANUAL_START_NOTE


def _team_lines(
    content: SiteContent, place: str, subject: int, runs: Sequence[RunSummary]
) -> Iterator[Content]:
    for group in content.standings.groups:
        for team in group.overall:
            if team.subject == subject:
                yield f"{', '.join(counts(team))}; ruleset {group.ruleset}."
                if team.other_names:
                    yield "Also called ", said(", ".join(team.other_names)), "."
    testbeds = sorted({run.testbed for run in runs if run.testbed})
    if len(testbeds) > 1:
        yield "On the testbeds ", said(", ".join(testbeds)), "."
    if subject in content.zips:
        yield link(beside(place, zip_place(subject)), "All of it in one zip"), "."


def _by_condition(
    content: SiteContent, place: str, runs: Sequence[RunSummary]
) -> Iterator[Content]:
    of: dict[int, list[RunSummary]] = defaultdict(list)
    for run in runs:
        of[run.condition].append(run)
    several = len({run.testbed for run in runs if run.testbed}) > 1
    for number in sorted(of):
        found = of[number]
        task = (condition_link(content, place, number), f": {task_words_of(number)}")
        yield _table(content, place, found, element("h3", task), several=several)
        why = [
            element("p", f"Run {run.run_number} does not count: ", said(_why(run)), ".")
            for run in found
            if not run.valid
        ]
        yield why or NOTHING


def _why(run: RunSummary) -> str:
    return why_left_out(run) if run.problem is None else "its result cannot be used"


def _table(
    content: SiteContent,
    place: str,
    runs: Sequence[RunSummary],
    caption: Markup,
    *,
    several: bool,
) -> Markup:
    def rows() -> Iterator[tuple[RunSummary, Sequence[Content]]]:
        for run in runs:
            name = run_link(content, place, run, f"run {run.run_number}")
            yield run, (name, run.started_text, *((said(run.testbed),) if several else ()))

    second = ("started", *(("testbed",) if several else ()))
    return runs_table("run", rows(), second, caption)


# The page of a run for a phone: outcome and values; the report has the rest.


def run_page(
    content: SiteContent,
    run: RunSummary,
    files: Sequence[str],
    result: PagedResult | ListedResult | None,
) -> str:
    """The page of a run that has one.

    `files` of the run are on the site, as seen from its root, its report first. `result` is without
    its steps where they cannot be read; None = a page without it.
    """
    place = content.places[run.folder]
    named = f"Run {run.run_number} of team {content.who(run.subject)}"
    return site_page(
        content,
        place,
        (f"Run {run.run_number} of team ", team_link(content, place, run.subject)),
        NOTHING if result is None else list(_told(result, content.source(run))),
        section("Report and downloads", _files(place, files)),
        title=f"{named} in condition {run.condition}",
        lines=_run_lines(content, place, run),
    )


def _run_lines(content: SiteContent, place: str, run: RunSummary) -> Iterator[Content]:
    yield condition_link(content, place, run.condition), f": {task_words_of(run.condition)}"
    on = f", on {run.testbed}" if run.testbed else ""
    yield f"Started {date_text(run.started)}{on}. Ruleset {run.ruleset}, issue {run.issue}."
    yield outcome_cell(run)
    if run.voided:
        yield VOIDED
    elif run.outcome is not None and run.outcome in INVALID:
        yield INVALID[run.outcome]
    if not run.valid:
        yield f"Why it does not count: {why_left_out(run)}."


def _told(result: PagedResult | ListedResult, folder: Path) -> Iterator[Content]:
    values = indicator_section(result.told, _title)
    if isinstance(result, PagedResult):
        done = steps(result.steps, result.start) if result.steps else NOTHING
        again = issues(result.reissues, earlier_issues(folder, result.reissues))
        yield element("div", values, element("div", done, again), class_="lists")
    else:
        yield values
        yield element("p", f"Another version wrote the result: its steps stand in {RESULT_FILE}.")


def _title(name: IndicatorName) -> Content:
    what = element("small", f"{name.spec.better} is better")
    return element("b", name.words, star(name)), what


def _files(place: str, files: Sequence[str]) -> Content:
    if not files:
        return element("p", "The report is not made yet.")
    names = [beside(place, name) for name in files]
    return listed([link(name, name) for name in names], "")
