"""The rules by which signals become indicators: the protocol's, and those of 2020 (section 9)."""

from __future__ import annotations

from enum import StrEnum

from scoring.indicator_table import IndicatorName
from scoring.protocol import ScoringError


class RulesetName(StrEnum):
    """The rulesets, as results and settings name them."""

    PROTOCOL = "protocol"
    EUROBENCH_2020 = "eurobench-2020"

    def explanation(self, name: IndicatorName) -> str:
        """What an indicator means by these rules, for readers who do not know them."""
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
    """Return the ruleset of a name; `ScoringError` unless there is one."""
    if name not in [*RulesetName]:
        allowed = " or ".join(RulesetName)
        raise ScoringError(f"ruleset {name!r} is not known: use --ruleset {allowed}")
    return RulesetName(name)
