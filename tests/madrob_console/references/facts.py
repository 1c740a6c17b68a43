"""What happens in a reference run, and when a right score may say that it does."""

from __future__ import annotations

import math
from dataclasses import dataclass

from madrob_console.cli.reference_set import Expected
from scoring.protocol import Side, Thresholds
from scoring.rulesets import RulesetName
from tests.madrob_console.references.filters import Array, acceleration_kernel
from tests.madrob_console.references.runs import CLOSED, COUNT, INTERVAL, ReferenceRun

TICK = 1e-6
"""s: what the digits of a time in s since the epoch may do to it."""

TOUCH = Thresholds().touch_force


@dataclass(frozen=True, slots=True)
class Rules:
    """What a ruleset asks of these runs (protocol sections 4 to 9)."""

    name: RulesetName
    average: int
    savgol: int
    both_ways: bool
    present: float
    to_end: bool

    @property
    def kernel(self) -> Array:
        """Of the two windows."""
        return acceleration_kernel(self.average, self.savgol, INTERVAL)


PROTOCOL = Rules(RulesetName.PROTOCOL, 9, 9, both_ways=True, present=0.5, to_end=False)
EUROBENCH = Rules(RulesetName.EUROBENCH_2020, 11, 11, both_ways=False, present=1.0, to_end=True)


@dataclass(frozen=True, slots=True)
class Span:
    """When something happened, and when a right score may say that it did, s since the start."""

    truth: float
    lowest: float
    highest: float
    why: str

    def since(self, earlier: Span) -> Span:
        """The time from another instant to this one."""
        return Span(
            self.truth - earlier.truth,
            self.lowest - earlier.highest,
            self.highest - earlier.lowest,
            f"{self.why}; since {earlier.why}",
        )

    def expected(self) -> Expected:
        """As the reference has it."""
        return Expected(
            truth=self.truth, lowest=self.lowest - TICK, highest=self.highest + TICK, why=self.why
        )


START = Span(0.0, 0.0, 0.0, "the start")


def seen(truth: float, what: str) -> Span:
    """An instant that is seen at the first sample after it, at most one interval late."""
    why = f"{what} at {truth:.4f} s, seen up to {INTERVAL:g} s later"
    return Span(truth, truth, truth + INTERVAL, why)


@dataclass(frozen=True, slots=True)
class Facts:
    """What happens in a run, as far as a ruleset wants to know; None = it does not."""

    touched: Span | None
    opened: Span | None
    closed: Span | None
    approached: Span | None
    left: Span | None
    stop: Span


def facts(run: ReferenceRun, rules: Rules) -> Facts:
    """What happens in a run."""
    opened, closed = _door(run)
    if run.timeout is None:
        assert closed is not None
        stop = closed
    else:
        stop = Span(run.timeout, run.timeout, run.timeout, f"the timeout at {run.timeout:g} s")
    return Facts(
        _touch(run), opened, closed, _approach(run, rules), _leaving(run, rules, stop), stop
    )


def _touch(run: ReferenceRun) -> Span | None:
    if not run.pulses:
        return None
    pulse = run.pulses[0]
    rise = math.asin(TOUCH / abs(pulse.peak)) * pulse.duration / math.pi
    return seen(pulse.begins + rise, f"the force passes {TOUCH:.2f} N")


def _door(run: ReferenceRun) -> tuple[Span | None, Span | None]:
    """When the door opens, and when it is closed again."""
    times = [t for t in run.times() if abs(run.angle(t)) >= CLOSED]
    if not times:
        return None, None
    half = COUNT / 2 if run.encoder else 0.0

    def passed(near: float, what: str) -> Span:
        early, truth, late = sorted(
            _passes(run, CLOSED + step, near) for step in (-half, 0.0, half)
        )
        rounding = ", half a count earlier or later" if half else ""
        why = f"{what} at {truth:.4f} s, seen up to {INTERVAL:g} s later{rounding}"
        return Span(truth, early, late + INTERVAL, why)

    opened = passed(times[0], "the door opens")
    last = times[-1]
    still_open = last == run.times()[-1]
    return opened, None if still_open else passed(last, "the door closes")


def _passes(run: ReferenceRun, angle: float, near: float) -> float:
    """When the panel passes an angle, near a time."""
    low, high = near - 2 * INTERVAL, near + 2 * INTERVAL
    rising = abs(run.angle(high)) > abs(run.angle(low))
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if (abs(run.angle(middle)) < angle) is rising else (low, middle)
    return low


def _approach(run: ReferenceRun, rules: Rules) -> Span | None:
    rises = [stay.since for stay in run.stays if stay.height > rules.present]
    words = f"more than {rules.present:g} m are under a sensor"
    return seen(min(rises), words) if rises else None


def _leaving(run: ReferenceRun, rules: Rules, stop: Span) -> Span | None:
    """When the robot leaves on its destination side; every run that leaves does so there."""
    falls = [stay.until for stay in run.stays if stay.height > rules.present]
    if not falls:
        return None
    assert max(falls) == max(s.until for s in run.stays if s.side is run.condition.destination_side)
    if run.panel_seen:
        return _masked_leaving(run, rules)
    if rules.to_end or max(falls) < stop.truth:
        return seen(max(falls), "the last sensor is free")
    return Span(stop.truth, stop.lowest, stop.highest, f"under a sensor until the stop: {stop.why}")


def _masked_leaving(run: ReferenceRun, rules: Rules) -> Span:
    """The robot leaves while all sensors are masked, and the panel closes above them.

    A masked sensor keeps its state until its mask ends, the last one at the smallest angle; or it
    counts as absent, the last one from where its mask begins.
    """
    thresholds = Thresholds()
    cw = run.condition.destination_side is Side.CW
    upper = thresholds.mask_to_cw if cw else thresholds.mask_to_ccw
    angle = min(upper) if rules.to_end else min(thresholds.mask_from)
    near = max(time for time in run.times() if abs(run.angle(time)) >= angle)
    what = "begins" if rules.to_end else "ends"
    words = f"the mask of the last sensor {what} with the panel at {angle:g} rad"
    return seen(_passes(run, angle, near), words)
