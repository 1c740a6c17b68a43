"""What one bad sample does to a result, under each ruleset, and what is said of it (section 11)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace as changed

from scoring.assessment import Assessment
from scoring.indicator_table import IndicatorName as Name
from scoring.protocol import Side, Thresholds
from scoring.result import Indicator, Result
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, Ruleset
from scoring.samples import DoorSample, PassageSample, Sample
from tests.scoring.clean_run import (
    RATE,
    Fault,
    Motion,
    clean,
    door_fault,
    force_fault,
    lost,
    passage_fault,
    scored,
)
from tests.scoring.disturbances import (
    DISTURBANCES,
    LEVEL,
    OCCUPATION,
    ROUGHNESS,
    SMOOTHNESS,
    TOUCH,
    UNSAFETY,
    force_spike,
    spike,
)
from tests.scoring.runs import CONDITION, START

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


def blind(samples: list[Sample]) -> list[Sample]:
    """The passage sensors say nothing around the leaving."""
    return [
        changed(s, ranges=(math.nan,) * 4)
        if isinstance(s, PassageSample) and 6.2 < s.time - START < 6.7
        else s
        for s in samples
    ]


def coarse(step: float) -> Fault:
    return door_fault(lambda _, angle: round(angle / step) * step)


def noisy(samples: list[Sample]) -> list[Sample]:
    """An encoder of steps of 1 mrad and as much noise."""
    random = np.random.RandomState(5)
    return door_fault(
        lambda _, angle: round((angle + 0.001 * random.standard_normal()) / 0.001) * 0.001
    )(samples)


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
        (lambda: blind(clean()), None, OCCUPATION, ""),
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
            lambda: noisy(clean()),
            None,
            SMOOTHNESS,
            "another encoder: the door at rest varies by",
        ),
        (lambda: noisy(clean()), NOISY, SMOOTHNESS, None),
    ],
)
def test_what_else_may_be_wrong_is_doubted_in_one_sentence(
    samples: Callable[[], list[Sample]], limits: Thresholds | None, name: Name, words: str | None
) -> None:
    doubts = scored(samples(), thresholds=limits).indicators[name].doubts
    told = [doubt for doubt in doubts if words is not None and words in doubt]
    assert len(told) == 1 if words else bool(told) == (words is not None)
    assert words is not None or doubts == ()


def test_the_noise_of_an_encoder_makes_smoothness_less_certain() -> None:
    known = scored(noisy(clean()), thresholds=NOISY).indicators[SMOOTHNESS].uncertainty
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
    samples = clean(Motion(swing_time=2.0))
    first = next(s for s in samples if isinstance(s, DoorSample) and s.time >= START + 3.5)
    frozen = door_fault(
        lambda t, angle: first.angle if 3.5 <= t < first.time - START + 0.1 else angle
    )(samples)
    assert {SMOOTHNESS, UNSAFETY} <= doubted(scored(frozen))
