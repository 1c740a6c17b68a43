"""Where to go from a page: the team's other runs, and the files of this one."""

from __future__ import annotations

from itertools import groupby

from madrob_console.archive.history import condition_words
from madrob_console.report.markup import NOTHING, Content, Markup, element, link, section
from madrob_console.report.surroundings import LinkedRun, PagePlace
from scoring.indicator_table import IndicatorName


def other_runs(place: PagePlace) -> Markup:
    """The team's other runs by condition; nothing where none is known."""
    if not place.team:
        return NOTHING
    entries = []
    for condition, runs in groupby(place.team, key=lambda run: run.summary.condition):
        words = ", ".join(filter(None, reversed(condition_words(condition))))
        linked = [(", ", _run(run)) for run in runs]
        linked[0] = ("", linked[0][1])
        entries.append(element("li", f"Condition {condition} ({words}): ", linked))
    told = element("p", "As known when this page was made.")
    return section("Other runs of the team", element("ul", entries), told, name="runs")


def files(place: PagePlace) -> Markup:
    """All files of the run; nothing where the page lies elsewhere."""
    if not place.files:
        return NOTHING
    entries = [element("li", link(name, name)) for name in place.files]
    told = element("p", "They lie beside this page.")
    return section("Files of this run", told, element("ul", entries, class_="files"), name="files")


def _run(run: LinkedRun) -> Content:
    known = run.summary
    words = f"run {known.run_number}"
    time = known.values.get(IndicatorName.EXECUTION_TIME)
    said = f" ({known.outcome_word}" + (f", {time:.2f} s)" if known.valid and time else ")")
    return link(run.page, words) if run.page else words, said
