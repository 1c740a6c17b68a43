"""A run whose motion is known exactly, sampled with a phase and noise of its own, and its faults.

Minimum jerk from closed to 1.05 rad in 3 s, and back; a half sine of force; a robot that crosses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from msgspec.structs import replace as changed
from numpy.typing import NDArray

from scoring.assessment import Assessment
from scoring.indicator_table import RulesetName
from scoring.protocol import (
    PASSAGE_SENSORS,
    Condition,
    LockDetection,
    Outcome,
    Side,
    Strip,
    Thresholds,
)
from scoring.result import Ending, Result
from scoring.samples import DoorSample, HandleSample, PassageSample, Sample
from tests.scoring.runs import CONDITION, START

S = TypeVar("S", bound=Sample)
RATE = 50.0
COUNT = Thresholds().encoder_count
TIMEOUT = 14.5


@dataclass(frozen=True, slots=True)
class Motion:
    """What really happens, in s since the start, rad and N.

    Attributes:
        touch: the hand presses from then on.
        pull: how hard, N, for `pull_time`.
        opens: the panel begins to open.
        swing: how far, within `swing_time` each way.
        closes: it begins to close.
        tremble: of the open panel, 8 times a second.
        arrives, through: on the starting side; on the destination side, until `left`.
    """

    touch: float = 2.0
    pull: float = 40.0
    pull_time: float = 0.4
    opens: float = 2.5
    swing: float = 1.05
    swing_time: float = 3.0
    closes: float = 8.5
    arrives: float = 5.6
    through: float = 5.9
    left: float = 6.315
    tremble: float = 0.0

    def angle(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of the panel, rad."""

        def risen(since: float) -> NDArray[np.float64]:
            part = ((time - since) / self.swing_time).clip(0, 1)
            height: NDArray[np.float64] = 10 * part**3 - 15 * part**4 + 6 * part**5
            return height

        height = risen(self.opens) - risen(self.closes)
        trembling = self.tremble * np.sin(16 * np.pi * time)
        angle: NDArray[np.float64] = (self.swing + trembling) * height
        return angle

    def force(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """On the handle, N."""
        part = ((time - self.touch) / self.pull_time).clip(0, 1)
        return self.pull * np.sin(np.pi * part)


NOMINAL = Motion()


def clean(
    motion: Motion = NOMINAL, seed: int = 0, *, rate: float = RATE, noise: float = 0.05
) -> list[Sample]:
    """All samples of a run, each topic with a phase of its own, in the order in which they come."""
    random = np.random.RandomState(seed)
    samples: list[Sample] = []

    def times() -> NDArray[np.float64]:
        return np.arange(-1.5 + random.random_sample() / rate, TIMEOUT + 1.2, 1 / rate)

    time = times()
    begins = random.random_sample()  # where the encoder's first count begins
    angles = COUNT * (np.round(motion.angle(time) / COUNT + begins) - begins)
    samples += [
        DoorSample(START + t, START + t, float(a)) for t, a in zip(time, angles, strict=True)
    ]
    time = times()
    forces = motion.force(time) + noise * random.standard_normal(time.size)
    samples += [
        HandleSample(START + t, START + t, float(f)) for t, f in zip(time, forces, strict=True)
    ]
    for strip in Strip:
        used = {s.element for s in PASSAGE_SENSORS if s.strip is strip}
        here = (
            (motion.arrives, motion.through + 0.2)
            if strip.side is CONDITION.starting_side
            else (motion.through, motion.left)
        )
        for t in times():
            there = here[0] <= t < here[1]
            ranges = tuple(0.8 if there and e in used else 2.0 for e in range(4))
            samples.append(PassageSample(START + t, START + t, strip, ranges, 0.0, 2.5))
    return sorted(samples, key=lambda sample: sample.time)


BY_EVENT = Thresholds(start_uncertainty=0.0)
"""Of a robot that starts when the run does."""


def scored(
    samples: Sequence[Sample],
    ruleset: RulesetName = RulesetName.PROTOCOL,
    thresholds: Thresholds | None = None,
    condition: Condition = CONDITION,
) -> Result:
    """The result of a run that stops by itself, or at its timeout."""
    run = Assessment(
        condition,
        START,
        ruleset=ruleset,
        thresholds=thresholds or BY_EVENT,
        lock_detection=LockDetection.SETTLE,
    )
    for sample in samples:
        run.feed(sample)
    run.release(math.inf)
    done = run.procedure().completed
    ending = Ending(Outcome.COMPLETED, "all six steps done", done)
    if done is None or done > START + TIMEOUT:
        ending = Ending(Outcome.TIMEOUT, "time over", START + TIMEOUT)
    return run.result(ending)[0]


Fault = Callable[[list[Sample]], list[Sample]]


def each(kind: type[S], change: Callable[[float, S], Sample | None]) -> Fault:
    """Other samples of a kind, by time since the start and sample; None = the sample is lost."""

    def spoil(samples: list[Sample]) -> list[Sample]:
        spoilt = (change(s.time - START, s) if isinstance(s, kind) else s for s in samples)
        return [sample for sample in spoilt if sample is not None]

    return spoil


def door_fault(change: Callable[[float, float], float | None]) -> Fault:
    """Another door angle, by time since the start and angle; None = the sample is lost."""

    def spoil(time: float, sample: DoorSample) -> Sample | None:
        angle = change(time, sample.angle)
        return None if angle is None else changed(sample, angle=angle)

    return each(DoorSample, spoil)


def force_fault(change: Callable[[float, float], float]) -> Fault:
    """Another force, likewise."""
    return each(HandleSample, lambda t, s: changed(s, force=change(t, s.force)))


def passage_fault(
    side: Side, since: float, until: float, *, there: bool, elements: Sequence[int] = (3,)
) -> Fault:
    """Sensors of a strip see something, or nothing, in [since, until) s after the start."""
    strip, read = Strip.CW_RIGHT if side is Side.CW else Strip.CCW_LEFT, 0.8 if there else 2.0

    def spoil(time: float, sample: PassageSample) -> Sample:
        if sample.strip is not strip or not since <= time < until:
            return sample
        ranges = (read if n in elements else old for n, old in enumerate(sample.ranges))
        return changed(sample, ranges=tuple(ranges))

    return each(PassageSample, spoil)


def ranges_fault(side: Side, change: Callable[[float, float], float]) -> Fault:
    """Other ranges on a side, by time since the start and range."""

    def spoil(time: float, sample: PassageSample) -> Sample:
        ranges = tuple(change(time, distance) for distance in sample.ranges)
        return changed(sample, ranges=ranges) if sample.strip.side is side else sample

    return each(PassageSample, spoil)


def frozen(kind: type[Sample], since: float, until: float) -> Fault:
    """Samples that repeat the first value of [since, until) s, with stamps of their own."""

    def spoil(samples: list[Sample]) -> list[Sample]:
        held: dict[object, Sample] = {}

        def repeat(time: float, sample: Sample) -> Sample:
            first = held.setdefault(sample.signal, sample) if since <= time < until else sample
            return changed(first, time=sample.time, log_time=sample.log_time)

        return each(kind, repeat)(samples)

    return spoil


def stamped(kind: type[Sample], change: Callable[[float], float]) -> Fault:
    """Other stamps, s after the start, of samples that come as before."""
    return each(kind, lambda t, s: changed(s, time=START + change(t)))


def second_publisher(since: float, until: float, force: float) -> Fault:
    """Of the handle's force, that often too; each publisher counts its own messages."""

    def spoil(samples: list[Sample]) -> list[Sample]:
        handles = [sample for sample in samples if isinstance(sample, HandleSample)]
        mine = [changed(sample, sequence=1000 + n) for n, sample in enumerate(handles)]
        times = [s.time + 0.5 / RATE for s in handles if since <= s.time - START < until]
        others = [HandleSample(time, time, force, n) for n, time in enumerate(times, 1)]
        rest = [sample for sample in samples if not isinstance(sample, HandleSample)]
        return sorted([*mine, *others, *rest], key=lambda sample: sample.time)

    return spoil


def lost(since: float, until: float, kind: type[Sample] = DoorSample) -> Fault:
    """Samples of a kind that never came, in [since, until) s after the start."""
    return each(kind, lambda t, s: None if since <= t < until else s)


def late(kind: type[Sample], seconds: float) -> Fault:
    """Stamps of a kind that lie so long before they are received."""
    return each(kind, lambda _, s: changed(s, time=s.time - seconds))


def one_sample(index: int) -> tuple[float, float]:
    """An interval that holds one sample of each topic, s since the start."""
    return index / RATE, (index + 1) / RATE
