"""`scoring.evaluate`: a run from arrays, as the console scores it from its samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

from scoring import BenchmarkType, Condition, RulesetName, ScoringError, evaluate
from scoring.indicator_table import IndicatorName, ruleset
from scoring.kinematics import Array
from scoring.protocol import (
    Outcome,
    Side,
    Signal,
    Strip,
    Thresholds,
)
from scoring.result import Result
from scoring.samples import DoorSample, HandleSample, LatchSample, PassageSample, Sample
from tests.scoring.clean_run import BY_EVENT, TIMEOUT, clean, scored
from tests.scoring.runs import (
    CONDITION,
    START,
)

SAMPLES = clean()


def measured(sample: Sample) -> object:
    match sample:
        case DoorSample():
            return sample.angle
        case HandleSample():
            return sample.force
        case PassageSample():
            return sample.ranges
        case LatchSample():
            return sample.engaged


def arrays(samples: list[Sample], seed: int | None = None) -> dict[str, Any]:
    """The arguments of `evaluate`, each signal in an order of its own."""
    found: dict[Signal, Any] = {}
    for signal in {sample.signal for sample in samples}:
        of = [sample for sample in samples if sample.signal is signal]
        if seed is not None:
            np.random.RandomState(seed).shuffle(of)  # type: ignore[arg-type]
        found[signal] = np.array([s.time for s in of]), np.array([measured(s) for s in of])
    passage = {strip.value: found[Signal.of_strip(strip)] for strip in Strip}
    told = {"door": found[Signal.DOOR], "handle": found[Signal.HANDLE], "passage": passage}
    return told | ({"latch": found[Signal.LATCH]} if Signal.LATCH in found else {})


def as_frames(told: dict[str, Any]) -> dict[str, Any]:
    def frame(data: tuple[Array, Array]) -> pd.DataFrame:
        return pd.DataFrame(np.column_stack(data))

    passage = {strip: frame(data) for strip, data in told["passage"].items()}
    return {"door": frame(told["door"]), "handle": frame(told["handle"]), "passage": passage}


def as_lists(told: dict[str, Any]) -> dict[str, Any]:
    passage = {s: (t.tolist(), r.tolist()) for s, (t, r) in told["passage"].items()}
    return {"passage": passage} | {k: [v.tolist() for v in told[k]] for k in ("door", "handle")}


@pytest.mark.parametrize("rules", RulesetName)
@pytest.mark.parametrize("form", [dict, as_frames, as_lists])
def test_arrays_in_any_order_and_form_score_to_the_digits_of_the_samples(
    form: Callable[[dict[str, Any]], dict[str, Any]], rules: RulesetName
) -> None:
    result = evaluate(
        CONDITION,
        np.float64(START),
        **form(arrays(SAMPLES, seed=1)),
        timeout=TIMEOUT,
        ruleset=rules,
        thresholds=BY_EVENT,
    )
    expected = scored(SAMPLES, ruleset(rules))
    assert result.indicators == expected.indicators
    assert (result.stop, result.outcome) == (expected.stop, Outcome.COMPLETED)
    assert [step.final for step in result.steps] == [step.final for step in expected.steps]


@pytest.mark.parametrize(
    ("until", "timeout", "reason", "outcome", "stop"),
    [
        (13.0, 300.0, "all six steps done", Outcome.COMPLETED, START + 11.05),
        (13.0, 5.0, "5 s elapsed", Outcome.TIMEOUT, START + 5.0),
        (11.0, 300.0, "the samples end 11.0 s after the start", Outcome.INTERRUPTED, None),
    ],
)
def test_a_run_stops_at_its_last_step_or_timeout(
    until: float, timeout: float, reason: str, outcome: Outcome, stop: float | None
) -> None:
    samples = [sample for sample in SAMPLES if sample.time < START + until]
    result = evaluate(CONDITION, START, **arrays(samples), timeout=timeout)
    assert result.outcome_reason.startswith(reason)
    assert result.outcome is outcome
    assert result.stop == (stop and pytest.approx(stop, abs=0.01))


@pytest.mark.parametrize("states", [[True, False, True], [1, 0, 1], [0.9, 0.1, 0.5]])
def test_a_latch_sensor_may_send_truths_or_numbers(states: list[float]) -> None:
    times = START + np.array([-1.0, 2.2, 12.0])
    result = evaluate(CONDITION, START, **arrays(SAMPLES), latch=(times, states))
    assert (result.lock_detection, result.stop) == ("sensor", START + 12.0)


def test_a_result_is_a_table_in_a_notebook_a_dataframe_and_figures() -> None:
    result = evaluate(CONDITION, START, **arrays(SAMPLES), timeout=1.0)
    assert isinstance(result, Result)
    shown, frame = result._repr_html_(), result.to_frame()
    for name, one in result.indicators.items():
        assert f"<td>{name}<td>{one.text}" in shown
        assert frame.value[name] == one.value or (pd.isna(frame.value[name]) and one.value is None)
    assert frame.reason[IndicatorName.TIME_TO_HANDLE] == "handle never touched"
    assert len(result.figures()) > 1


@pytest.mark.parametrize("number", [0, 21, 1.5, "7", None])
def test_a_condition_without_its_number_is_refused(number: int) -> None:
    with pytest.raises(ScoringError, match="does not exist: use a number from 1 to 20"):
        Condition.from_number(number)


def test_a_condition_has_sides_or_a_number() -> None:
    words = Condition("Constant Force", "cw", "ccw")  # type: ignore[arg-type]
    assert words == Condition(BenchmarkType.CONSTANT_FORCE, Side.CW, Side.CCW)
    assert words == Condition.from_number(7) == Condition.from_number(np.int64(7))  # type: ignore[arg-type]
    with pytest.raises(ScoringError, match="opening_side: there is no 'left': use cw or ccw"):
        Condition("Constant Force", "left", "ccw")  # type: ignore[arg-type]


T, V = np.array([0.0, 1.0]), np.array([0.0, 0.0])
RANGES = np.zeros((2, 4))

REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "unequal": ({"door": (T, V[1:])}, r"door: 2 times, but 1 values: give a value for each"),
    "no time": ({"handle": (np.array([0.0, np.nan]), V)}, "handle: a time is no finite number"),
    "dates": (
        {"door": (pd.to_datetime(T), V)},
        "door: give times in s, and a value for each, as numbers",
    ),
    "words": ({"door": (T, ["a", "b"])}, "door: give times in s, and a value for each, as numbers"),
    "no pair": ({"door": T}, "door: give times in s, and a value for each, as numbers"),
    "empty": ({"handle": ([], [])}, "handle: no samples: give those of the whole run"),
    "no such strip": ({"passage": {"left": (T, RANGES)}}, "no strip 'left': name cw_left, cw"),
    "three ranges": (
        {"passage": {"cw_left": (T, RANGES[:, :3])}},
        r"passage\['cw_left'\]: 2 times, but 2 x 3 values: give 4 ranges for each",
    ),
    "unknown latch": ({"latch": (T, [1.0, np.nan])}, "latch: a state is nan: leave that"),
    "no start": ({"start": np.nan}, "start nan: give a finite number, s"),
    "no such time": ({"start": 10**400}, "start 1000"),
    "a start in words": ({"start": "0"}, "start '0': give a finite number, s"),
    "no timeout": ({"timeout": 0}, "timeout 0: give more than 0 s"),
    "no zero": ({"handle_zero": np.inf}, "handle_zero inf: give a finite number, N"),
    "a number": ({"condition": 7}, "condition: give a Condition, not int"),
    "limits by name": ({"thresholds": {"touch_force": 2}}, "thresholds: give a Thresholds, not d"),
    "no strips": ({"passage": [(T, RANGES)]}, "passage: give a Mapping, not list"),
    "a series": ({"door": pd.Series(V, T)}, "door: give times in s, and a value for each, as n"),
    "an empty frame": ({"door": pd.DataFrame()}, "door: give times in s, and a value for each"),
    "complex": ({"door": (T, V * 1j)}, "door: give times in s, and a value for each, as numbers"),
    "endless digits": ({"door": (T, [10**400, 0])}, "door: give times in s, and a value for each"),
    "a limit in words": (
        {"thresholds": Thresholds(touch_force="3")},  # type: ignore[arg-type]
        "thresholds: touch_force '3': give a number from 0.01 to 1000",
    ),
    "two masks": (
        {"thresholds": Thresholds(mask_from=(0.1, 0.2))},  # type: ignore[arg-type]
        r"thresholds: mask_from \(0.1, 0.2\): give 5 numbers from 0 to 3.15",
    ),
    "no ruleset": ({"ruleset": "mine"}, "ruleset 'mine' is not known"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_used_is_one_line_that_names_the_argument_and_the_remedy(case: str) -> None:
    changed, words = REFUSED[case]
    passage = {"cw_left": (T, RANGES)}
    given: dict[str, Any] = {"start": 0.0, "door": (T, V), "handle": (T, V), "passage": passage}
    with pytest.raises(ScoringError, match=words) as refusal:
        evaluate(**{"condition": CONDITION} | given | changed)
    assert "\n" not in str(refusal.value)


def test_a_masked_value_is_no_reading() -> None:
    told, masked = arrays(SAMPLES), arrays(SAMPLES)
    times, angles = told["door"]
    hidden = np.arange(times.size) == times.size // 2
    told["door"] = times, np.where(hidden, np.nan, angles)
    masked["door"] = times, np.ma.masked_array(np.where(hidden, 1.0, angles), hidden)
    by_nan, by_mask = (evaluate(CONDITION, START, **one) for one in (told, masked))
    assert by_mask.indicators == by_nan.indicators
