"""The page of a run for a phone: how it ended and its values; the report has all of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from madrob_console.archive.history import RunSummary
from madrob_console.publishing.site_content import SiteContent, beside
from madrob_console.publishing.site_frame import (
    condition_link,
    outcome_cell,
    site_page,
    task_words_of,
    team_link,
)
from madrob_console.report.explanations import (
    DOUBTS_NOTE,
    INVALID,
    MANUAL_START_NOTE,
    NONE,
    UNCERTAINTY_NOTE,
    VOIDED,
    date_text,
)
from madrob_console.report.markup import Content, Markup, element, link, listed, section, table
from madrob_console.standings.competition import why_left_out
from scoring.indicator_table import IndicatorName, unit_text
from scoring.result import uncertainty_text, value_text


def run_page(content: SiteContent, run: RunSummary, files: Sequence[str]) -> str:
    """The page of a run.

    Args:
        content: of the site.
        run: one that has a page.
        files: of the run that are on the site, as seen from its root; its report first.
    """
    place = content.places[run.folder]
    named = f"Run {run.run_number} of team {content.who(run.subject)}"
    return site_page(
        content,
        place,
        (f"Run {run.run_number} of team ", team_link(content, place, run.subject)),
        section("Indicators", _values(run), *_notes(run)),
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


def _values(run: RunSummary) -> Markup:
    def rows() -> Iterator[tuple[Content, Content]]:
        for name in IndicatorName:
            star = " *" if name.spec.with_the_start else ""
            what = element("small", f"{name.spec.better} is better")
            value = run.values.get(name)
            if value is None:
                yield (element("b", name.words, star), what), f"{NONE}{run.sign(name)}"
                continue
            known = run.uncertainties.get(name)
            spread = filter(None, (uncertainty_text(known), unit_text(name.spec.unit)))
            number = element("b", value_text(value, known) + run.sign(name))
            unit = element("span", f" {' '.join(spread)}", class_="unit")
            yield (element("b", name.words, star), what), (number, unit)

    return table(("indicator", "value"), rows(), class_="indicators")


def _notes(run: RunSummary) -> Iterator[Markup]:
    if run.doubts:
        told = [
            f"{name.words}: {run.doubts[name]}, told in the report"
            for name in IndicatorName
            if name in run.doubts
        ]
        yield element("p", DOUBTS_NOTE)
        yield listed(told, "")
    yield element("p", MANUAL_START_NOTE)
    if run.uncertainties:
        yield element("p", element("small", UNCERTAINTY_NOTE))


def _files(place: str, files: Sequence[str]) -> Content:
    if not files:
        return element("p", "The report is not made yet.")
    names = [beside(place, name) for name in files]
    return listed([link(name, name) for name in names], "")
