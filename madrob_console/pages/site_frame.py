"""The frame of a site's pages, and small multiples."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from madrob_console.archive.folders import INDEX_PAGE
from madrob_console.archive.history import PROTEST_OPEN, RunSummary, condition_words
from madrob_console.pages.markup import (
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
    themed,
)
from madrob_console.pages.shared_sections import NONE, PRACTICE_STANDINGS
from madrob_console.pages.site_content import (
    NONE_ALIKE,
    PLAN,
    Alike,
    SiteContent,
    beside,
    condition_place,
    drawable,
    team_place,
)
from madrob_console.pages.tally import ALIKE
from madrob_console.referee.flags import FlagKind, weighty
from scoring.figures.team_drawings import (
    FAILED,
    FEWEST_FOR_A_BOX,
    ROW,
    BoxRow,
    DayPoint,
    box_plot,
    day_curve,
)
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
    """A page of the site; `place` is its path, `lines` stand below the heading.

    `title` stands before the competition in the browser's tab; empty = the competition alone.
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
    found: list[Content] = []
    for name, words in ((INDEX_PAGE, "overview"), (PLAN, "plan")):
        if name != place and (name != PLAN or content.plan is not None):
            found.append(link(beside(place, name), words))
    entries = [*found, *more]
    return element("nav", [(entry, " ") for entry in entries], aria_label="This competition")


def team_link(content: SiteContent, place: str, subject: int) -> Content:
    words = (f"{subject} ", said(content.team_name(subject)))
    return link(beside(place, team_place(subject)), words) if subject in content.of_team else words


def condition_link(content: SiteContent, place: str, number: int) -> Content:
    words = f"condition {number}"
    if number not in content.conditions:
        return words
    return link(beside(place, condition_place(number)), words)


def run_link(content: SiteContent, place: str, run: RunSummary, words: Content) -> Content:
    """Without a link where the run has no page."""
    target = content.places.get(run.folder)
    whole = element("span", words, class_="whole")
    return link(beside(place, target), whole) if target else whole


def task_words_of(number: int) -> str:
    """Task of a condition: `Sudden Force, pull, from CW to CCW`."""
    return ", ".join(filter(None, reversed(condition_words(number))))


_CLOSING_WORDS = {
    "protested": "PROTESTED by the team",
    PROTEST_OPEN: "NOT FINAL: a PROTEST is open",
}
"""Longer words than a list has room for."""


def outcome_cell(run: RunSummary) -> Content:
    told = (FlagKind.VOID, FlagKind.PRACTICE, FlagKind.PROTEST)
    words = [flag.words for flag in weighty(run.flags) if flag.kind not in told]
    if run.outcome is not None and run.problem is None and run.closing != "final":
        words.insert(0, _CLOSING_WORDS.get(run.closing, run.closing))
    below = element("small", "; ".join(words)) if words else NOTHING
    return element("b", run.outcome_word), " ", below


def value_cell(run: RunSummary, name: IndicatorName, alike: Alike = NONE_ALIKE) -> Content:
    sign = run.sign(name) + (ALIKE if name in alike.get(run.folder, ()) else "")
    value = run.values.get(name)
    if value is None:
        return f"{NONE}{run.sign(name)}"
    known = run.uncertainties.get(name)
    text = f"{value_text(value, known)}{sign} {uncertainty_text(known)}".rstrip()
    return element("span", text, class_="whole")


def heads_of_values(names: Iterable[IndicatorName] = IndicatorName) -> Iterator[str]:
    for name in names:
        yield f"{name.words.partition(' of ')[0]}, {unit_text(name.spec.unit)}"


def runs_table(
    first: str,
    rows: Iterable[tuple[RunSummary, Sequence[Content]]],
    second: Sequence[str],
    caption: Content,
    alike: Alike = NONE_ALIKE,
) -> Markup:
    """Runs with how they ended and all of their values; level first."""
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


# Small drawings of all indicators: boxes of teams, curves over a day.


BOXES_NOTE = (
    f"Circles: completed runs. From {FEWEST_FOR_A_BOX} of them on a box has their middle half, its "
    "thick line is the median, the thin one goes from the smallest to the largest. "
    f"{FAILED}: runs that failed, in no box and, where they lie beyond the scale, at its edge. "
    "Before them: how many completed + failed."
)
CURVES_NOTE = (
    "Points: completed runs with their expanded uncertainty, joined within a condition, whose "
    f"number stands at the last one. {FAILED}: runs that failed, in no curve and, where they lie "
    "beyond the scale, at its edge."
)

_MOST_SPOKEN = 12  # values in the words of one drawing; all stand in the tables
_MOST_MARKS = 5  # times on an axis
_CLOCK = "%H:%M"
_STEPS = (60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400)


def boxes(runs: Mapping[int, Sequence[RunSummary]], who: Callable[[int], str]) -> Markup:
    """A box plot for each indicator that has a value; a row a team, all runs of one condition."""
    return element("div", _boxes(runs, who), class_="multiples")


def _boxes(runs: Mapping[int, Sequence[RunSummary]], who: Callable[[int], str]) -> Iterator[Markup]:
    for name in IndicatorName:
        rows = {subject: _box_row(found, name) for subject, found in runs.items()}
        if not any(row.completed or row.failed for row in rows.values()):
            continue
        words = [f"{who(subject)}: {_spoken(row)}" for subject, row in rows.items()]
        spoken = f"{_caption(name)}. {'; '.join(words)}"
        drawing = box_plot(tuple(rows.values()), spoken, all_shown=name.spec.counts)
        names = [element("span", said(who(subject))) for subject in rows]
        counts = [
            element("span", f"{len(row.completed)}+{len(row.failed)}") for row in rows.values()
        ]
        style = f"line-height: {ROW}px"
        beside = (
            element("div", names, class_="names teams", style=style),
            element("div", counts, class_="names", style=style),
        )
        yield element(
            "figure",
            element("figcaption", _title(name)),
            element("div", *beside, themed(drawing), class_="lanes"),
        )


def _box_row(runs: Sequence[RunSummary], name: IndicatorName) -> BoxRow:
    values = [(run.outcome, value) for run in runs if (value := drawable(run, name)) is not None]
    return BoxRow(
        tuple(value for outcome, value in values if outcome is Outcome.COMPLETED),
        tuple(value for outcome, value in values if outcome is not Outcome.COMPLETED),
    )


def _spoken(row: BoxRow) -> str:
    told = [_values(row.completed, "completed"), _values(row.failed, "failed")]
    return ", ".join(filter(None, told)) or "no value"


def _values(values: Sequence[float], word: str) -> str:
    if not values:
        return ""
    return f"{len(values)} {word} from {value_text(min(values))} to {value_text(max(values))}"


def curves(runs: Sequence[RunSummary]) -> Markup:
    """A curve over the day for each indicator that has a value; at least one run, oldest first."""
    return element("div", _curves(runs), class_="multiples")


def _curves(runs: Sequence[RunSummary]) -> Iterator[Markup]:
    day = runs[0].started, runs[-1].started
    marks = clock_marks(*day)
    for name in IndicatorName:
        points = [
            DayPoint(
                run.started,
                value,
                run.condition,
                run.outcome is Outcome.COMPLETED,
                known.expanded if (known := run.uncertainties.get(name)) else 0.0,
            )
            for run in runs
            if (value := drawable(run, name)) is not None
        ]
        if points:
            spoken = f"{_caption(name)}. {_points(points)}"
            drawing = themed(day_curve(points, marks, day, spoken, all_shown=name.spec.counts))
            yield element("figure", element("figcaption", _title(name)), drawing)


def _points(points: Sequence[DayPoint]) -> str:
    told = [
        f"{_local(point.time)} condition {point.curve} {value_text(point.value)}"
        f"{'' if point.completed else ' failed'}"
        for point in points[-_MOST_SPOKEN:]
    ]
    more = len(points) - len(told)
    return "; ".join((f"{more} earlier ones", *told) if more else told)


def clock_marks(begin: float, end: float) -> list[tuple[float, str]]:
    """Round local times of day from the first to the last run, with their labels."""
    span = max(end - begin, 1.0)
    step = next((one for one in _STEPS if span / one <= _MOST_MARKS), None)
    if step is None:  # over days
        step = _STEPS[-1] * -(-int(span) // (_STEPS[-1] * _MOST_MARKS))
    east = time.localtime(begin).tm_gmtoff
    first = -(-int(begin + east) // step) * step - east
    times = range(first, int(end) + 1, step) or [int(begin)]
    form = "%d %b" if step >= _STEPS[-1] else "%a %H:%M" if span > _STEPS[-1] else _CLOCK
    return [(float(at), _local(at, form)) for at in times]


def _local(at: float, form: str = _CLOCK) -> str:
    return time.strftime(form, time.localtime(at))


def _caption(name: IndicatorName) -> str:
    return f"{name.words}{_unit_and_direction(name)}"


def _title(name: IndicatorName) -> Content:
    return element("b", name.words), _unit_and_direction(name)


def _unit_and_direction(name: IndicatorName) -> str:
    return f", {unit_text(name.spec.unit)}; {name.spec.better} is better"
