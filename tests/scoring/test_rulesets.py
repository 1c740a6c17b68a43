from __future__ import annotations

import subprocess
import sys
from dataclasses import MISSING, fields

import pytest

from scoring.braking import braking_table, door_controller_mode
from scoring.errors import ScoringError
from scoring.protocol import BenchmarkType, Side
from scoring.rulesets import EUROBENCH_2020, PROTOCOL, Ruleset, RulesetName, ruleset


def test_every_name_finds_its_ruleset() -> None:
    assert ruleset("protocol") is PROTOCOL
    assert ruleset("eurobench-2020") is EUROBENCH_2020
    assert {ruleset(name).name for name in RulesetName} == set(RulesetName)


def test_an_unknown_name_is_refused_with_the_allowed_ones() -> None:
    with pytest.raises(ScoringError, match=r"'eurobench'.*protocol or eurobench-2020"):
        ruleset("eurobench")


def test_the_two_differ_in_every_choice_but_share_filter_orders_and_frequencies() -> None:
    shared = {"window_time", "savgol_order", "low_pass_order", "low_pass_frequency"}
    for field in fields(Ruleset):
        same = getattr(PROTOCOL, field.name) == getattr(EUROBENCH_2020, field.name)
        has_default = field.default is not MISSING  # what further rulesets choose between
        assert same == (field.name in shared) or has_default, field.name
    assert PROTOCOL.savgol_window != EUROBENCH_2020.savgol_window


@pytest.mark.parametrize("benchmark_type", BenchmarkType)
def test_braking_tables_have_a_force_for_each_of_181_degrees(benchmark_type: BenchmarkType) -> None:
    table = braking_table(benchmark_type, Side.CW)
    assert len(table) == 181
    assert braking_table(benchmark_type, Side.CCW) == tuple(reversed(table))


def test_braking_tables_brake_where_the_protocol_says() -> None:
    sudden_force = braking_table(BenchmarkType.SUDDEN_FORCE, Side.CW)
    assert (sudden_force[111], sudden_force[112], sudden_force[180]) == (0, 4000, 4000)
    sudden_ramp = braking_table(BenchmarkType.SUDDEN_RAMP, Side.CW)
    assert sudden_ramp[112:130] == (
        *(2000, 2000, 3000, 3000, 5000, 5000),
        *(8000,) * 3,
        *(12000,) * 3,
        *(20000,) * 5,
        0,
    )
    wind = braking_table(BenchmarkType.WIND_RAMP, Side.CW)
    borders = [i for i in range(1, 181) if wind[i] != wind[i - 1]]
    assert borders == [7, 18, 33, 53, 130, 150, 165, 176]
    assert [wind[i] for i in (0, *borders)] == [0, 1000, 2000, 3000, 4000, 3000, 2000, 1000, 0]


def test_only_no_force_switches_the_brake_off() -> None:
    off = [kind for kind in BenchmarkType if door_controller_mode(kind) == 0]
    assert off == [BenchmarkType.NO_FORCE]
    assert set(braking_table(BenchmarkType.NO_FORCE, Side.CW)) == {0}
    assert set(braking_table(BenchmarkType.CONSTANT_FORCE, Side.CCW)) == {4000}


@pytest.mark.machine
def test_what_screens_import_loads_no_slow_library() -> None:
    code = (
        "import sys, scoring.rulesets, scoring.braking, scoring.indicators;"
        "import scoring.eurobench.run_info;"
        "print(sorted({'scipy', 'pandas'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
