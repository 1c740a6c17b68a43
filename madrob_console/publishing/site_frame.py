"""What all pages of a site have: title, ways around, foot; and cells that several of them show."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from madrob_console.archive.folders import INDEX_PAGE
from madrob_console.archive.history import PROTEST_OPEN, RunSummary, condition_words
from madrob_console.publishing.site_content import (
    NONE_ALIKE,
    PLAN,
    Alike,
    SiteContent,
    beside,
    condition_place,
    team_place,
)
from madrob_console.referee.flags import FlagKind
from madrob_console.report.explanations import NONE, PRACTICE_STANDINGS
from madrob_console.report.markup import (
    NOTHING,
    SKIP,
    Content,
    Markup,
    element,
    link,
    page,
    said,
    skip_link,
    table,
)
from madrob_console.standings.tally import ALIKE
from scoring.indicator_table import IndicatorName, unit_text
from scoring.protocol import Outcome
from scoring.result import uncertainty_text, value_text


def site_page(
    content: SiteContent,
    place: str,
    heading: Content,
    *parts: Content,
    title: str = "",
    head: Content = NOTHING,
    lines: Iterable[Content] = (),
) -> str:
    """A page of the site.

    Args:
        content: of the site.
        place: of the page in the site.
        heading: its first heading.
        parts: what it is about.
        title: before the competition in the browser's tab; empty = the competition alone.
        head: more that its head says.
        lines: below the heading.
    """
    official = content.standings.official
    named = f"{title} - {content.title}" if title else content.title
    return page(
        named,
        skip_link(),
        element(
            "header",
            NOTHING if official else element("p", PRACTICE_STANDINGS, class_="banner"),
            element("p", "MADROB ", said(content.standings.title), class_="competition"),
            element("h1", heading),
            [element("p", line) for line in lines],
        ),
        ways(content, place),
        element("main", parts, id=SKIP),
        element("footer", f"Made with madrob-console {content.software or 'unknown'}."),
        head=head,
        wide=True,
    )


def ways(content: SiteContent, place: str, more: Sequence[Content] = ()) -> Markup:
    """The ways around the site, from a page of it."""
    found: list[Content] = []
    for name, words in ((INDEX_PAGE, "overview"), (PLAN, "plan")):
        if name != place and (name != PLAN or content.plan is not None):
            found.append(link(beside(place, name), words))
    entries = [*found, *more]
    return element("nav", [(entry, " ") for entry in entries], aria_label="This competition")


def team_link(content: SiteContent, place: str, subject: int) -> Content:
    """A team by number and name, as seen from a page."""
    words = (f"{subject} ", said(content.team_name(subject)))
    return link(beside(place, team_place(subject)), words) if subject in content.of_team else words


def condition_link(content: SiteContent, place: str, number: int) -> Content:
    """A condition by its number, as seen from a page."""
    words = f"condition {number}"
    if number not in content.conditions:
        return words
    return link(beside(place, condition_place(number)), words)


def run_link(content: SiteContent, place: str, run: RunSummary, words: Content) -> Content:
    """A run, as seen from a page; without a link where it has no page."""
    target = content.places.get(run.folder)
    whole = element("span", words, class_="whole")
    return link(beside(place, target), whole) if target else whole


def task_words_of(number: int) -> str:
    """What a condition asks of the robot: `Sudden Force, pull, from CW to CCW`."""
    return ", ".join(filter(None, reversed(condition_words(number))))


_CLOSING_WORDS = {
    "protested": "PROTESTED by the team",
    PROTEST_OPEN: "NOT FINAL: a PROTEST is open",
}
"""Where a page says more than a list has room for."""


def outcome_cell(run: RunSummary) -> Content:
    """How a run ended, whether that is the last word, and what a decision on it hangs on."""
    told = (FlagKind.VOID, FlagKind.PRACTICE, FlagKind.PROTEST)
    words = [flag.words for flag in run.flags if flag.kind not in told]
    if run.outcome is not None and run.problem is None and run.closing != "final":
        words.insert(0, _CLOSING_WORDS.get(run.closing, run.closing))
    below = element("small", "; ".join(words)) if words else NOTHING
    return element("b", run.outcome_word), " ", below


def value_cell(run: RunSummary, name: IndicatorName, alike: Alike = NONE_ALIKE) -> Content:
    """The value of an indicator with its uncertainty, in the digits that a report has.

    Args:
        run: which one.
        name: which indicator.
        alike: of the runs beside which it stands.
    """
    sign = run.sign(name) + (ALIKE if name in alike.get(run.folder, ()) else "")
    value = run.values.get(name)
    if value is None:
        return f"{NONE}{run.sign(name)}"
    known = run.uncertainties.get(name)
    text = f"{value_text(value, known)}{sign} {uncertainty_text(known)}".rstrip()
    return element("span", text, class_="whole")


def heads_of_values(names: Iterable[IndicatorName] = IndicatorName) -> Iterator[str]:
    """Over the columns of indicators, as short as they are understood."""
    for name in names:
        yield f"{name.words.partition(' of ')[0]}, {unit_text(name.spec.unit)}"


def runs_table(
    first: str,
    rows: Iterable[tuple[RunSummary, Sequence[Content]]],
    second: Sequence[str],
    caption: Content,
    alike: Alike = NONE_ALIKE,
) -> Markup:
    """Runs with how they ended and all of their values; level first.

    Args:
        first: over the first column.
        rows: a run, and the cells before its outcome.
        second: over the other cells before its outcome.
        caption: what it shows.
        alike: of them.
    """
    level = IndicatorName.CAPABILITY_LEVEL
    names = (level, *(name for name in IndicatorName if name is not level))
    every = list(rows)
    cells = [
        (*before, outcome_cell(run), *(value_cell(run, name, alike) for name in names))
        for run, before in every
    ]
    marks = ["" if run.outcome is Outcome.COMPLETED else "failed" for run, _ in every]
    heads = (first, *second, "result", *heads_of_values(names))
    return table(heads, cells, class_="runs", caption=caption, marked=marks)
