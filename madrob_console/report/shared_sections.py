"""The parts that the report of a run and its short page on a competition's site have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from madrob_console.archive.listed_result import ListedResult
from madrob_console.referee.acts import Reissue
from madrob_console.referee.acts.rule import RULED
from madrob_console.referee.flags import common_reason
from madrob_console.referee.on_record import Reissuing
from madrob_console.report.explanations import (
    DOUBTS_NOTE,
    MANUAL_START_NOTE,
    NO_UNCERTAINTY_NOTE,
    NONE,
    UNCERTAINTY_NOTE,
    date_text,
    since,
)
from madrob_console.report.markup import (
    NOTHING,
    Content,
    Markup,
    element,
    listed,
    said,
    section,
    table,
)
from scoring.indicator_table import IndicatorName, unit_text
from scoring.procedure import StepRecord
from scoring.protocol import Outcome
from scoring.result import Indicator, doubts_of, uncertainty_text, value_text

_MOST_ISSUES = 20
"""The latest ones; the journal has all."""


def indicator_section(
    found: Mapping[IndicatorName, Indicator],
    title: Callable[[IndicatorName], Content],
    *notes: Content,
) -> Markup:
    """The indicators, each with its value or why it has none, and what is doubted of them.

    Args:
        found: in their order.
        title: what stands beside the value of one.
        notes: below them.
    """

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
    """Behind the name of an indicator that includes the delay of the manual start."""
    return " *" if name.spec.with_the_start else ""


def _doubts(found: Mapping[IndicatorName, Indicator]) -> Content:
    """Each sentence with the indicators that it is on; nothing where nothing is doubted."""
    doubts = doubts_of(found)
    if not doubts:
        return NOTHING
    told = [
        (element("b", ", ".join(name.words for name in on)), f": {words}.")
        for words, on in doubts.items()
    ]
    return element("p", DOUBTS_NOTE), listed(told, "")


def steps(records: Iterable[StepRecord], start: float) -> Markup:
    """What the sensors say, what the referee says, what counts.

    Args:
        records: the six.
        start: of the run, s since the epoch.
    """

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
    """Why the result was issued again, and what it was before; nothing where it was not.

    Args:
        reissues: oldest first.
        earlier: the issues before; those that cannot be read are missing.
    """
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
    """Level and time of a result; how it ended where it was not completed; whether it was final."""
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
