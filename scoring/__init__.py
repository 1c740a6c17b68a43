"""Numbers in, scores out.

The rules are in `PROTOCOL.md` beside this file. No ROS, no terminal, no bags; of files only
EUROBENCH's. What stands in `__all__` is the interface, and nothing else is:

    from scoring import Condition, evaluate

    result = evaluate(
        Condition.from_number(7),  # or by its benchmark type and sides
        start,  # s, on the clock of the samples
        door=(times, angles),
        handle=(times, forces),
        passage={"cw_left": (times, ranges), "cw_right": (times, ranges)},  # and `ccw_...`
    )
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scoring.arrays import Evaluation, evaluate
    from scoring.indicator_table import RulesetName
    from scoring.protocol import BenchmarkType, Condition, ScoringError, Side, Thresholds
    from scoring.result import Result

__all__ = [
    "BenchmarkType",
    "Condition",
    "Evaluation",
    "Result",
    "RulesetName",
    "ScoringError",
    "Side",
    "Thresholds",
    "evaluate",
]

_MODULES = ("protocol", "indicator_table", "result", "arrays")


def __getattr__(name: str) -> Any:  # noqa: ANN401  whatever is asked for
    """Imported when asked for: the console's screens do without the numbers' machinery."""
    for module in _MODULES if name in __all__ else ():
        if hasattr(imported := import_module(f"{__name__}.{module}"), name):
            return getattr(imported, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
