"""What is said of the uncertainty of a value (section 11).

How often it holds the truth is tried in `tests/madrob_console/testbeds/test_worth_of_numbers.py`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from scoring.assessment import Assessment
from scoring.indicator_table import IndicatorName as Name
from scoring.procedure import Ruling
from scoring.protocol import LockDetection, Outcome, Step, Thresholds
from scoring.result import Ending
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, Ruleset
from tests.scoring.clean_run import (
    BY_EVENT,
    NOMINAL,
    Motion,
    clean,
    force_fault,
    lost,
    scored,
)
from tests.scoring.runs import CONDITION, START


@pytest.mark.parametrize("rules", [PROTOCOL, EUROBENCH_2020], ids=lambda r: r.name)
def test_the_same_recording_has_the_same_uncertainties_and_another_one_others(
    rules: Ruleset,
) -> None:
    first, again, other = (scored(clean(seed=seed), rules).indicators for seed in (1, 1, 2))
    assert first == again
    assert any(first[name].uncertainty != other[name].uncertainty for name in Name)
    for indicator in first.values():
        assert indicator.uncertainty is not None
        for value in (indicator.uncertainty.u, indicator.uncertainty.expanded):
            assert value == float(f"{value:.1e}")


def expanded(name: Name, motion: Motion = NOMINAL, rate: float = 50.0) -> float:
    known = scored(clean(motion, rate=rate)).indicators[name].uncertainty
    assert known is not None
    return known.expanded


def test_a_start_by_hand_is_part_of_what_is_measured_from_it() -> None:
    by_hand = scored(clean(), thresholds=Thresholds()).indicators
    for name, one in scored(clean()).indicators.items():
        own, late = one.uncertainty, by_hand[name].uncertainty
        assert own is not None
        assert late is not None
        assert late.expanded >= 0.2 if name.spec.with_the_start else late == own


def test_what_of_the_roughness_is_rest_stands_beside_it() -> None:
    drifted = force_fault(lambda t, force: force + (1.5 if t > 3 else 0.0))
    rough = scored(drifted(clean())).indicators[Name.ROUGHNESS_OF_DOOR_ACTUATION]
    assert rough.uncertainty is not None
    assert rough.uncertainty.rest == pytest.approx(1.5, abs=0.05)
    assert rough.text.endswith(" N, of these 1.5 N at rest")
    assert rough.doubts == ()


def test_where_there_is_no_value_there_is_no_uncertainty() -> None:
    indicators = scored(lost(-2.0, 20.0)(clean())).indicators  # no door at all
    assert {one.uncertainty is None for one in indicators.values() if one.value is None} == {True}
    assert {one.uncertainty is None for one in indicators.values() if one.value} == {False}
    assert indicators[Name.SMOOTHNESS_OF_DOOR_ACTUATION].value is None


@pytest.mark.parametrize("name", [Name.EXECUTION_TIME, Name.CAPABILITY_LEVEL])
def test_a_timeouts_own_time_is_as_exact_as_its_start_and_a_level_has_no_spread(name: Name) -> None:
    assert expanded(name, replace(NOMINAL, closes=99.0)) == 0


@pytest.mark.parametrize("outcome", [Outcome.COMPLETED, Outcome.TIMEOUT])
@pytest.mark.parametrize("ruled", [False, True])
def test_a_stop_that_a_torn_recording_lacks_is_as_uncertain_as_any_other(
    outcome: Outcome, ruled: bool
) -> None:
    whole, stop = scored(clean()), START + 11.4
    torn = Assessment(CONDITION, START, lock_detection=LockDetection.SETTLE, thresholds=BY_EVENT)
    for sample in clean():
        if sample.time < START + 9.0:
            torn.feed(sample)
    rulings = [Ruling(Step.LOCK, True, stop, "I saw it", "Ada")] if ruled else []
    result, _ = torn.result(Ending(outcome, "", stop), rulings)
    name = Name.EXECUTION_TIME
    known, usual = result.indicators[name].uncertainty, whole.indicators[name].uncertainty
    assert known is not None
    assert usual is not None
    if outcome is Outcome.TIMEOUT or ruled:  # no sensor found it
        assert known.expanded == 0
    else:
        assert known.expanded == pytest.approx(usual.expanded, rel=0.25)
    assert result.indicators[name].doubts == ()


def test_a_trembling_robot_is_not_taken_for_a_smooth_one() -> None:
    known = scored(clean(Motion(tremble=0.004))).indicators[Name.SMOOTHNESS_OF_DOOR_ACTUATION]
    assert known.value is not None
    assert known.uncertainty is not None
    assert known.uncertainty.expanded < 0.1 * known.value < 0.4


@pytest.mark.parametrize(
    ("name", "slow", "quick"),
    [(Name.EXECUTION_TIME, 25.0, 50.0), (Name.TIME_TO_HANDLE, 50.0, 100.0)],
)
def test_a_slower_rate_is_less_certain(name: Name, slow: float, quick: float) -> None:
    assert expanded(name, rate=slow) > 1.5 * expanded(name, rate=quick)


PRINT = """
from scoring.rulesets import EUROBENCH_2020, PROTOCOL
from tests.scoring.clean_run import clean, scored
for rules in (PROTOCOL, EUROBENCH_2020):
    print([one.uncertainty for one in scored(clean(), rules).indicators.values()])
"""


@pytest.mark.machine
def test_uncertainties_are_the_same_on_a_processor_that_lacks_instructions() -> None:
    lacking = {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR AVX2 AVX512F"}
    printed = [
        subprocess.run(
            [sys.executable, "-W", "ignore", "-c", PRINT],
            capture_output=True,
            check=True,
            cwd=Path(__file__).parents[2],
            env=os.environ | more,
            text=True,
        ).stdout
        for more in ({}, lacking)
    ]
    assert printed[0].count("expanded") == 2 * len(Name)
    assert printed[0] == printed[1]
