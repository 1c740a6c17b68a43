"""How far the values are said to repeat (protocol section 11)."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scoring.indicator_table import IndicatorName as Name
from scoring.indicator_table import RulesetName
from scoring.protocol import Thresholds
from tests.scoring.clean_run import NOMINAL, Motion, clean, force_fault, lost, scored

REPETITIONS = 20


def expanded(name: Name, motion: Motion = NOMINAL, rate: float = 50.0) -> float:
    known = scored(clean(motion, rate=rate)).indicators[name].uncertainty
    assert known is not None
    return known.expanded


def test_the_same_recording_has_the_same_uncertainties() -> None:
    assert scored(clean(seed=1)).indicators == scored(clean(seed=1)).indicators


def test_a_start_by_hand_widens_what_includes_it() -> None:
    by_hand = scored(clean(), thresholds=Thresholds()).indicators
    wider = {n for n, one in scored(clean()).indicators.items() if one != by_hand[n]}
    assert wider == {Name.EXECUTION_TIME, Name.TIME_TO_HANDLE}
    known = by_hand[Name.TIME_TO_HANDLE].uncertainty
    assert known is not None
    assert known.expanded == pytest.approx(0.2, rel=0.02)


def test_the_rest_force_stands_beside_the_roughness() -> None:
    offset = force_fault(lambda _, force: force + 0.8)
    rough = scored(offset(clean())).indicators[Name.ROUGHNESS_OF_DOOR_ACTUATION]
    assert rough.uncertainty is not None
    assert rough.uncertainty.rest == pytest.approx(0.8, abs=0.05)
    assert rough.text.endswith(" N, of these 0.8 N at rest")


def test_where_there_is_no_value_there_is_no_uncertainty() -> None:
    indicators = scored(lost(-2.0, 20.0)(clean())).indicators  # no door at all
    assert indicators[Name.SMOOTHNESS_OF_DOOR_ACTUATION].value is None
    assert indicators[Name.SMOOTHNESS_OF_DOOR_ACTUATION].uncertainty is None
    assert indicators[Name.TIME_TO_HANDLE].uncertainty is not None


@pytest.mark.parametrize("name", [Name.EXECUTION_TIME, Name.CAPABILITY_LEVEL])
def test_the_time_of_a_timeout_is_exact(name: Name) -> None:
    assert expanded(name, replace(NOMINAL, closes=99.0)) == 0


def test_the_rules_of_2020_have_no_uncertainty() -> None:
    indicators = scored(clean(), RulesetName.EUROBENCH_2020).indicators
    assert {one.uncertainty for one in indicators.values()} == {None}


@pytest.mark.parametrize(
    ("name", "slow", "quick"),
    [(Name.EXECUTION_TIME, 25.0, 50.0), (Name.TIME_TO_HANDLE, 50.0, 100.0)],
)
def test_a_slower_rate_is_less_certain(name: Name, slow: float, quick: float) -> None:
    assert expanded(name, rate=slow) > 1.5 * expanded(name, rate=quick)


@pytest.mark.parametrize("name", [n for n in Name if n is not Name.CAPABILITY_LEVEL])
def test_repetitions_of_a_run_lie_within_it(name: Name) -> None:
    results = [scored(clean(seed=seed)).indicators[name] for seed in range(REPETITIONS)]
    values = np.array([one.value for one in results], dtype=np.float64)
    known = [one.uncertainty for one in results if one.uncertainty is not None]

    held = np.abs(values - np.median(values)) <= [one.expanded for one in known]

    assert held.mean() >= 0.9


PRINT = """
from tests.scoring.clean_run import clean, scored
print([one.uncertainty for one in scored(clean()).indicators.values()])
"""


@pytest.mark.machine
def test_older_processors_give_the_same_uncertainties() -> None:
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
    assert printed[0].count("expanded") == len(Name)
    assert printed[0] == printed[1]
