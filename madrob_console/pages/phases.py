"""Where the time of a run went, beside the field's median and the team's best run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate, pairwise

from madrob_console.archive.history import rank
from madrob_console.archive.scored import Scored
from madrob_console.common.formatting import counted
from madrob_console.pages.drawings import Scale
from madrob_console.pages.related_runs import ComparedRun, PagePlace
from madrob_console.pages.templates import date_text
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import distinguishable
from scoring.run_drawings import Interval, PhaseTimes, TimedPhase, median_phases, phases_of

_ALIKE = 2
"""Smallest difference between phases, in sampling intervals: each edge may be one off."""


@dataclass(frozen=True, slots=True)
class _Column:
    name: str
    phases: PhaseTimes

    @property
    def total(self) -> float:
        return sum(self.phases.values())

    @property
    def spans(self) -> Iterator[tuple[TimedPhase, Interval]]:
        ends = list(accumulate(self.phases.values()))
        yield from zip(self.phases, pairwise((0.0, *ends)), strict=True)

    @property
    def words(self) -> str:
        parts = (f"{phase.words} {time:.2f} s" for phase, time in self.phases.items())
        return f"{self.name} {self.total:.2f} s: {', '.join(parts)}"


def phases(scored: Scored, place: PagePlace) -> dict[str, object]:
    """The phases as the report shows them; without `columns` it shows none."""
    result = scored.result
    done = {step.step: step.final for step in result.steps if step.final is not None}
    own = _Column("this run", phases_of(done, result.start, result.stop))
    if result.outcome is Outcome.ABORTED or not own.phases:
        return {"columns": ()}
    columns = [own]
    best = min((run for run in place.field if _of_team(run, scored)), key=_rank, default=None)
    if place.field:
        columns.append(_Column("median", median_phases(run.phases for run in place.field)))
    if best is not None:
        columns.append(_Column("team's best other", best.phases))
    said = "Where the time went. " + "; ".join(column.words for column in columns)
    return {
        "columns": columns,
        "phase_scale": Scale(0.0, max(1e-3, *(column.total for column in columns))),
        "phases_spoken": said,
        "phases_shown": [
            phase for phase in TimedPhase if any(phase in column.phases for column in columns)
        ],
        "time_words": list(_words(scored, place, columns[0])),
        "median_note": _median_note(place),
        "comparisons": list(_comparisons(scored, place, best, columns)),
    }


def _of_team(run: ComparedRun, scored: Scored) -> bool:
    return run.summary.subject == scored.record.setup.subject


def _leads(place: PagePlace, best: ComparedRun) -> bool:
    """Whether this run is the team's best, before the best of the others."""
    itself = place.itself
    return itself is not None and itself.valid and rank(itself) < _rank(best)


def _rank(run: ComparedRun) -> tuple[float, bool, float, float]:
    return rank(run.summary)


def _words(scored: Scored, place: PagePlace, own: _Column) -> Iterator[str]:
    if (rest := own.phases.get(TimedPhase.REST, 0.0)) > _least(scored):
        yield f"For the last {rest:.2f} s no further step was done."
    if not place.field:
        yield (
            "There is nothing to compare with. A completed run is compared with the other "
            f"completed ones of condition {scored.record.setup.condition.number} by the same rules "
            "that were known when this page was made."
        )


def _least(scored: Scored) -> float:
    return _ALIKE / scored.rows.thresholds.rate


def _median_note(place: PagePlace) -> str:
    if not place.field:
        return ""
    teams = len({run.summary.subject for run in place.field})
    runs = counted(len(place.field), "other completed run")
    latest = date_text(max(run.summary.started for run in place.field))
    return (
        f"Median: of each phase over the {runs} of {counted(teams, 'team')} in this condition, "
        "of those that brought it to its end. The medians do not add up to one run. Compared with "
        f"what was known when this page was made; the latest started {latest}."
    )


def _comparisons(
    scored: Scored, place: PagePlace, best: ComparedRun | None, columns: list[_Column]
) -> Iterator[str]:
    if place.field:
        yield from _lost(columns[0], columns[1], _least(scored))
    if best is not None:
        yield _beside_best(scored, place, best)


def _lost(own: _Column, median: _Column, least: float) -> Iterator[str]:
    both = [
        (own.phases[phase] - time, phase)
        for phase, time in median.phases.items()
        if phase in own.phases
    ]
    if not both:
        return
    slow, fast = (
        max(both, key=lambda difference: difference[0]),
        min(both, key=lambda difference: difference[0]),
    )
    said = []
    if slow[0] > least:
        said.append(f"most time was lost from {slow[1].words}: {slow[0]:.2f} s")
    if fast[0] < -least:
        said.append(f"most was won from {fast[1].words}: {-fast[0]:.2f} s")
    alike = f"no phase that was ended differs by more than {least:.2f} s"
    yield f"Beside the median, {'; '.join(said) or alike}."


def _beside_best(scored: Scored, place: PagePlace, best: ComparedRun) -> str:
    name = IndicatorName.EXECUTION_TIME
    there, own = best.summary, scored.result.indicators[name]
    which = f"run {there.run_number}"
    words = f"The best of the team's other runs in this condition is {which}."
    if _leads(place, best):
        words = f"This is the team's best run in this condition so far; the next is {which}."
    theirs = there.values.get(name)
    if own.value is not None and theirs is not None:
        uncertainties = own.uncertainty, there.uncertainties.get(name)
        if not distinguishable(own.value, theirs, *uncertainties):
            words += " Their execution times are a tie within the uncertainty."
    return words
