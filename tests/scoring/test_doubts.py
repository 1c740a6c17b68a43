"""What one bad sample does to a result, under each ruleset, and what is said of it (section 11).

How often an uncertainty holds the truth is tried in
`tests/madrob_console/testbeds/test_worth_of_numbers.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, partial

import numpy as np
import pytest
from msgspec.structs import replace as changed

from scoring.assessment import Assessment
from scoring.indicator_table import IndicatorName as Name
from scoring.protocol import Side, Thresholds
from scoring.result import Indicator, Result
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, Ruleset
from scoring.samples import DoorSample, HandleSample, PassageSample, Sample
from tests.scoring.clean_run import (
    RATE,
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


def seeded(make: Callable[[np.random.RandomState], Fault]) -> Fault:
    """The same numbers each time."""

    def spoil(samples: list[Sample]) -> list[Sample]:
        return make(np.random.RandomState(3))(samples)

    return spoil


def some_lost(part: float) -> Fault:
    return seeded(
        lambda random: door_fault(lambda _, a: None if random.random_sample() < part else a)
    )


JITTERED = seeded(
    lambda random: each(
        DoorSample,
        lambda _, s: changed(s, time=s.time + float(0.002 * random.standard_normal())),
    )
)


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
    "stamps jitter by 2 ms": (JITTERED, {SMOOTHNESS, UNSAFETY}),
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


RULES = (PROTOCOL, EUROBENCH_2020)
EACH = pytest.mark.parametrize("rules", RULES, ids=lambda rules: rules.name)
Scored = Callable[[str, Ruleset], Result]


@pytest.fixture(scope="module")
def score_of() -> Scored:
    """The result of a disturbance by its name; without one that of the clean run."""
    faults = {name: fault for name, (fault, _) in DISTURBANCES.items()}
    return cache(lambda case, rules: scored(faults.get(case, list)(clean()), rules))


def doubted(result: Result) -> set[Name]:
    return {name for name, indicator in result.indicators.items() if indicator.doubts}


@EACH
@pytest.mark.parametrize(
    "seeds", [range(4), pytest.param(range(4, 60), marks=pytest.mark.slow)], ids=["few", "many"]
)
def test_a_clean_run_has_no_doubts(rules: Ruleset, seeds: range) -> None:
    assert [doubted(scored(clean(seed=seed), rules)) for seed in seeds] == [set()] * len(seeds)


@pytest.mark.parametrize("case", DISTURBANCES)
def test_what_a_fault_spoils_is_doubted(case: str, score_of: Scored) -> None:
    result = score_of(case, PROTOCOL)
    assert DISTURBANCES[case][1] <= doubted(result)
    for indicator in result.indicators.values():
        assert all(words and words.isprintable() for words in indicator.doubts)
        assert not any("None" in words for words in indicator.doubts)


SLAM = Motion(swing_time=1.2, closes=8.0)
ALTERNATES = door_fault(lambda t, angle: angle + 0.5 * (int(t * RATE) % 2) * (6.0 < t < 8.0))


def coarse(step: float) -> Fault:
    return door_fault(lambda _, angle: round(angle / step) * step)


BLIND = each(PassageSample, lambda t, s: changed(s, ranges=(math.nan,) * 4) if 6.2 < t < 6.7 else s)
"""The passage sensors say nothing around the leaving."""
NOISE = seeded(
    lambda random: door_fault(
        lambda _, angle: round((angle + 0.001 * random.standard_normal()) / 0.001) * 0.001
    )
)
"""An encoder of steps of 1 mrad and as much noise."""


KNOCKS = [(0, 55, 78, 53, 46, 39, 1), (0, 22, 135, 139, 91, 73, 21)]
"""Forces when the real door's latch hit the frame, 20 ms apart, N."""


def knock(course: Sequence[float]) -> Fault:
    times = 9.0 + np.arange(len(course)) / RATE
    return force_fault(lambda t, force: force + float(np.interp(t, times, course, 0, 0)))


PRESSED = force_fault(lambda t, force: 5.0 if -0.02 <= t < 0 else force)
ROUNDED = force_fault(lambda _, force: round(force / 0.1) * 0.1)
NOISY = Thresholds(encoder_counts=round(math.tau / 0.001), encoder_noise=0.001)
COUNTS = {n: Thresholds(encoder_counts=n) for n in (720, 1800)}


@pytest.mark.parametrize(
    ("samples", "limits", "name", "words"),
    [
        (lambda: PRESSED(clean()), None, TOUCH, "rests on"),  # for one sample before the start
        (
            lambda: passage_fault(Side.CCW, 14.485, 14.51, there=True)(clean(Motion(closes=99.0))),
            None,
            LEVEL,
            "",
        ),
        (lambda: lost(8.9, 9.2)(clean(SLAM)), None, UNSAFETY, ""),
        (lambda: lost(8.9, 9.2)(clean(SLAM)), None, SMOOTHNESS, ""),
        (lambda: BLIND(clean()), None, OCCUPATION, ""),
        (lambda: lost(5.4, 5.9)(clean()), None, OCCUPATION, ""),  # it may be the panel
        (lambda: lost(2.7, 3.3)(clean()), None, OCCUPATION, "the door angle came too late for"),
        (lambda: spike(-0.06, 1.0)(clean()), None, UNSAFETY, ""),
        (lambda: ALTERNATES(clean()), None, UNSAFETY, "fits no motion"),
        (lambda: spike(6.0, 1e5)(clean()), None, UNSAFETY, ""),
        (
            lambda: spike(6.0, math.pi)(clean()),
            None,
            SMOOTHNESS,
            "the door angle is beyond 1.75 rad, which it cannot be, once, 6.01 s after the start",
        ),
        (lambda: spike(-3.0, 1e5)(clean()), None, SMOOTHNESS, None),
        (lambda: clean(Motion(tremble=0.0095), seed=1), None, UNSAFETY, None),  # it stands and goes
        (lambda: force_fault(lambda t, f: f - 5.5 * (t > 2.05))(clean()), None, TOUCH, None),
        *((lambda course=c: knock(course)(clean()), None, ROUGHNESS, None) for c in KNOCKS),
        (lambda: clean(noise=0.0), None, TOUCH, None),  # a silent load cell is not stuck
        (lambda: ROUNDED(clean(noise=0.015)), None, TOUCH, None),
        *(
            row
            for counts, known in COUNTS.items()
            for row in (
                (
                    lambda counts=counts: coarse(math.tau / counts)(clean()),
                    None,
                    SMOOTHNESS,
                    "another encoder: the door steps by",
                ),
                (lambda counts=counts: coarse(math.tau / counts)(clean()), known, SMOOTHNESS, None),
            )
        ),
        (
            lambda: NOISE(clean()),
            None,
            SMOOTHNESS,
            "another encoder: the door at rest varies by",
        ),
        (lambda: NOISE(clean()), NOISY, SMOOTHNESS, None),
    ],
)
def test_what_else_may_be_wrong_is_doubted_in_one_sentence(
    samples: Callable[[], list[Sample]], limits: Thresholds | None, name: Name, words: str | None
) -> None:
    doubts = scored(samples(), thresholds=limits).indicators[name].doubts
    told = [doubt for doubt in doubts if words is not None and words in doubt]
    assert len(told) == 1 if words else bool(told) == (words is not None)
    assert words is not None or doubts == ()


@pytest.mark.parametrize(("until", "words"), [(7.01, []), (7.03, ["3 of 809 samples"])])
def test_more_than_two_missing_samples_of_the_open_door_in_1000_are_a_doubt(
    until: float, words: list[str]
) -> None:
    losing = door_fault(lambda t, angle: None if 7.0 <= t < until else angle)
    doubts = scored(losing(clean(rate=100.0))).indicators[UNSAFETY].doubts
    end = " of the open door are missing"
    assert [doubt.removesuffix(end) for doubt in doubts if doubt.endswith(end)] == words


DISENGAGED = "the latch said disengaged when the door's rest completed the run"
LATE = "the latch spoke only after the start: the door's rest was the lock"


@pytest.mark.parametrize(
    ("states", "doubts"),
    [
        ([latch(-1, True), latch(2.4, False), latch(11.6, True)], ()),
        ([latch(-1, True), latch(2.4, False)], (DISENGAGED,)),
        ([latch(2.4, False)], (DISENGAGED,)),
        ([latch(2.4, False), latch(11.6, True)], (LATE,)),
    ],
)
def test_latch_against_a_settled_door_is_doubted(
    states: list[Sample], doubts: tuple[str, ...]
) -> None:
    result = scored([*clean(), *states])
    doubted = {name for name, one in result.indicators.items() if one.doubts}
    assert result.indicators[LEVEL].doubts == doubts
    assert doubted == ({LEVEL, EXECUTION} if doubts else set())


def test_where_most_samples_are_lost_the_usual_rate_is_the_testbed_s() -> None:
    losing = door_fault(lambda t, angle: angle if round(t * RATE) % 4 == 0 else None)
    doubts = scored(losing(clean())).indicators[UNSAFETY].doubts
    assert "306 of 408 samples of the open door are missing" in doubts


def test_the_more_a_signal_s_stamps_lie_behind_the_less_certain_is_a_time() -> None:
    delays = (0.0, 0.004, 0.01, 0.05)  # s; at most an interval of the signal counts
    runs = [scored(late(DoorSample, delay)(clean())) for delay in delays]
    known = [run.indicators[Name.PASSAGE_TIME].uncertainty for run in runs]
    assert [each and each.expanded for each in known] == [0.017, 0.019, 0.023, 0.03]


def test_the_noise_of_an_encoder_makes_smoothness_less_certain() -> None:
    known = scored(NOISE(clean()), thresholds=NOISY).indicators[SMOOTHNESS].uncertainty
    assert known is not None
    assert known.expanded > 0.1


REAL = {
    "door quivers about 0.03 rad": {SMOOTHNESS},
    "the door rests ajar by 20 mrad": {SMOOTHNESS, UNSAFETY},
    "handle's stamps 50 ms behind": {TOUCH},
    "zero drifts by 2.5 N before the touch": {ROUGHNESS},
}
"""What moves and is no fault by the rules: the door did move otherwise; no second topic tells that
all stamps of the handle are late; roughness is the force as it is, its rest stands beside it."""


@EACH
@pytest.mark.parametrize("case", DISTURBANCES)
def test_a_value_that_a_fault_moves_is_never_without_a_doubt(
    case: str, rules: Ruleset, score_of: Scored
) -> None:
    """Moved: by more than both uncertainties."""
    plain, spoilt = (score_of(name, rules).indicators for name in ("", case))
    real = REAL.get(case, set())
    moved = {name for name in Name if not agree(plain[name], spoilt[name])}
    assert not [name for name in moved - real if not spoilt[name].doubts]


def agree(one: Indicator, other: Indicator) -> bool:
    if one.value is None or other.value is None:
        return one.value is other.value
    worth = [v.uncertainty.expanded if v.uncertainty else 0.0 for v in (one, other)]
    return abs(one.value - other.value) <= math.hypot(*worth) + 1e-9


def test_a_touch_that_did_not_hold_is_doubted_while_the_run_goes_on() -> None:
    run = Assessment(CONDITION, START)
    doubted_at = []
    for number, sample in enumerate(DISTURBANCES["one force sample of 5 N"][0](clean())):
        run.feed(sample)
        if number % 10 == 0 and TOUCH in run.provisional_doubts():
            doubted_at.append(sample.time - START)
    assert 0.5 < doubted_at[0] < 0.8
    assert doubted_at[-1] == pytest.approx(15.7, abs=0.1)  # until the recording ends
    assert "the touch of the handle rests on 1 sample" in run.provisional_doubts()[TOUCH]


WILD = door_fault(lambda t, _: 1.7e308 if int(t * RATE) % 2 else -1.7e308)


@pytest.mark.parametrize(
    "fault",
    [*(kind(7.0, v) for kind in (spike, force_spike) for v in (1e160, 1e200, -1.7e308)), WILD],
)
def test_numbers_that_only_the_published_rules_believe_lose_no_result(fault: Fault) -> None:
    result = scored(fault(clean()), EUROBENCH_2020)
    assert list(result.indicators) == list(Name)
    assert all(indicator.text for indicator in result.indicators.values())
    known = [one.uncertainty for one in result.indicators.values() if one.uncertainty is not None]
    assert all(math.isfinite(one.expanded) for one in known)


@pytest.mark.parametrize(
    ("rules", "rate"), [*((rules, rate) for rules in RULES for rate in (5.0, 9.0)), (PROTOCOL, 400)]
)
def test_a_rate_far_from_the_testbeds_loses_no_result(rules: Ruleset, rate: float) -> None:
    assert SMOOTHNESS in doubted(scored(clean(rate=rate), rules))


@pytest.mark.parametrize("case", DISTURBANCES)
def test_doubts_change_no_value(
    case: str, score_of: Scored, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scoring.assessment.all_doubts", lambda *_: {})
    plain = scored(DISTURBANCES[case][0](clean()))
    monkeypatch.undo()
    assert not doubted(plain)
    results = score_of(case, PROTOCOL), plain
    with_doubts, without = ([one.indicators[name].value for name in Name] for one in results)
    assert with_doubts == without


@pytest.mark.parametrize("value", [1e6, -600.0, math.inf, math.nan])
def test_an_impossible_force_is_no_reading_but_for_eurobench(
    value: float, score_of: Scored
) -> None:
    spoilt = force_spike(1.0, value)(clean())
    plain, result = score_of("", PROTOCOL).indicators, scored(spoilt)
    for name in (ROUGHNESS, TOUCH):
        assert result.indicators[name].value == plain[name].value
    handle = result.quality.signals[1]
    assert (handle.no_reading, handle.impossible) == (1, int(math.isfinite(value)))
    published = scored(spoilt, EUROBENCH_2020).indicators[ROUGHNESS].value
    assert published == abs(value) or not math.isfinite(value)


def test_an_impossible_angle_opens_no_door() -> None:
    result = scored(spike(1.0, 1e5)(clean()))
    assert result.indicators[LEVEL].value == 6
    assert float(result.indicators[UNSAFETY].value or 0) < 1
    assert "1 of them impossible" in " ".join(result.quality.remarks)


def test_the_limits_are_settings() -> None:
    result = scored(force_spike(1.0, 900.0)(clean()), thresholds=Thresholds(largest_force=500.0))
    assert result.indicators[ROUGHNESS].value == 900.0


def test_a_freeze_in_motion_is_doubted() -> None:
    moving = clean(Motion(swing_time=2.0))
    assert {SMOOTHNESS, UNSAFETY} <= doubted(scored(frozen(DoorSample, 3.5, 3.61)(moving)))
