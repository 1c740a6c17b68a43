"""The page of a team: its runs by condition, and its indicators over the day."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

from madrob_console.archive.history import RunSummary
from madrob_console.publishing.multiples import CURVES_NOTE, curves
from madrob_console.publishing.site_content import SiteContent, beside, team_place, zip_place
from madrob_console.publishing.site_frame import (
    condition_link,
    run_link,
    runs_table,
    site_page,
    task_words_of,
)
from madrob_console.report.explanations import (
    MANUAL_START_NOTE,
    NO_UNCERTAINTY_NOTE,
    UNCERTAINTY_NOTE,
)
from madrob_console.report.markup import NOTHING, Content, Markup, element, link, said, section
from madrob_console.standings.competition import why_left_out
from madrob_console.standings.web_page import counts


def team_page(content: SiteContent, subject: int) -> str:
    """The page of a team.

    Args:
        content: of the site.
        subject: its number.
    """
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
        lines=_lines(content, place, subject, runs),
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


def _lines(
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
    """Why a run does not count; what is wrong with files is the organiser's business."""
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
