"""What a fault of sensors, clocks or people makes doubtful (protocol section 11)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from msgspec.structs import replace as changed

from scoring.assessment import Assessment
from scoring.indicator_table import IndicatorName as Name
from scoring.indicator_table import RulesetName
from scoring.protocol import Side, Thresholds
from scoring.result import Result
from scoring.samples import DoorSample, HandleSample, PassageSample, Sample
from tests.scoring.clean_run import (
    RATE,
    TIMEOUT,
    Fault,
    Motion,
    clean,
    door_fault,
    each,
    force_fault,
    frozen,
    late,
    lost,
    one_sample,
    passage_fault,
    ranges_fault,
    scored,
    second_publisher,
    stamped,
)
from tests.scoring.runs import CONDITION, START, latch

LEVEL, EXECUTION, TOUCH = Name.CAPABILITY_LEVEL, Name.EXECUTION_TIME, Name.TIME_TO_HANDLE
OCCUPATION, PASSAGE = Name.DOOR_OCCUPATION_TIME, Name.PASSAGE_TIME
UNSAFETY, SMOOTHNESS = Name.UNSAFETY_OF_DOOR_OPERATION, Name.SMOOTHNESS_OF_DOOR_ACTUATION
ROUGHNESS = Name.ROUGHNESS_OF_DOOR_ACTUATION


def spike(at: float, value: float, of: Callable[..., Fault] = door_fault) -> Fault:
    since, until = one_sample(round(at * RATE))
    return of(lambda t, number: value if since <= t < until else number)


force_spike = partial(spike, of=force_fault)


def some_lost(part: float) -> Fault:
    def spoil(samples: list[Sample]) -> list[Sample]:
        random = np.random.RandomState(3)
        return door_fault(lambda _, a: None if random.random_sample() < part else a)(samples)

    return spoil


def strip_stands_still(since: float, until: float) -> Fault:
    """Noisy strips, of which the destination's say the same for a while."""
    noise = np.random.RandomState(5)

    def spoil(samples: list[Sample]) -> list[Sample]:
        noisy = [
            changed(s, ranges=tuple(r - 0.001 * noise.random_sample() for r in s.ranges))
            if isinstance(s, PassageSample)
            else s
            for s in samples
        ]
        held: dict[object, tuple[float, ...]] = {}

        def still(time: float, sample: PassageSample) -> Sample:
            if sample.strip.side is Side.CW and since <= time < until:
                return changed(sample, ranges=held.setdefault(sample.strip, sample.ranges))
            return sample

        return each(PassageSample, still)(noisy)

    return spoil


def torn(samples: list[Sample]) -> list[Sample]:
    return [sample for sample in samples if sample.time < START + 10.0]


def with_latch(*states: tuple[float, bool]) -> Fault:
    """A latch that the run's lock does not heed."""
    return lambda samples: sorted(
        [*samples, *(latch(time, engaged) for time, engaged in states)],
        key=lambda sample: sample.time,
    )


FAULTS: dict[str, tuple[Fault, set[Name], str]] = {
    "one force sample": (force_spike(0.5, 5.0), {TOUCH, PASSAGE, LEVEL}, "rests on 1 sample"),
    "pressed for two samples": (
        force_fault(lambda t, force: 5.0 if 0.5 <= t < 0.54 else force),
        {TOUCH, PASSAGE, LEVEL},
        "the touch of the handle rests on 2 samples: was it real?",
    ),
    "angle jumps": (spike(7.0, 0.5), {SMOOTHNESS, UNSAFETY}, "door angle jumped or froze (0.55"),
    "angle jumps while closed": (
        spike(11.7, 0.5),
        {SMOOTHNESS, UNSAFETY, EXECUTION, PASSAGE, LEVEL},
        "the last closing of the door rests on 1 sample",
    ),
    "door freezes while it opens": (frozen(DoorSample, 2.5, 3.0), {UNSAFETY}, "jumped or froze"),
    "door freezes for good": (
        frozen(DoorSample, 9.9, 99.0),
        {SMOOTHNESS, UNSAFETY, PASSAGE, LEVEL},
        "did the sensor freeze?",
    ),
    "door freezes while it is closed": (
        frozen(DoorSample, 0.5, 99.0),
        {SMOOTHNESS, UNSAFETY, EXECUTION, PASSAGE, LEVEL},
        "somebody passed, but the door never opened: did its sensor freeze?",
    ),
    "door freezes for good and masks who passes": (
        frozen(DoorSample, 3.4, 99.0),
        {SMOOTHNESS, UNSAFETY, PASSAGE, OCCUPATION, LEVEL},
        "did the sensor freeze?",
    ),
    "20 % of door samples lost": (some_lost(0.2), {SMOOTHNESS}, "samples of the door angle are"),
    "door lost over its closing": (
        lost(11.0, 11.3),
        {EXECUTION, PASSAGE, LEVEL, SMOOTHNESS},
        "door angle: no new reading for 0.3",
    ),
    "door lost over the arrival": (lost(5.4, 5.9), {OCCUPATION}, "door angle: no new reading"),
    "force lost before the touch": (
        lost(1.0, 1.5, HandleSample),
        {TOUCH, PASSAGE, LEVEL, ROUGHNESS},
        "handle force: no new reading for 0.5",
    ),
    "force stands still at its peak": (
        frozen(HandleSample, 2.1, 2.3),
        {ROUGHNESS},
        "handle force: no new reading",
    ),
    "strip stands still for 0.3 s": (
        strip_stands_still(5.8, 6.1),
        {OCCUPATION, LEVEL},
        "no new reading for 0.3",
    ),
    "side says NaN": (
        ranges_fault(Side.CW, lambda t, r: math.nan if t > 6.1 else r),
        {OCCUPATION, LEVEL},
        "no new reading",
    ),
    "the recording lacks its end": (torn, {*Name} - {TOUCH}, "of the run are not in the recording"),
    "person early on the starting side": (
        ranges_fault(Side.CCW, lambda t, r: 0.3 if 0.5 < t < 1.5 else r),
        {OCCUPATION},
        "was somebody else there, or did the robot turn?",
    ),
    "person late on the destination side": (
        ranges_fault(Side.CW, lambda t, r: 0.3 if 9.5 < t < 10.5 else r),
        {OCCUPATION, EXECUTION, PASSAGE, LEVEL},
        "was somebody else there, or did the robot turn?",
    ),
    "starting side seen once more": (
        passage_fault(Side.CCW, *one_sample(375), there=True),
        {LEVEL, EXECUTION, OCCUPATION, PASSAGE},
        "the leaving of the passage sensors is not of the passage",
    ),
    "one side sees nothing": (
        ranges_fault(Side.CW, lambda _, __: 2.0),
        {LEVEL, EXECUTION, OCCUPATION, PASSAGE},
        "are the CW sensors dead?",
    ),
    "zero of the door 28 mrad off": (
        door_fault(lambda _, angle: angle + 0.028),
        {EXECUTION, PASSAGE, LEVEL, SMOOTHNESS, UNSAFETY},
        "the closed door read +28",
    ),
    "door rests ajar": (
        door_fault(lambda t, angle: max(angle, 0.02) if t > 9 else angle),
        {EXECUTION, LEVEL},
        "from where it was: ajar?",
    ),
    "zero of the handle drifts": (
        force_fault(lambda t, f: f + (1.5 if t > 0.5 else 0.0)),
        {TOUCH},
        "the handle read +1.5 N before its touch",
    ),
    "handle zeroed in the run": (
        force_fault(lambda t, f: f - 60.0 * (t > 5)),
        {ROUGHNESS},
        "was it zeroed in between?",
    ),
    "half the angle": (
        door_fault(lambda _, angle: angle / 2),
        {SMOOTHNESS, UNSAFETY},
        "is the encoder another one",
    ),
    "force clipped": (
        force_fault(lambda _, f: min(f, 20.0)),
        {ROUGHNESS},
        "is the load cell at its end?",
    ),
    "end of the load cell": (
        force_fault(lambda t, f: f + 160 * (2.1 < t < 2.3)),
        {ROUGHNESS},
        "the load cell's range ends at 196 N",
    ),
    "clock of the door steps back": (
        stamped(DoorSample, lambda t: t - 0.3 if t > 7 else t),
        {PASSAGE, SMOOTHNESS},
        "door angle: its clock stepped or ran away by 0.30 s",
    ),
    "handle 50 ms behind": (late(HandleSample, 0.05), {PASSAGE}, "do their clocks agree?"),
    "a second publisher": (
        second_publisher(1.9, 2.3, 60.0),
        {ROUGHNESS, TOUCH},
        "another publisher, or one started again",
    ),
    "latch says disengaged": (
        with_latch((-1.0, True), (2.2, False)),
        {EXECUTION, LEVEL},
        "the latch said disengaged",
    ),
    "latch speaks late": (
        with_latch((2.2, False), (11.0, True)),
        {EXECUTION, LEVEL},
        "the latch spoke only after the start",
    ),
}


def doubted(result: Result) -> set[Name]:
    return {name for name, indicator in result.indicators.items() if indicator.doubts}


@pytest.mark.parametrize("case", FAULTS)
def test_what_a_fault_spoils_is_doubted(case: str) -> None:
    fault, names, words = FAULTS[case]

    result = scored(fault(clean()))

    assert names <= doubted(result)
    assert any(words in doubt for doubt in result.doubts), result.doubts


@pytest.mark.parametrize("seed", range(6))
def test_a_clean_run_has_no_doubts(seed: int) -> None:
    assert scored(clean(seed=seed)).doubts == {}


def knock(time: float) -> float:
    """Force when the real door's latch hit the frame, N."""
    course = (0, 22, 135, 139, 91, 73, 21)
    return float(np.interp(time, 9 + np.arange(7) / RATE, course, 0, 0))


HARMLESS: dict[str, Fault] = {
    "continuous angle": door_fault(lambda t, _: float(Motion().angle(np.array(t)))),
    "force in coarse steps": force_fault(lambda _, force: round(force / 0.1) * 0.1),
    "knock of the latch": force_fault(lambda t, force: force + knock(t)),
    "handle 10 ms behind": late(HandleSample, 0.01),
}


@pytest.mark.parametrize("case", HARMLESS)
def test_what_moves_no_value_is_not_doubted(case: str) -> None:
    assert scored(HARMLESS[case](clean())).doubts == {}


def test_doubts_change_no_value() -> None:
    jumped = spike(11.7, 0.5)(clean())
    values = scored(jumped).indicators
    assert values[SMOOTHNESS].doubts
    assert values[TOUCH].value == scored(clean()).indicators[TOUCH].value


def test_a_brake_at_the_end_of_the_range_is_no_doubt() -> None:
    strong = clean(Motion(pull=196.0))
    sudden_ramp = CONDITION.from_number(4)
    assert scored(strong).indicators[ROUGHNESS].doubts
    result = scored(strong, condition=sudden_ramp)
    assert not result.indicators[ROUGHNESS].doubts
    assert any("where the load cell's range and the brake end" in r for r in result.quality.remarks)


def test_a_touch_that_did_not_hold_is_doubted_live() -> None:
    run = Assessment(CONDITION, START, thresholds=Thresholds())
    for sample in force_spike(0.5, 5.0)(clean()):
        if sample.time < START + 1.0:
            run.feed(sample)
            run.release(sample.time)
    assert set(run.provisional_doubts()) == {TOUCH, PASSAGE, LEVEL}


def test_the_rules_of_2020_have_no_doubts() -> None:
    assert scored(spike(7.0, 0.5)(clean()), RulesetName.EUROBENCH_2020).doubts == {}


def test_an_impossible_force_is_a_reading_in_2020_alone() -> None:
    samples = force_spike(4.0, 1e6)(clean())
    assert scored(samples).indicators[ROUGHNESS].value == pytest.approx(40.0, abs=0.3)
    by_2020 = scored(samples, RulesetName.EUROBENCH_2020).indicators[ROUGHNESS]
    assert by_2020.value == 1e6


def test_a_timeout_while_open_is_not_doubted() -> None:
    result = scored(clean(Motion(closes=99.0)))
    assert result.stop == START + TIMEOUT
    assert result.doubts == {}
