"""What one bad sample does to a result, under each ruleset, and what is said of it (section 11)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace as changed

from scoring.evaluate import Assessment
from scoring.indicator_table import IndicatorName as Name
from scoring.procedure import Ruling
from scoring.protocol import EventName, Outcome, Side, Step, Thresholds
from scoring.result import Ending, Indicator, Result
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, ROBUST_2026, Ruleset, ruleset
from scoring.signals import DoorSample, PassageSample, Sample
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
    EXECUTION,
    LEVEL,
    OCCUPATION,
    PASSAGE,
    ROUGHNESS,
    SMOOTHNESS,
    TOUCH,
    UNSAFETY,
    force_spike,
    spike,
)
from tests.scoring.runs import CONDITION, START


def doubted(result: Result) -> set[Name]:
    return {name for name, indicator in result.indicators.items() if indicator.doubts}


def test_a_clean_run_has_no_doubts() -> None:
    for seed in range(20):
        for rules in (PROTOCOL, EUROBENCH_2020, ROBUST_2026):
            result = scored(clean(seed=seed), rules)
            assert not doubted(result), result.indicators


@pytest.mark.parametrize("case", DISTURBANCES)
def test_what_a_fault_spoils_is_doubted(case: str) -> None:
    fault, expected = DISTURBANCES[case]
    result = scored(fault(clean()))
    assert expected <= doubted(result)
    for indicator in result.indicators.values():
        assert all(words and words.isprintable() for words in indicator.doubts)


REAL = {"door quivers about 0.03 rad": {SMOOTHNESS}, "handle's stamps 50 ms behind": {TOUCH}}
"""What moves and is no fault by the rules: a door that does quiver is less smooth; no second topic
tells that all stamps of the handle are late."""
STAYS_OPEN = {EXECUTION, PASSAGE}
"""A door that quivers is not closed under rules with a hysteresis."""


@pytest.mark.parametrize("rules", [PROTOCOL, EUROBENCH_2020, ROBUST_2026], ids=lambda r: r.name)
def test_a_value_that_a_fault_moves_is_never_without_a_doubt(rules: Ruleset) -> None:
    """Moved: by more than both uncertainties. With `-s` it prints what moves."""
    plain = scored(clean(), rules).indicators
    print(f"\n| {rules.name}: disturbance | moves |\n| -- | -- |")
    for case, (fault, _) in DISTURBANCES.items():
        spoilt = scored(fault(clean()), rules).indicators
        moved = {name for name in Name if not agree(plain[name], spoilt[name])}
        told = (
            f"{name} {plain[name].text} -> {spoilt[name].text}" for name in Name if name in moved
        )
        print(f"| {case} | {'; '.join(told)} |")
        real = REAL.get(case, set())
        if rules is ROBUST_2026 and SMOOTHNESS in real:
            real = real | STAYS_OPEN
        assert not [n for n in moved - real if not spoilt[n].doubts], case


def agree(one: Indicator, other: Indicator) -> bool:
    if one.value is None or other.value is None:
        return one.value is other.value
    worth = [v.uncertainty.expanded if v.uncertainty else 0.0 for v in (one, other)]
    return abs(one.value - other.value) <= math.hypot(*worth) + 1e-9


@pytest.mark.parametrize(
    "case",
    [
        "one sample on the starting side after the crossing",
        "one sample on the destination side before",
        "one sample on the starting side at 1 s",
        "one force sample of 5 N",
    ],
)
def test_one_bad_sample_turns_no_decision_of_the_robust_rules(case: str) -> None:
    samples = clean()
    plain, spoilt = (
        scored(samples, ROBUST_2026),
        scored(DISTURBANCES[case][0](samples), ROBUST_2026),
    )
    for name in (LEVEL, EXECUTION, TOUCH, OCCUPATION, PASSAGE):
        assert spoilt.indicators[name].value == pytest.approx(
            plain.indicators[name].value, abs=0.05
        )
    assert spoilt.indicators[LEVEL].value == 6


def test_a_quivering_door_opens_once_under_the_robust_rules() -> None:
    spoilt = DISTURBANCES["door quivers about 0.03 rad"][0](clean())
    openings = [
        sum(event.event is EventName.DOOR_OPENS for event in scored(spoilt, rules).events)
        for rules in (PROTOCOL, ROBUST_2026)
    ]
    assert openings[0] > 20
    assert openings[1] == 1


def test_a_touch_that_did_not_hold_is_doubted_while_the_run_goes_on() -> None:
    run = Assessment(CONDITION, START)
    doubted_at = []
    for sample in DISTURBANCES["one force sample of 5 N"][0](clean()):
        run.feed(sample)
        if TOUCH in run.provisional_doubts():
            doubted_at.append(sample.time - START)
    assert 0.5 < doubted_at[0] < 0.8
    assert doubted_at[-1] == pytest.approx(15.7, abs=0.1)  # until the recording ends
    assert "the touch of the handle rests on 1 sample" in run.provisional_doubts()[TOUCH]


@pytest.mark.parametrize("value", [1e160, 1e200, -1.7e308])
@pytest.mark.parametrize("kind", [spike, force_spike])
def test_numbers_that_only_the_published_rules_believe_lose_no_result(
    kind: Callable[[float, float], Fault], value: float
) -> None:
    result = scored(kind(7.0, value)(clean()), EUROBENCH_2020)
    for indicator in result.indicators.values():
        assert indicator.text
        if indicator.uncertainty is not None:
            assert math.isfinite(indicator.uncertainty.expanded)


def test_angles_that_alternate_beyond_all_bounds_lose_no_result() -> None:
    wild = door_fault(lambda t, _: 1.7e308 if int(t * RATE) % 2 else -1.7e308)
    assert len(scored(wild(clean()), EUROBENCH_2020).indicators) == len(Name)


@pytest.mark.parametrize("rules", [PROTOCOL, EUROBENCH_2020, ROBUST_2026], ids=lambda r: r.name)
@pytest.mark.parametrize("rate", [5.0, 9.0, 400.0])
def test_a_rate_far_from_the_testbeds_loses_no_result(rules: Ruleset, rate: float) -> None:
    result = scored(clean(rate=rate), rules)
    assert SMOOTHNESS in doubted(result)


def test_a_force_that_is_up_for_one_sample_before_the_start_is_doubted() -> None:
    pressed = force_fault(lambda t, force: 5.0 if -0.02 <= t < 0 else force)
    assert TOUCH in doubted(scored(pressed(clean())))


def test_one_sample_over_the_stop_is_doubted() -> None:
    never_closed = clean(Motion(closes=99.0))
    over_the_stop = passage_fault(Side.CCW, 14.485, 14.51, there=True)
    assert LEVEL in doubted(scored(over_the_stop(never_closed)))


def test_a_slam_that_falls_into_a_gap_is_doubted() -> None:
    slam = clean(Motion(swing_time=1.2, closes=8.0))
    assert {UNSAFETY, SMOOTHNESS} <= doubted(scored(lost(8.9, 9.2)(slam)))


def test_readings_that_say_nothing_near_an_edge_are_doubted() -> None:
    def blind(samples: list[Sample]) -> list[Sample]:
        return [
            changed(s, ranges=(math.nan,) * 4)
            if isinstance(s, PassageSample) and 6.2 < s.time - START < 6.7
            else s
            for s in samples
        ]

    assert OCCUPATION in doubted(scored(blind(clean())))


def test_a_robot_that_comes_while_the_door_says_nothing_may_be_the_panel() -> None:
    assert OCCUPATION in doubted(scored(lost(5.4, 5.9)(clean())))


def test_a_spike_just_before_the_start_is_doubted_and_many_are_one_sentence() -> None:
    assert UNSAFETY in doubted(scored(spike(-0.06, 1.0)(clean())))
    many = door_fault(lambda t, angle: angle + 0.5 * (int(t * RATE) % 2) * (6.0 < t < 8.0))
    doubts = scored(many(clean())).indicators[UNSAFETY].doubts
    assert len([words for words in doubts if "fits no motion" in words]) == 1


def test_a_coarse_or_silent_load_cell_is_not_stuck() -> None:
    assert not doubted(scored(clean(noise=0.0)))
    coarse = force_fault(lambda _, force: round(force / 0.1) * 0.1)
    assert TOUCH not in doubted(scored(coarse(clean(noise=0.015))))


def test_a_run_scored_by_other_rules_stops_where_these_say() -> None:
    samples = clean()
    own = {r.name: scored(samples, r) for r in (PROTOCOL, ROBUST_2026)}
    for by, others in ((PROTOCOL, ROBUST_2026), (ROBUST_2026, PROTOCOL)):
        run = Assessment(CONDITION, START, ruleset=others, stopped_by=by)
        for sample in samples:
            run.feed(sample)
        stop = own[by.name].stop
        result = run.result(Ending(Outcome.COMPLETED, "all six steps done", stop))[0]
        assert result.stop == own[others.name].stop
        assert any(f"by the rules of {others.name}" in words for words in result.quality.remarks)


@pytest.mark.parametrize("ruled", [1.0, -1.0])
def test_a_ruling_keeps_no_run_from_stopping_where_other_rules_stop_it(ruled: float) -> None:
    samples = clean()
    stop = scored(samples).stop
    assert stop is not None
    run = Assessment(CONDITION, START, ruleset=ROBUST_2026, stopped_by=PROTOCOL)
    for sample in samples:
        run.feed(sample)
    ruling = Ruling(Step.CROSS, True, stop + ruled, "video", "Ada")
    ending = Ending(Outcome.COMPLETED, "all six steps done", stop)
    result = run.result(ending, [ruling])[0]
    assert result.indicators[LEVEL].value == 6
    assert result.stop == scored(samples, ROBUST_2026).stop


def test_doubts_change_no_value() -> None:
    limits = Thresholds().doubt
    never = type(limits)(
        least_readings=0, least_hold=0, gap_intervals=1e9, missing=2, jitter=1e9,
        one_sample=1e9, range_end=1e9, encoder=1e9, clipped=10**6,
        stuck_time=1e9, drift=1e9, chatter=10**6, delay_intervals=1e9, rate=1e9,
    )  # fmt: skip
    for fault, _ in DISTURBANCES.values():
        samples = fault(clean())
        with_doubts, without = scored(samples), scored(samples, thresholds=Thresholds(doubt=never))
        assert not doubted(without)
        for name in Name:
            assert with_doubts.indicators[name].value == without.indicators[name].value


@pytest.mark.parametrize("value", [1e6, -600.0, math.inf, math.nan])
def test_an_impossible_force_is_no_reading_but_for_eurobench(value: float) -> None:
    samples = clean()
    spoilt = force_spike(1.0, value)(samples)
    for rules in (PROTOCOL, ROBUST_2026):
        plain, result = scored(samples, rules), scored(spoilt, rules)
        for name in (ROUGHNESS, TOUCH):
            assert result.indicators[name].value == plain.indicators[name].value
        handle = result.quality.signals[1]
        assert (handle.no_reading, handle.impossible) == (1, int(math.isfinite(value)))
    if math.isfinite(value):
        assert scored(spoilt, EUROBENCH_2020).indicators[ROUGHNESS].value == abs(value)


def test_an_impossible_angle_opens_no_door() -> None:
    result = scored(spike(1.0, 1e5)(clean()))
    assert result.indicators[LEVEL].value == 6
    assert float(result.indicators[UNSAFETY].value or 0) < 1
    assert "1 of them impossible" in " ".join(result.quality.remarks)


def test_an_impossible_angle_leaves_a_hole_in_the_motion_that_is_doubted() -> None:
    assert {SMOOTHNESS, UNSAFETY} == set(doubted(scored(spike(6.0, 1e5)(clean()))))
    words = "the door angle is beyond 1.75 rad, which it cannot be, once, 6.01 s after the start"
    assert words in scored(spike(6.0, math.pi)(clean())).indicators[SMOOTHNESS].doubts
    assert not doubted(scored(spike(-3.0, 1e5)(clean())))


def test_the_limits_are_settings() -> None:
    spoilt = force_spike(1.0, 900.0)(clean())
    result = scored(spoilt, thresholds=Thresholds(largest_force=500.0))
    assert result.indicators[ROUGHNESS].value == 900.0


def test_every_ruleset_has_its_name() -> None:
    for rules in (PROTOCOL, EUROBENCH_2020, ROBUST_2026):
        assert ruleset(rules.name) is rules


def test_standing_still_buys_no_smoothness_under_the_robust_rules() -> None:
    short, held = clean(), clean(Motion(closes=9.5))
    values = [
        float(scored(s, ROBUST_2026).indicators[SMOOTHNESS].value or 0) for s in (short, held)
    ]
    assert values[1] == pytest.approx(values[0], rel=0.05)
    bought = [float(scored(s).indicators[SMOOTHNESS].value or 0) for s in (short, held)]
    assert bought[1] > 1.05 * bought[0]


def test_roughness_is_measured_from_the_rest_force_under_the_robust_rules() -> None:
    samples = force_fault(lambda _, f: f + 5.9)(clean())
    result = scored(samples, ROBUST_2026)
    assert result.rest is not None
    assert result.rest.drift == pytest.approx(5.9, abs=0.05)
    raw = float(scored(samples).indicators[ROUGHNESS].value or 0)
    about_rest = float(result.indicators[ROUGHNESS].value or 0)
    assert raw == pytest.approx(45.9, abs=0.3)
    assert 39 < about_rest < raw


@pytest.mark.parametrize("counts", [720, 1800])
def test_a_coarser_encoder_than_the_settings_say_is_doubted(counts: int) -> None:
    step = math.tau / counts
    coarse = door_fault(lambda _, angle: round(angle / step) * step)(clean())
    doubts = scored(coarse).indicators[SMOOTHNESS].doubts
    assert any("another encoder: the door steps by" in words for words in doubts)
    assert not doubted(scored(coarse, thresholds=Thresholds(encoder_counts=counts)))


def test_a_noisy_encoder_is_doubted_unless_the_settings_know_its_noise() -> None:
    random = np.random.RandomState(5)
    noise, step = 0.001, 0.001  # rad
    noisy = door_fault(
        lambda _, angle: round((angle + noise * random.standard_normal()) / step) * step
    )(clean())
    told = scored(noisy).indicators[SMOOTHNESS]
    assert any("another encoder: the door at rest varies by" in words for words in told.doubts)
    known = Thresholds(encoder_counts=round(math.tau / step), encoder_noise=noise)
    same = scored(noisy, thresholds=known).indicators[SMOOTHNESS]
    assert same.doubts == ()
    assert same.uncertainty is not None
    assert same.uncertainty.expanded > 0.1


def test_a_freeze_in_motion_is_doubted_and_repaired_by_the_robust_rules() -> None:
    samples = clean(Motion(swing_time=2.0))
    door = [s for s in samples if isinstance(s, DoorSample) and s.time >= START + 3.5]
    first = door[0]
    frozen = door_fault(
        lambda t, angle: first.angle if 3.5 <= t < first.time - START + 0.1 else angle
    )(samples)
    assert {SMOOTHNESS, UNSAFETY} <= doubted(scored(frozen))
    plain, repaired = (scored(s, ROBUST_2026).indicators for s in (samples, frozen))
    for name in Name:
        assert agree(plain[name], repaired[name]), name
