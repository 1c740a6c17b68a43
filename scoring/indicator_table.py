"""The performance indicators, all that is said of each (protocol section 6), and the rulesets.

Results, screens, reports, standings and files ask here. A new indicator is a row here and its
computation in `indicators`; one without a row cannot be imported.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from scoring.protocol import NamedRow, ScoringError


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


class RulesetName(StrEnum):
    """The rules by which signals become indicators, as results name them (section 9)."""

    PROTOCOL = "protocol"
    EUROBENCH_2020 = "eurobench-2020"

    def explanation(self, name: IndicatorName) -> str:
        """Return what an indicator means by these rules, for readers who do not know them."""
        if self is RulesetName.EUROBENCH_2020 and name in _BY_THE_SCRIPTS:
            return _BY_THE_SCRIPTS[name]
        return name.spec.explanation


_BY_THE_SCRIPTS = {
    IndicatorName.EXECUTION_TIME: (
        "From the start of the run until the door was closed and the robot through, whichever "
        "came later."
    ),
    IndicatorName.CAPABILITY_LEVEL: (
        "How many of four things happened, in any order: arrival, touch, passage, closing."
    ),
}


def ruleset(name: str) -> RulesetName:
    """Return the ruleset of a name.

    `ScoringError` unless there is one.
    """
    if name not in [*RulesetName]:
        allowed = " or ".join(RulesetName)
        raise ScoringError(f"ruleset {name!r} is not known: use --ruleset {allowed}")
    return RulesetName(name)
