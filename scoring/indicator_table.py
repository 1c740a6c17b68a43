"""The performance indicators and the figures: all that is said of each (protocol section 6).

Results, screens, reports, standings and files ask here. A new indicator is a row here and its
computation in `indicators`; one without a row cannot be imported.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum, StrEnum, auto

from scoring.protocol import Condition, EventName, NamedRow


@dataclass(frozen=True, slots=True, kw_only=True)
class IndicatorSpec:
    """The texts and display rules of one indicator.

    Attributes:
        unit: in ASCII: `rad/s^2`.
        title: over a column of at most 8 characters, without the unit.
        column: over a column of the screens, with the unit where there is room.
        definition: for readers who know the protocol; used in the schema.
        explanation: for readers who do not; used in reports. A ruleset may replace it.
        counts: whether its values are whole numbers.
        extremes: whether smallest and largest value are shown beside the means, as by EUROBENCH.
        with_the_start: whether it includes the delay of a start made by hand (section 8).
    """

    name: str
    unit: str
    title: str
    column: str
    definition: str
    explanation: str
    decimals: int = 2
    higher_is_better: bool = False
    counts: bool = False
    extremes: bool = False
    with_the_start: bool = False

    @property
    def better(self) -> str:
        return "higher" if self.higher_is_better else "lower"


class IndicatorName(NamedRow):
    """The indicators in the protocol's order, named like their files."""

    spec: IndicatorSpec

    EXECUTION_TIME = IndicatorSpec(
        name="execution_time",
        unit="s",
        title="exec",
        column="exec s",
        definition="from the start to the stop, the manual start included.",
        explanation="From the start of the run to its end.",
        with_the_start=True,
    )
    TIME_TO_HANDLE = IndicatorSpec(
        name="time_to_handle",
        unit="s",
        title="handle",
        column="hand s",
        definition="from the start to the touch of the handle, the manual start included.",
        explanation="From the start of the run until the handle was first touched.",
        with_the_start=True,
    )
    DOOR_OCCUPATION_TIME = IndicatorSpec(
        name="door_occupation_time",
        unit="s",
        title="occup",
        column="occup s",
        definition="from the approach to the arrival on the destination side.",
        explanation=(
            "From the robot's arrival at the doorway until it had left on the other side."
        ),
    )
    PASSAGE_TIME = IndicatorSpec(
        name="passage_time",
        unit="s",
        title="passage",
        column="pass s",
        definition="from the touch of the handle to the last closing of the door.",
        explanation="From the touch of the handle until the door was closed again.",
    )
    UNSAFETY_OF_DOOR_OPERATION = IndicatorSpec(
        name="unsafety_of_door_operation",
        unit="rad/s^2",
        title="unsafety",
        column="unsafe",
        decimals=3,
        definition="largest low-passed acceleration of the panel.",
        explanation=(
            "How hard the panel was swung: its largest angular acceleration. Lower is safer."
        ),
        extremes=True,
    )
    SMOOTHNESS_OF_DOOR_ACTUATION = IndicatorSpec(
        name="smoothness_of_door_actuation",
        unit="s^3/rad",
        title="smooth",
        column="smooth",
        decimals=4,
        definition="ten divided by the mean jerk of the open panel.",
        explanation=(
            "How free of jolts the open door moved: 10 divided by the mean jerk. "
            "Higher is smoother."
        ),
        higher_is_better=True,
        extremes=True,
    )
    ROUGHNESS_OF_DOOR_ACTUATION = IndicatorSpec(
        name="roughness_of_door_actuation",
        unit="N",
        title="rough",
        column="rough N",
        definition="largest force on the handle.",
        explanation=("The largest force on the handle, in either direction. Lower is gentler."),
        extremes=True,
    )
    CAPABILITY_LEVEL = IndicatorSpec(
        name="capability_level",
        unit="steps",
        title="level",
        column="level",
        definition="how many of the six steps were done, 0 to 6.",
        explanation="How many of the six steps were done, each after all the ones before it.",
        higher_is_better=True,
        counts=True,
        extremes=True,
    )

    @property
    def words(self) -> str:
        return self.replace("_", " ")


WITH_THE_START = " and ".join(name.words for name in IndicatorName if name.spec.with_the_start)


WITH_EXTREMES = ", ".join(name.words for name in IndicatorName if name.spec.extremes)


def unit_text(unit: str) -> str:
    """The unit as people write it: `rad/s²`."""
    return unit.replace("^2", "²").replace("^3", "³")


# The figures: what each shows, explains and marks, in one table (protocol section 6).
#
# Two renderers draw them: `scoring.figures` with matplotlib draws the five of the protocol
# document for one run; the console's screens draw them into cells. NumPy is not imported here.


LARGEST_JERK = 2.0
"""Jerk is drawn up to here, as in the document, rad/s^3."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelSpec:
    """How a quantity is drawn over time.

    Attributes:
        least: an axis of few rows spans at least this much, so that noise looks like noise.
        clip: absolute values are drawn, at most this large; None = values as they are.
        peak: whether the largest absolute value is the indicator.
        unrecorded: why there is no figure without recorded values; empty = it is derived.
    """

    name: str
    label: str
    unit: str
    filtered: str = ""
    remark: str = ""
    least: float
    clip: float | None = None
    closed_zone: bool = False
    peak: bool = False
    unrecorded: str = ""


class Quantity(NamedRow):
    """The quantities that figures show over time."""

    spec: PanelSpec

    POSITION = PanelSpec(
        name="position",
        label="position",
        unit="rad",
        least=0.1,
        closed_zone=True,
        unrecorded="no door angle was recorded during the run",
    )
    ACCELERATION = PanelSpec(
        name="acceleration",
        label="acceleration",
        unit="rad/s^2",
        filtered="low-passed",
        least=0.1,
        peak=True,
    )
    JERK = PanelSpec(
        name="jerk", label="abs jerk", unit="rad/s^3", least=LARGEST_JERK, clip=LARGEST_JERK
    )
    FORCE = PanelSpec(
        name="force",
        label="force",
        unit="N",
        remark="as recorded",
        least=1.0,
        peak=True,
        unrecorded="no handle force was recorded during the run",
    )


class FigurePart(Enum):
    """Which part of a run a figure shows."""

    WHOLE = auto()
    OPENING = auto()
    CLOSING = auto()


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureSpec:
    """One or two panels over a common time axis; the indicator follows from the last one."""

    name: str
    title: str
    panels: tuple[Quantity, ...]
    indicator: IndicatorName
    meaning: str
    caption: str
    part: FigurePart = FigurePart.WHOLE


_OF_THE_JERK = FigureSpec(
    name="figure_2_jerk",
    title=f"position and jerk clipped at {LARGEST_JERK:g} rad/s^3",
    panels=(Quantity.POSITION, Quantity.JERK),
    indicator=IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION,
    meaning="10/mean abs jerk",
    caption=(
        "Door angle, and how abruptly its acceleration changes while the door is open (jerk). "
        "Smoothness is 10 divided by the mean."
    ),
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
        caption=(
            "Door angle, and angular acceleration without its quick trembling. The largest "
            "value, in either direction, is the unsafety."
        ),
    )
    JERK = _OF_THE_JERK
    JERK_OF_THE_OPENING = replace(
        _OF_THE_JERK,
        name="figure_3_jerk_of_the_opening",
        title="jerk while the door opens",
        caption="The same, from the first opening until wide open.",
        part=FigurePart.OPENING,
    )
    JERK_OF_THE_CLOSING = replace(
        _OF_THE_JERK,
        name="figure_4_jerk_of_the_closing",
        title="jerk while the door closes",
        caption="The same, from wide open until the last closing.",
        part=FigurePart.CLOSING,
    )
    FORCE = FigureSpec(
        name="figure_5_force",
        title="handle force",
        panels=(Quantity.FORCE,),
        indicator=IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION,
        meaning="the maximum",
        caption=(
            "Force on the handle as recorded. The largest value, in either direction, is the "
            "roughness."
        ),
    )

    @property
    def number(self) -> int:
        return list(FigureName).index(self) + 1


class EventMark(StrEnum):
    """The events that figures mark; their first letters differ except for `letter`."""

    TOUCH = "touch"
    OPENING = "opening"
    CROSSING = "crossing"
    CLOSING = "closing"

    @property
    def letter(self) -> str:
        return "x" if self is EventMark.CROSSING else self[0]

    def event(self, condition: Condition | None) -> EventName | None:
        """The marked event; None for a crossing if the run's condition is not known."""
        match self:
            case EventMark.TOUCH:
                return EventName.HANDLE_IS_TOUCHED
            case EventMark.OPENING:
                return EventName.DOOR_OPENS
            case EventMark.CROSSING:
                return None if condition is None else EventName.moves_to(condition.destination_side)
            case EventMark.CLOSING:
                return EventName.DOOR_CLOSES


def marked_events(
    events: Iterable[tuple[float, str]], condition: Condition | None
) -> dict[EventMark, list[float]]:
    """The times of the marked events that happened; `events` are in order of time."""
    told = list(events)
    found = {
        mark: [time for time, name in told if name == mark.event(condition)] for mark in EventMark
    }
    return {mark: times for mark, times in found.items() if times}
