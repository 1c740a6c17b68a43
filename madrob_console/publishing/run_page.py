"""The page of a run for a phone: how it ended and its values; the report has all of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from madrob_console.archive.folders import RESULT_FILE
from madrob_console.archive.history import RunSummary
from madrob_console.archive.listed_result import ListedResult, PagedResult
from madrob_console.archive.result_reader import earlier_issues
from madrob_console.publishing.site_content import SiteContent, beside
from madrob_console.publishing.site_frame import (
    condition_link,
    outcome_cell,
    site_page,
    task_words_of,
    team_link,
)
from madrob_console.report.explanations import INVALID, VOIDED, date_text
from madrob_console.report.markup import NOTHING, Content, element, link, listed, section
from madrob_console.report.shared_sections import indicator_section, issues, star, steps
from madrob_console.standings.competition import why_left_out
from scoring.indicator_table import IndicatorName


def run_page(
    content: SiteContent,
    run: RunSummary,
    files: Sequence[str],
    result: PagedResult | ListedResult | None,
) -> str:
    """The page of a run.

    Args:
        content: of the site.
        run: one that has a page.
        files: of the run that are on the site, as seen from its root; its report first.
        result: of the run, without its steps where they cannot be read; None = all but that.
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
        lines=_lines(content, place, run),
    )


def _lines(content: SiteContent, place: str, run: RunSummary) -> Iterator[Content]:
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
    """What the report says of it, too, in the same sections."""
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
