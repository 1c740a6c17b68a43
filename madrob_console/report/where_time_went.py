"""Where the time of a run went, beside the field's median and the team's best run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from madrob_console.archive.history import rank
from madrob_console.archive.scored import Scored
from madrob_console.report.explanations import NONE, date_text
from madrob_console.report.markup import NOTHING, Content, Markup, element, section, table
from madrob_console.report.surroundings import ComparedRun, PagePlace
from madrob_console.report.theme import themed
from scoring.figures.phases import BAR, PhaseTimes, TimedPhase, median_phases, phase_bars, phases_of
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import distinguishable

_ALIKE = 2
"""Sampling intervals by which phases differ that are told apart: each edge may be one off."""


@dataclass(frozen=True, slots=True)
class _Column:
    """A bar, and a column of the table.

    Attributes:
        name: of it.
        phases: what it shows.
    """

    name: str
    phases: PhaseTimes

    @property
    def total(self) -> float:
        return sum(self.phases.values())

    @property
    def words(self) -> str:
        parts = (f"{phase.words} {time:.2f} s" for phase, time in self.phases.items())
        return f"{self.name} {self.total:.2f} s: {', '.join(parts)}"


def phases(scored: Scored, place: PagePlace) -> Markup:
    """Bars, the numbers behind them, and what follows."""
    result = scored.result
    if result.outcome is Outcome.ABORTED:
        return NOTHING
    done = {one.step: one.final for one in result.steps if one.final is not None}
    own = _Column("this run", phases_of(done, result.start, result.stop))
    if not own.phases:
        return NOTHING
    columns = [own]
    best = min((run for run in place.field if _of_team(run, scored)), key=_rank, default=None)
    if place.field:
        columns.append(_Column("median", median_phases(run.phases for run in place.field)))
    if best is not None:
        next_best = _leads(place, best)
        columns.append(_Column("team's next" if next_best else "team's best", best.phases))
    shown = [phase for phase in TimedPhase if any(phase in column.phases for column in columns)]
    names = [element("span", column.name) for column in columns]
    style = f"line-height: {BAR}px"
    said = "Where the time went. " + "; ".join(column.words for column in columns)
    picture = themed(phase_bars([column.phases for column in columns], said))
    return section(
        "Where the time went",
        element("div", element("div", names, class_="names", style=style), picture, class_="lanes"),
        table(
            ("phase", *(f"{column.name}, s" for column in columns)),
            _rows(columns, shown),
            class_="numbers",
        ),
        [element("p", words) for words in _words(scored, place, best, columns)],
        name="time",
    )


def _of_team(run: ComparedRun, scored: Scored) -> bool:
    return run.summary.subject == scored.record.setup.subject


def _leads(place: PagePlace, best: ComparedRun) -> bool:
    """Whether this run is the team's best, before the best of the others."""
    itself = place.itself
    return itself is not None and itself.valid and rank(itself) < _rank(best)


def _rank(run: ComparedRun) -> tuple[float, bool, float, float]:
    return rank(run.summary)


def _rows(columns: list[_Column], shown: list[TimedPhase]) -> Iterator[tuple[Content, ...]]:
    for phase in shown:
        style = f"background: {phase.colour}"
        chip = element("span", "", class_="chip", style=style)
        times = (column.phases.get(phase) for column in columns)
        cells = (NONE if time is None else f"{time:.2f}" for time in times)
        yield ((themed(chip), " ", phase.words), *cells)
    yield (element("b", "in all"), *(element("b", f"{column.total:.2f}") for column in columns))


def _words(
    scored: Scored, place: PagePlace, best: ComparedRun | None, columns: list[_Column]
) -> Iterator[Content]:
    least = _ALIKE / scored.rows.thresholds.rate
    if (rest := columns[0].phases.get(TimedPhase.REST, 0.0)) > least:
        yield f"For the last {rest:.2f} s no further step was done."
    if not place.field:
        yield (
            "There is nothing to compare with. A completed run is compared with the other "
            f"completed ones of condition {scored.record.setup.condition.number} by the same rules "
            "that were known when this page was made."
        )
        return
    teams = len({run.summary.subject for run in place.field})
    runs = _counted(len(place.field), "other completed run")
    latest = date_text(max(run.summary.started for run in place.field))
    yield element(
        "small",
        f"Median: of each phase over the {runs} of {_counted(teams, 'team')} in this condition, "
        "of those that brought it to its end. Its sum is no run's. Compared with what was known "
        f"when this page was made; the latest started {latest}.",
    )
    yield from _lost(columns[0], columns[1], least)
    if best is not None:
        yield _beside_best(scored, place, best)


def _lost(own: _Column, median: _Column, least: float) -> Iterator[Content]:
    """Where most time was lost, and where most was won, if it is more than sampling leaves."""
    both = [
        (own.phases[phase] - time, phase)
        for phase, time in median.phases.items()
        if phase in own.phases
    ]
    if not both:
        return
    slow, fast = max(both, key=lambda one: one[0]), min(both, key=lambda one: one[0])
    said = []
    if slow[0] > least:
        said.append(f"most time was lost from {slow[1].words}: {slow[0]:.2f} s")
    if fast[0] < -least:
        said.append(f"most was won from {fast[1].words}: {-fast[0]:.2f} s")
    alike = f"no phase that was ended differs by more than {least:.2f} s"
    yield f"Beside the median, {'; '.join(said) or alike}."


def _beside_best(scored: Scored, place: PagePlace, best: ComparedRun) -> Content:
    name = IndicatorName.EXECUTION_TIME
    there, own = best.summary, scored.result.indicators[name]
    which = f"run {there.run_number}"
    words = f"The best of the team's other runs in this condition is {which}."
    if _leads(place, best):
        words = f"This is the team's best run in this condition so far; the next is {which}."
    theirs = there.values.get(name)
    if own.value is not None and theirs is not None:
        known = own.uncertainty, there.uncertainties.get(name)
        if not distinguishable(own.value, theirs, *known):
            words += " Their execution times are not distinguishable: the uncertainties overlap."
    return words


def _counted(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
