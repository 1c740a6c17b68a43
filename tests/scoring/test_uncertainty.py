"""What the uncertainty of a value is worth: how often it holds the truth (section 11).

`pytest -m slow tests/scoring/test_uncertainty.py --runs 200 -n 2 -rP` prints the whole table.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scoring.evaluate import Assessment
from scoring.indicator_table import IndicatorName as Name
from scoring.procedure import Ruling
from scoring.protocol import LockDetection, Outcome, Step
from scoring.result import Ending
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, ROBUST_2026, Ruleset
from tests.scoring.clean_run import NOMINAL, TIMEOUT, Motion, clean, lost, scored
from tests.scoring.runs import CONDITION, START

MOTIONS: dict[str, Motion] = {
    "nominal": NOMINAL,
    "quick": Motion(opens=2.4, swing_time=2.0, closes=7.0),
    "slow": Motion(swing_time=4.0, closes=9.0),
    "narrow": Motion(swing=0.8),
    "wide": Motion(swing=1.4),
    "slam": Motion(swing_time=1.2, closes=8.0),
    "weak and short pull": Motion(pull=20.0, pull_time=0.12),
    "strong and long pull": Motion(pull=90.0, pull_time=1.0),
    "late touch": Motion(touch=2.31, tremble=0.002),
    "long in the doorway": Motion(arrives=5.55, left=8.1),
    "short in the doorway": Motion(arrives=5.61, through=5.8, left=6.05),
    "closes at once": Motion(closes=6.4, left=6.33),
}
HALF_AN_INTERVAL = {  # by so many an edge is seen late, less one that begins
    Name.EXECUTION_TIME: 1,
    Name.TIME_TO_HANDLE: 1,
    Name.DOOR_OCCUPATION_TIME: 0,
    Name.PASSAGE_TIME: 0,
}
REFERENCES = range(10_000, 10_060)
"""Seeds of other repetitions, whose mean is the truth with what sampling and encoder make of it."""


def true_times(motion: Motion) -> dict[Name, float]:
    """The times of a motion without sensors, s."""
    time = np.linspace(0, TIMEOUT, 1_450_001)
    touched = float(time[np.argmax(np.abs(motion.force(time)) > 1.96133)])
    is_open = np.abs(motion.angle(time)) >= 0.03
    closed = float(time[np.flatnonzero(is_open[:-1] & ~is_open[1:])[-1] + 1])
    return {
        Name.EXECUTION_TIME: closed,
        Name.TIME_TO_HANDLE: touched,
        Name.DOOR_OCCUPATION_TIME: motion.left - motion.arrives,
        Name.PASSAGE_TIME: closed - touched,
    }


def repetitions(motion: Motion, seeds: range) -> dict[Name, tuple[np.ndarray, np.ndarray]]:
    """Values and expanded uncertainties of each indicator, of runs with the same motion."""
    runs = [scored(clean(motion, seed)).indicators for seed in seeds]
    found = {}
    for name in Name:
        values = [float(run[name].value or math.nan) for run in runs]
        known = [run[name].uncertainty for run in runs]
        found[name] = (
            np.array(values),
            np.array([math.nan if each is None else each.expanded for each in known]),
        )
    return found


def coverage(motion: Motion, seeds: range) -> dict[Name, float]:
    """In which part of repetitions the expanded uncertainty holds the truth, less known bias."""
    held, others = repetitions(motion, seeds), repetitions(motion, REFERENCES)
    times = true_times(motion)
    share = {}
    for name, (values, expanded) in held.items():
        truth = float(others[name][0].mean())
        if name in times:
            truth = times[name] + HALF_AN_INTERVAL[name] * 0.01
        share[name] = float(np.mean(np.abs(values - truth) <= expanded + 1e-9))
    return share


@pytest.mark.slow
@pytest.mark.parametrize("part", range(2))
def test_the_expanded_uncertainty_holds_the_truth_as_often_as_it_should(
    part: int, request: pytest.FixtureRequest
) -> None:
    """Of 12 motions; with few runs, of some of them."""
    runs = request.config.getoption("--runs")
    chosen = list(MOTIONS)[part :: 2 if runs >= 100 else 6]
    print(f"{'motion':22}" + "".join(f"{name.spec.title:>10}" for name in Name))
    for motion in chosen:
        share = coverage(MOTIONS[motion], range(runs))
        print(f"{motion:22}" + "".join(f"{100 * share[name]:9.1f}%" for name in Name))
        for name, part_held in share.items():
            # a binomial of so few runs strays by three of its standard deviations
            stray = 3 * math.sqrt(0.9 * 0.1 / runs)
            assert part_held >= 0.9 - stray, f"{motion}: {name}"


@pytest.mark.parametrize("rules", [PROTOCOL, EUROBENCH_2020, ROBUST_2026], ids=lambda r: r.name)
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


def test_where_there_is_no_value_there_is_no_uncertainty() -> None:
    indicators = scored(lost(-2.0, 20.0)(clean())).indicators  # no door at all
    assert {one.uncertainty is None for one in indicators.values() if one.value is None} == {True}
    assert {one.uncertainty is None for one in indicators.values() if one.value} == {False}
    assert indicators[Name.SMOOTHNESS_OF_DOOR_ACTUATION].value is None


@pytest.mark.parametrize("name", [Name.EXECUTION_TIME, Name.CAPABILITY_LEVEL])
def test_a_timeouts_own_time_is_exact_and_a_level_has_no_spread(name: Name) -> None:
    assert expanded(name, replace(NOMINAL, closes=99.0)) == 0


@pytest.mark.parametrize("outcome", [Outcome.COMPLETED, Outcome.TIMEOUT])
@pytest.mark.parametrize("ruled", [False, True])
def test_a_stop_that_the_torn_recording_lacks_is_as_uncertain_as_any_that_sensors_found(
    outcome: Outcome, ruled: bool
) -> None:
    whole, stop = scored(clean()), START + 11.4
    torn = Assessment(CONDITION, START, lock_detection=LockDetection.SETTLE)
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
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, ROBUST_2026
from tests.scoring.clean_run import clean, scored
for rules in (PROTOCOL, EUROBENCH_2020, ROBUST_2026):
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
    assert printed[0].count("expanded") == 3 * len(Name)
    assert printed[0] == printed[1]
