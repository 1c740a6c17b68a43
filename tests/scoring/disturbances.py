"""Disturbances of a recording, and the indicators that each of them spoils (section 11)."""

from __future__ import annotations

import math

import numpy as np

from scoring.indicator_table import IndicatorName as Name
from scoring.protocol import Side
from scoring.samples import DoorSample, HandleSample, Sample
from tests.scoring.clean_run import (
    RATE,
    Fault,
    door_fault,
    each,
    force_fault,
    frozen,
    late,
    lost,
    one_sample,
    passage_fault,
    ranges_fault,
    second_publisher,
    stamped,
)

LEVEL, EXECUTION, TOUCH = Name.CAPABILITY_LEVEL, Name.EXECUTION_TIME, Name.TIME_TO_HANDLE
OCCUPATION, PASSAGE = Name.DOOR_OCCUPATION_TIME, Name.PASSAGE_TIME
UNSAFETY, SMOOTHNESS = Name.UNSAFETY_OF_DOOR_OPERATION, Name.SMOOTHNESS_OF_DOOR_ACTUATION
ROUGHNESS = Name.ROUGHNESS_OF_DOOR_ACTUATION


def spike(at: float, value: float) -> Fault:
    since, until = one_sample(round(at * RATE))
    return door_fault(lambda t, angle: value if since <= t < until else angle)


def force_spike(at: float, value: float) -> Fault:
    since, until = one_sample(round(at * RATE))
    return force_fault(lambda t, force: value if since <= t < until else force)


def some_lost(part: float) -> Fault:
    def spoil(samples: list[Sample]) -> list[Sample]:
        random = np.random.RandomState(3)  # the same ones each time
        losing = door_fault(lambda _, angle: None if random.random_sample() < part else angle)
        return losing(samples)

    return spoil


def jittered(deviation: float) -> Fault:
    def spoil(samples: list[Sample]) -> list[Sample]:
        normal = np.random.RandomState(4).standard_normal
        moved = each(
            DoorSample,
            lambda _, s: DoorSample(s.time + float(deviation * normal()), s.log_time, s.angle),
        )
        return moved(samples)

    return spoil


def quivering(t: float, angle: float) -> float:
    """Closed, but one count about 0.03 rad for 1 s."""
    return (0.0305 if int(t * RATE) % 2 else 0.0288) if 12.0 < t < 13.0 else angle


DISTURBANCES: dict[str, tuple[Fault, set[Name]]] = {
    "one sample on the starting side after the crossing": (
        passage_fault(Side.CCW, *one_sample(375), there=True),
        {LEVEL, EXECUTION, OCCUPATION, PASSAGE},
    ),
    "one sample on the destination side before": (
        passage_fault(Side.CW, *one_sample(50), there=True),
        {OCCUPATION},
    ),
    "one sample on the starting side at 1 s": (
        passage_fault(Side.CCW, *one_sample(50), there=True),
        {OCCUPATION},
    ),
    "one force sample of 5 N": (force_spike(0.5, 5.0), {TOUCH, PASSAGE, LEVEL}),
    "one angle spike of 0.5 rad": (spike(7.0, 0.5), {SMOOTHNESS, UNSAFETY}),
    "one angle spike after the closing": (
        spike(11.7, 0.5),
        {SMOOTHNESS, UNSAFETY, EXECUTION, PASSAGE, LEVEL},
    ),
    "5 % of door samples lost": (some_lost(0.05), {SMOOTHNESS, UNSAFETY}),
    "1 % of door samples lost": (some_lost(0.01), {SMOOTHNESS, UNSAFETY}),
    "stamps jitter by 2 ms": (jittered(0.002), {SMOOTHNESS, UNSAFETY}),
    "force clipped at 20 N": (force_fault(lambda _, f: min(f, 20.0)), {ROUGHNESS}),
    "force stuck after the touch": (
        force_fault(lambda t, f: f if t < 2.1 else 11.0),
        {ROUGHNESS, TOUCH},
    ),
    "force lost for 80 ms at its peak": (lost(2.17, 2.25, HandleSample), {ROUGHNESS}),
    "zero drifts by 2.5 N before the touch": (
        force_fault(lambda t, f: f + (2.5 if t > 1 else 0.0)),
        {TOUCH},
    ),
    "door quivers about 0.03 rad": (door_fault(quivering), {EXECUTION, PASSAGE}),
    "door lost over its closing": (lost(11.0, 11.3), {EXECUTION, PASSAGE, LEVEL}),
    "a strip of the starting side for 60 ms after the crossing": (
        passage_fault(Side.CCW, 7.5, 7.56, there=True, elements=range(4)),
        {LEVEL, EXECUTION, OCCUPATION, PASSAGE},
    ),
    "a strip of the starting side for 140 ms after the crossing": (
        passage_fault(Side.CCW, 7.5, 7.64, there=True, elements=range(4)),
        {LEVEL, EXECUTION, OCCUPATION, PASSAGE},
    ),
    "a person on the starting side early": (
        ranges_fault(Side.CCW, lambda t, r: 0.3 if 0.5 < t < 1.5 else r),
        {OCCUPATION},
    ),
    "a person on the destination side at the end": (
        ranges_fault(Side.CW, lambda t, r: 0.3 if 9.5 < t < 10.5 else r),
        {OCCUPATION},
    ),
    "the destination side sees nothing": (
        ranges_fault(Side.CW, lambda _, __: 2.0),
        {LEVEL, EXECUTION, OCCUPATION, PASSAGE},
    ),
    "no echo is said by NaN": (
        ranges_fault(Side.CW, lambda _, r: math.nan if r == 2.0 else r),
        {LEVEL, OCCUPATION},
    ),
    "no echo is said by 0": (
        ranges_fault(Side.CW, lambda _, r: -0.1 if r == 2.0 else r),
        {LEVEL, OCCUPATION},
    ),
    "a side reads NaN from then on": (
        ranges_fault(Side.CW, lambda t, r: math.nan if t > 6.1 else r),
        {OCCUPATION, LEVEL},
    ),
    "the force stands still for 0.2 s at its peak": (
        frozen(HandleSample, 2.1, 2.3),
        {ROUGHNESS, TOUCH},
    ),
    "the door stands still for 0.4 s as it opens": (frozen(DoorSample, 2.5, 3.0), {UNSAFETY}),
    "the door is read at 45 Hz for 2 s": (
        stamped(DoorSample, lambda t: t + 0.1 * min(max((t - 2.5) / 1.0, 0.0), 1.0)),
        set(),
    ),
    "zero of the door 28 mrad off": (
        door_fault(lambda _, angle: angle + 0.028),
        {EXECUTION, PASSAGE, LEVEL, SMOOTHNESS},
    ),
    "zero of the door 40 mrad off": (
        door_fault(lambda _, angle: angle + 0.040),
        {EXECUTION, PASSAGE, LEVEL, SMOOTHNESS},
    ),
    "the door rests ajar by 20 mrad": (
        door_fault(lambda t, angle: max(angle, 0.02) if t > 9 else angle),
        {EXECUTION, LEVEL},
    ),
    "half the angle": (door_fault(lambda _, angle: angle / 2), {SMOOTHNESS, UNSAFETY}),
    "a second publisher of the force": (second_publisher(1.9, 2.3, 60.0), {ROUGHNESS, TOUCH}),
    "the door's clock steps by 0.3 s": (
        stamped(DoorSample, lambda t: t + 0.3 if t > 7 else t),
        {PASSAGE},
    ),
    "the door's clock steps back by 0.3 s": (
        stamped(DoorSample, lambda t: t - 0.3 if t > 7 else t),
        {PASSAGE},
    ),
    "one stamp of the door 0.3 s ahead": (
        stamped(DoorSample, lambda t: t + 0.3 if 3.5 < t < 3.52 else t),
        set(),
    ),
    "handle's stamps 50 ms behind": (late(HandleSample, 0.05), {PASSAGE}),
}
