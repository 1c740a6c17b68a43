"""Hand-made runs for the tests of detector and procedure."""

from __future__ import annotations

import math
from collections.abc import Iterable

from scoring.assessment import Assessment
from scoring.events import EventDetector
from scoring.indicator_table import RulesetName
from scoring.protocol import (
    PASSAGE_SENSORS,
    BenchmarkType,
    Condition,
    LockDetection,
    PassageSensor,
    Side,
    Strip,
    Thresholds,
)
from scoring.rest import HandleRest
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample

START = 1_000_000.0
CONDITION = Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW)


def door(time: float, angle: float) -> DoorSample:
    return DoorSample(START + time, START + time, angle)


def handle(time: float, force: float) -> HandleSample:
    return HandleSample(START + time, START + time, force)


def resting(force: float, end: float = START, *, span: float = 0.2) -> HandleRest:
    """A second of a handle that nobody touches."""
    return HandleRest(50, force, span / 4, span, end - 0.98, end)


def latch(time: float, engaged: bool) -> LatchSample:
    return LatchSample(START + time, START + time, engaged)


def strip(time: float, which: Strip, heights: Iterable[float] = ()) -> PassageSample:
    """A strip that sees obstacles of these heights (m); what is not given sees the floor."""
    ranges = [2.0 - height for height in heights]
    ranges += [2.0] * (4 - len(ranges))
    return PassageSample(START + time, START + time, which, tuple(ranges), 0.0, 2.5)


def sensor(side: Side, index: int) -> PassageSensor:
    return next(s for s in PASSAGE_SENSORS if s.side is side and s.index == index)


def under(time: float, side: Side, index: int = 2, height: float = 1.2) -> PassageSample:
    """Something under one used sensor."""
    place = sensor(side, index)
    heights = [0.0] * 4
    heights[place.element] = height
    return strip(time, place.strip, heights)


def clear(time: float, side: Side, index: int = 2) -> PassageSample:
    """Nothing under the strip of one used sensor."""
    return strip(time, sensor(side, index).strip)


def detector(
    samples: Iterable[Sample],
    *,
    condition: Condition = CONDITION,
    zero: float = 0.0,
) -> EventDetector:
    found = EventDetector(condition, START, Thresholds(), zero)
    for sample in samples:
        found.feed(sample)
    return found


def assessment(
    samples: Iterable[Sample],
    *,
    lock: LockDetection = LockDetection.AUTO,
    ruleset: RulesetName = RulesetName.PROTOCOL,
    thresholds: Thresholds | None = None,
) -> Assessment:
    found = Assessment(
        CONDITION, START, ruleset=ruleset, lock_detection=lock, thresholds=thresholds
    )
    for sample in samples:
        found.feed(sample)
    found.release(math.inf)
    return found


def passage_through() -> list[Sample]:
    """A run from CCW to CW that completes: touch 2 s, open 3 s, through 5 s, closed 6 s."""
    return [
        door(-1.0, 0.0),
        handle(-1.0, 0.0),
        handle(2.0, 10.0),
        handle(2.5, 0.0),
        door(3.0, 0.5),
        under(4.0, Side.CCW),
        under(4.4, Side.CW),
        clear(4.6, Side.CCW),
        door(4.65, 0.5),
        clear(5.0, Side.CW),
        door(6.0, 0.0),
        door(7.0, 0.0),
    ]
