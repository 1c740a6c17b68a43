"""The page of a condition: all teams beside each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from madrob_console.archive.history import RunSummary, rank
from madrob_console.publishing.multiples import BOXES_NOTE, boxes
from madrob_console.publishing.site_content import (
    ORDER,
    SiteContent,
    alike_among,
    best_of,
    condition_place,
)
from madrob_console.publishing.site_frame import run_link, runs_table, site_page, team_link
from madrob_console.report.explanations import task_text
from madrob_console.report.markup import Content, Markup, element, section
from madrob_console.standings.competition import SIGNS, RulesetStandings
from madrob_console.standings.web_page import how_to_read, teams_table
from scoring.protocol import Condition


def condition_page(content: SiteContent, number: int) -> str:
    """The page of a condition.

    Args:
        content: of the site.
        number: of the condition.
    """
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
