"""Sections that the report and the site's page of a run share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from madrob_console.archive.history import rank
from madrob_console.archive.result_summary import ListedResult
from madrob_console.archive.scored import Scored
from madrob_console.common.formatting import counted
from madrob_console.common.names import SourceKind
from madrob_console.pages.markup import (
    NOTHING,
    Content,
    Markup,
    element,
    listed,
    said,
    section,
    table,
    themed,
)
from madrob_console.pages.surroundings import ComparedRun, PagePlace
from madrob_console.referee.acts import Reissue
from madrob_console.referee.acts.during import RULED
from madrob_console.referee.flags import common_reason
from madrob_console.referee.records import Reissuing, TeamWord
from scoring.figures.team_drawings import (
    BAR,
    PhaseTimes,
    TimedPhase,
    median_phases,
    phase_bars,
    phases_of,
)
from scoring.indicator_table import WITH_THE_START, IndicatorName, unit_text
from scoring.procedure import StepRecord
from scoring.protocol import Condition, LockDetection, Outcome
from scoring.result import Indicator, distinguishable, doubts_of, uncertainty_text, value_text

# Explanations in a report, in words that need no protocol at hand.


NONE = "-"

MANUAL_START_NOTE = (
    f"* Robot and clock were started by hand: {WITH_THE_START} include the delay between the two."
)

UNCERTAINTY_NOTE = (
    "+-: the value lies within it of what happened 95 times in 100, as far as sampling, encoder, "
    "stamps and noise go. Two results whose intervals overlap are not distinguishable."
)

NO_UNCERTAINTY_NOTE = (
    "Values with four decimals and without +-: no uncertainty is known of them. The result was "
    "made by an earlier version, or without the recording."
)

BIAS_NOTE = (
    "Not in the uncertainties, because the direction is known: the steps of the encoder look like "
    "jerk, so that the smoothness of a smooth door is too low."
)

DOUBTS_NOTE = "? marks a value that is doubted, and says of no value that it is wrong:"

INVALID: Mapping[Outcome, str] = {
    Outcome.ABORTED: (
        "INVALID: the referee aborted this run. It has no indicators and counts for nothing; it "
        "stays on record."
    ),
    Outcome.INTERRUPTED: (
        "INTERRUPTED: the machine failed during this run. What could be computed is shown, and "
        "left out of every mean and ranking; the referee decides whether the run is repeated."
    ),
}

VOIDED = (
    "VOID: the referee voided this run. It keeps its indicators, counts for nothing and stays on "
    "record."
)

UNOFFICIAL: Mapping[SourceKind, str] = {
    SourceKind.SIMULATED: "SIMULATED: not an official result. No real door was opened.",
    SourceKind.REPLAY: "REPLAY: not an official result. A recording was played once more.",
}

PRACTICE = "PRACTICE: not an official result."

PRACTICE_STANDINGS = "PRACTICE: not official. Rehearsals, and runs of a simulated testbed."

TEAM_WORDS: Mapping[TeamWord, str] = {
    TeamWord.ACKNOWLEDGED: "The team acknowledged the result.",
    TeamWord.PROTESTED: "The team PROTESTED against the result.",
    TeamWord.ABSENT: "Nobody of the team was there.",
}

SOURCES: Mapping[SourceKind, str] = {
    SourceKind.ROS: "a real testbed, over ROS",
    SourceKind.SIMULATED: "the simulated testbed",
    SourceKind.REPLAY: "a recording",
}

LOCKED_BY: Mapping[LockDetection, str] = {
    LockDetection.AUTO: "latch sensor if there is one",
    LockDetection.SETTLE: "a door that stays closed",
    LockDetection.SENSOR: "the latch sensor",
    LockDetection.REFEREE: "the referee",
}


def plain(name: str) -> str:
    return name.replace("_", " ")


def since(time: float | None, start: float) -> str:
    """A time from the start, s with two decimals, as sampling has it; a dash for none."""
    return NONE if time is None else f"{time - start:.2f}"


def task_text(condition: Condition) -> str:
    way = "pull" if condition.must_pull else "push"
    start, destination = condition.starting_side.upper(), condition.destination_side.upper()
    return f"{way} the door, from side {start} to side {destination}"


def date_text(epoch: float) -> str:
    """Local date and time with the offset from UTC."""
    try:
        local = datetime.fromtimestamp(epoch, tz=UTC).astimezone()
    except (OverflowError, OSError, ValueError):
        return f"{epoch:.3f} s since 1970"
    return f"{local:%Y-%m-%d %H:%M:%S} (UTC{local:%z})"


_MOST_ISSUES = 20
"""The latest ones; the journal has all."""


def indicator_section(
    found: Mapping[IndicatorName, Indicator],
    title: Callable[[IndicatorName], Content],
    *notes: Content,
) -> Markup:
    def row(name: IndicatorName, indicator: Indicator) -> tuple[Content, Content]:
        if indicator.value is None:
            return title(name), element("span", indicator.text, class_="none")
        known = indicator.uncertainty
        value = element("b", value_text(indicator.value, known) + indicator.sign)
        spread = filter(None, (uncertainty_text(known), unit_text(indicator.unit)))
        unit = element("span", f" {' '.join(spread)}", class_="unit")
        return title(name), (value, unit)

    rows = (row(name, indicator) for name, indicator in found.items())
    reason = common_reason(found)
    known = any(uncertainty_text(one.uncertainty) for one in found.values())
    unknown = any(
        one.uncertainty is None and one.value is not None and not name.spec.counts
        for name, one in found.items()
    )
    return section(
        "Indicators",
        element("p", f"None: {reason}.")
        if reason
        else table(("indicator", "value"), rows, class_="indicators"),
        _doubts(found),
        element("p", MANUAL_START_NOTE),
        *notes,
        element("p", element("small", UNCERTAINTY_NOTE)) if known else NOTHING,
        element("p", NO_UNCERTAINTY_NOTE) if unknown else NOTHING,
        name="indicators",
    )


def star(name: IndicatorName) -> str:
    """Mark behind the name of an indicator that includes the delay of the manual start."""
    return " *" if name.spec.with_the_start else ""


def _doubts(found: Mapping[IndicatorName, Indicator]) -> Content:
    doubts = doubts_of(found)
    if not doubts:
        return NOTHING
    told = [
        (element("b", ", ".join(name.words for name in on)), f": {words}.")
        for words, on in doubts.items()
    ]
    return element("p", DOUBTS_NOTE), listed(told, "")


def steps(records: Iterable[StepRecord], start: float) -> Markup:
    """The six steps by sensors, by referee, and as they count; `start` in s since the epoch."""

    def row(record: StepRecord) -> tuple[Content, ...]:
        ruling = record.referee
        name: list[Content] = [f"{record.step:d} {record.step.text}"]
        if record.why_not:
            name.append(element("small", record.why_not))
        referee: Content = NONE
        if ruling is not None:
            referee = RULED[ruling.confirmed], element("small", said(ruling.reason))
        final = since(record.final, start) if record.done else "not done"
        return name, since(record.sensors, start), referee, element("b", final)

    return section(
        "The six steps",
        element("p", "Times in s from the start. What the referee says goes before the sensors."),
        table(("step", "sensors", "referee", "counts"), map(row, records), class_="steps"),
        name="steps",
    )


def issues(reissues: Sequence[Reissuing], earlier: Iterable[ListedResult]) -> Content:
    """Reasons of re-issues, oldest first, and the earlier results that can be read."""
    if not reissues:
        return NOTHING
    known = {one.issue: one for one in earlier}
    told: list[Content] = [
        _issue(one, known.get(one.issue - 1)) for one in reversed(reissues[-_MOST_ISSUES:])
    ]
    if (left_out := len(reissues) - _MOST_ISSUES) > 0:
        told.append(f"and {left_out} before, in the journal")
    return section("Issued again", listed(told, ""), name="issues")


def _issue(one: Reissuing, before: ListedResult | None) -> Content:
    act = "" if one.what == Reissue.name else f" ({one.what})"
    rules = "" if one.ruleset is None else f", by the ruleset {one.ruleset}"
    was = "" if before is None else f"; was: {', '.join(_value_words(before))}"
    return (
        element("b", f"Issue {one.issue}"),
        f": issued again {date_text(one.time)} by ",
        said(one.referee or "the referee"),
        f"{act}{rules}: ",
        said(one.reason or "no reason is told"),
        was,
    )


def _value_words(result: ListedResult) -> Iterator[str]:
    level = result.told.get(IndicatorName.CAPABILITY_LEVEL)
    time = result.told.get(IndicatorName.EXECUTION_TIME)
    if level is not None and level.value is not None:
        yield f"level {value_text(level.value)}{level.sign}"
    if result.outcome is not Outcome.COMPLETED:
        yield result.outcome.value
    elif time is not None and time.value is not None:
        yield time.text
    if result.voided is not None:
        yield "void"
    if result.closure is not None:
        yield "final"


# Where the time of a run went, beside the field's median and the team's best run.


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
    def words(self) -> str:
        parts = (f"{phase.words} {time:.2f} s" for phase, time in self.phases.items())
        return f"{self.name} {self.total:.2f} s: {', '.join(parts)}"


def phases(scored: Scored, place: PagePlace) -> Markup:
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
    runs = counted(len(place.field), "other completed run")
    latest = date_text(max(run.summary.started for run in place.field))
    yield element(
        "small",
        f"Median: of each phase over the {runs} of {counted(teams, 'team')} in this condition, "
        "of those that brought it to its end. Its sum is no run's. Compared with what was known "
        f"when this page was made; the latest started {latest}.",
    )
    yield from _lost(columns[0], columns[1], least)
    if best is not None:
        yield _beside_best(scored, place, best)


def _lost(own: _Column, median: _Column, least: float) -> Iterator[Content]:
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
