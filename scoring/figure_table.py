"""The figures: what each shows and marks, in one table (protocol section 6).

Two renderers draw them: `scoring.figures` with matplotlib draws the five of the protocol
document for one run; the console's screens draw them into cells. NumPy is not imported here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum, StrEnum, auto

from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, EventName, NamedRow

LARGEST_JERK = 2.0
"""Jerk is drawn up to here, as in the document, rad/s^3."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelSpec:
    """How a quantity is drawn over time.

    Attributes:
        label: what stands beside the axis.
        filtered: how the values were filtered, before the label.
        remark: what else a screen says of the curve.
        least: the axis spans at least this much, so that noise looks like noise.
        clip: absolute values are drawn, at most this large; None = values as they are.
    """

    name: str
    label: str
    unit: str
    filtered: str = ""
    remark: str = ""
    least: float
    clip: float | None = None


class Quantity(NamedRow):
    """The quantities that figures show over time."""

    spec: PanelSpec

    POSITION = PanelSpec(
        name="position", label="position", unit="rad", remark="closed zone dotted", least=0.1
    )
    ACCELERATION = PanelSpec(
        name="acceleration", label="acceleration", unit="rad/s^2", filtered="low-passed", least=0.1
    )
    JERK = PanelSpec(
        name="jerk",
        label="abs jerk",
        unit="rad/s^3",
        remark=f"clipped at {LARGEST_JERK:g}",
        least=LARGEST_JERK,
        clip=LARGEST_JERK,
    )
    FORCE = PanelSpec(name="force", label="force", unit="N", remark="as recorded", least=1.0)


class FigurePart(Enum):
    """Which part of a run a figure shows."""

    WHOLE = auto()
    OPENING = auto()
    CLOSING = auto()


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureSpec:
    """One or two panels over a common time axis; `meaning` says how the indicator follows."""

    name: str
    title: str
    panels: tuple[Quantity, ...]
    indicator: IndicatorName
    meaning: str
    part: FigurePart = FigurePart.WHOLE


_OF_THE_JERK = FigureSpec(
    name="figure_2_jerk",
    title=f"position and jerk clipped at {LARGEST_JERK:g} rad/s^3",
    panels=(Quantity.POSITION, Quantity.JERK),
    indicator=IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION,
    meaning="10/mean abs jerk",
)


class FigureName(NamedRow):
    """The figures in the document's order, named like their files."""

    spec: FigureSpec

    ACCELERATION = FigureSpec(
        name="figure_1_acceleration",
        title="position and low-passed acceleration",
        panels=(Quantity.POSITION, Quantity.ACCELERATION),
        indicator=IndicatorName.UNSAFETY_OF_DOOR_OPERATION,
        meaning="the maximum",
    )
    JERK = _OF_THE_JERK
    JERK_OF_THE_OPENING = replace(
        _OF_THE_JERK,
        name="figure_3_jerk_of_the_opening",
        title="jerk while the door opens",
        part=FigurePart.OPENING,
    )
    JERK_OF_THE_CLOSING = replace(
        _OF_THE_JERK,
        name="figure_4_jerk_of_the_closing",
        title="jerk while the door closes",
        part=FigurePart.CLOSING,
    )
    FORCE = FigureSpec(
        name="figure_5_force",
        title="handle force",
        panels=(Quantity.FORCE,),
        indicator=IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION,
        meaning="the maximum",
    )

    @property
    def number(self) -> int:
        return list(FigureName).index(self) + 1


class EventMark(StrEnum):
    """The events that figures mark; each has a letter of its own."""

    TOUCH = "touch"
    OPENING = "opening"
    CROSSING = "crossing"
    CLOSING = "closing"

    @property
    def letter(self) -> str:
        return "x" if self is EventMark.CROSSING else self[0]


def marked_events(
    events: Iterable[tuple[float, str]], condition: Condition | None
) -> dict[EventMark, list[float]]:
    """Return the times of the marked events that happened, by their marks.

    Args:
        events: times, s, and names, in order of time.
        condition: says which side a crossing ends on; None = no crossing is marked.
    """
    marks: dict[str, EventMark] = {
        EventName.HANDLE_IS_TOUCHED: EventMark.TOUCH,
        EventName.DOOR_OPENS: EventMark.OPENING,
        EventName.DOOR_CLOSES: EventMark.CLOSING,
    }
    if condition is not None:
        marks[EventName.moves_to(condition.destination_side)] = EventMark.CROSSING
    marked: dict[EventMark, list[float]] = {mark: [] for mark in EventMark}
    for time, name in events:
        if name in marks:
            marked[marks[name]].append(time)
    return {mark: times for mark, times in marked.items() if times}
