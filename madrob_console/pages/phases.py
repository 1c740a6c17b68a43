"""Where the time of a run went, beside the field's median and the team's best other run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum
from statistics import median

from madrob_console.archive.history import rank
from madrob_console.archive.scored import Scored
from madrob_console.common.formatting import counted
from madrob_console.pages.related_runs import ComparedRun, PagePlace
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome, Step
from scoring.result import distinguishable

_NOTHING_TO_COMPARE = (
    "There is nothing to compare with. A completed run is compared with the other completed ones "
    "of condition {} by the same rules that were known when this page was made."
)


class TimedPhase(Enum):
    """A part of a run, up to `step`, or to the stop if None."""

    TOUCH = (Step.TOUCH, "start to touch")
    OPEN = (Step.OPEN, "touch to opening")
    CROSS = (Step.CROSS, "opening to crossed")
    CLOSE = (Step.CLOSE, "crossed to closed")
    LOCK = (Step.LOCK, "closed to locked")
    REST = (None, "no further step")

    def __init__(self, step: Step | None, words: str) -> None:
        self.step = step
        self.words = words


PhaseTimes = Mapping[TimedPhase, float]
"""How long each phase was, s; a phase that was not completed is missing."""


def phases(scored: Scored, place: PagePlace) -> dict[str, object]:
    """Return what the report shows of the phases.

    Without `columns` it shows none.
    """
    result = scored.result
    done = {one.step: one.final - result.start for one in result.steps if one.final is not None}
    own = phases_of(done, None if result.stop is None else result.stop - result.start)
    if result.outcome is Outcome.ABORTED or not own:
        return {"columns": {}}

    columns = {"this run": own}
    words = []
    if not place.field:
        words.append(_NOTHING_TO_COMPARE.format(scored.record.setup.condition.number))
    else:
        columns["median"] = median_phases(phases_of(run.steps) for run in place.field)
        words.append(_median_note(place.field))
        words += _differences(own, columns["median"], 2 / scored.rows.thresholds.rate)
    subject = scored.record.setup.subject
    team = [run for run in place.field if run.summary.subject == subject]
    if team:
        best = min(team, key=lambda run: rank(run.summary))
        columns["team's best other"] = phases_of(best.steps)
        words.append(_comparison(scored, place, best))
    known = set().union(*columns.values())
    return {
        "columns": columns,
        "longest": max(sum(times.values()) for times in columns.values()),
        "phases_shown": [phase for phase in TimedPhase if phase in known],
        "time_words": words,
    }


def phases_of(steps: Mapping[Step, float], stop: float | None = None) -> PhaseTimes:
    """Return the phases of a run, in order.

    Steps and stop in s since the start.

    A phase that took no time is left out, such as the locking of a door without a latch.
    """
    durations = {}
    last = 0.0
    for phase in TimedPhase:
        end = stop if phase.step is None else steps.get(phase.step)
        if end is not None and end > last:
            durations[phase] = end - last
            last = end
    return durations


def median_phases(runs: Iterable[PhaseTimes]) -> PhaseTimes:
    """Return the median of each phase over the runs that completed it."""
    every = list(runs)
    medians = {}
    for phase in TimedPhase:
        times = [run[phase] for run in every if phase in run]
        if times:
            medians[phase] = median(times)
    return medians


def _median_note(field: Sequence[ComparedRun]) -> str:
    teams = len({run.summary.subject for run in field})
    runs = counted(len(field), "other completed run")
    return (
        f"Median: of each phase over the {runs} of {counted(teams, 'team')} in this condition that "
        "were known when this page was made. The medians do not add up to one run."
    )


def _differences(own: PhaseTimes, medians: PhaseTimes, least: float) -> Iterator[str]:
    """Name the phases that lost and won most, if by more than `least` s."""
    differences = sorted(
        (own[phase] - time, phase.words) for phase, time in medians.items() if phase in own
    )
    if not differences:
        return
    won, fastest = differences[0]
    lost, slowest = differences[-1]
    if lost > least:
        yield f"Beside the median, most time was lost from {slowest}: {lost:.2f} s."
    if won < -least:
        yield f"Beside the median, most was won from {fastest}: {-won:.2f} s."


def _comparison(scored: Scored, place: PagePlace, best: ComparedRun) -> str:
    """Say which is the team's best run: this one, or `best` of the others."""
    other = best.summary
    itself = place.itself
    words = f"The best of the team's other runs in this condition is run {other.run_number}."
    if itself is not None and itself.valid and rank(itself) < rank(other):
        words = (
            "This is the team's best run in this condition so far; "
            f"the next is run {other.run_number}."
        )
    name = IndicatorName.EXECUTION_TIME
    time = scored.result.indicators[name]
    other_time = other.values.get(name)
    if time.value is None or other_time is None:
        return words
    other_uncertainty = other.uncertainties.get(name)
    if not distinguishable(time.value, other_time, time.uncertainty, other_uncertainty):
        words += " Their execution times are a tie within the uncertainty."
    return words
