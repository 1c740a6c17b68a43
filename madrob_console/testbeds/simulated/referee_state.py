"""What testbed and robot understand of `/madrob/referee/state`."""

from __future__ import annotations

import json
from dataclasses import dataclass

from madrob_console.errors import MadrobError
from madrob_console.messages.codec import REFEREE_STATE_TOPIC
from scoring.errors import ScoringError
from scoring.protocol import Condition


@dataclass(frozen=True, slots=True)
class RefereeState:
    """Where the run stands, as the referee's console says.

    Attributes:
        phase: `idle`, `ready`, `countdown`, `running`, `stopped` or `final`.
        condition: the condition of the run; None before one is set up.
        start_time: planned or actual start, s since the epoch; None before the countdown.
        subject, run_number: whose run, and which; None before one is set up.
    """

    phase: str
    condition: Condition | None
    start_time: float | None
    subject: int | None = None
    run_number: int | None = None

    def goes_on_with(self, before: RefereeState) -> bool:
        """Whether who said `before` of a run that goes on may say this next."""
        if self.phase not in ("countdown", "running", "stopped"):
            return False
        same_start = before.phase == "countdown" or self.start_time == before.start_time
        mine, its = ((one.subject, one.run_number, one.condition) for one in (self, before))
        return same_start and mine == its


def parse_state(text: str) -> RefereeState:
    """What the referee says on `/madrob/referee/state`.

    Raises:
        MadrobError: it is no JSON object with a `phase`.
    """
    try:
        content = json.loads(text)
        phase, start, number, subject, run = (
            content.get(key)
            for key in ("phase", "start_time", "condition_number", "subject", "run_number")
        )
        condition = None if number is None else Condition.from_number(number)
        return RefereeState(
            str(phase),
            condition,
            None if start is None else float(start),
            None if subject is None else int(subject),
            None if run is None else int(run),
        )
    except (ValueError, TypeError, OverflowError, AttributeError, ScoringError):
        shown = text if len(text) < 60 else f"{text[:60]}..."
        raise MadrobError(f"{REFEREE_STATE_TOPIC}: not understood: {shown!r}") from None
