"""What the engine finds against what the simulated testbed knows from its own plan.

`pytest -m slow tests/madrob_console/engine/test_truth.py --runs 1000 -n 2 -rP` runs the full count.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from madrob_console.messages.codec import DEFAULT_MAPPINGS, Decoder, MessageTypes
from madrob_console.testbeds.simulated import Scenario
from madrob_console.testbeds.simulated.perception import observe
from madrob_console.testbeds.simulated.sensor_model import SensorSettings
from recorder.reader import read_bag
from scoring.indicator_table import IndicatorName
from scoring.protocol import BenchmarkType, Condition, Event, EventName, Side, Signal
from scoring.result import EventRecord, Result
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.testbeds.truth import Truth, truth_of_testbed
from tests.slowly import slow_but_for

TIMEOUT = 60.0
NOISE = 5 * SensorSettings().handle_noise
"""A reading of the load cell is nearer to the force than this, N: five standard deviations."""
SIGNALS = {
    EventName.HANDLE_IS_TOUCHED: (Signal.HANDLE,),
    EventName.DOOR_OPENS: (Signal.DOOR,),
    EventName.DOOR_CLOSES: (Signal.DOOR,),
    EventName.APPROACHES_CW: (Signal.CW_LEFT, Signal.CW_RIGHT),
    EventName.MOVES_TO_CW: (Signal.CW_LEFT, Signal.CW_RIGHT, Signal.DOOR),  # the stop's own time
    EventName.APPROACHES_CCW: (Signal.CCW_LEFT, Signal.CCW_RIGHT),
    EventName.MOVES_TO_CCW: (Signal.CCW_LEFT, Signal.CCW_RIGHT, Signal.DOOR),
    EventName.BENCHMARK_STOP: tuple(Signal),  # the time of step 6, or a timeout's own
}
Stamps = dict[Signal, list[float]]


@dataclass(frozen=True, slots=True)
class Played:
    """A run: what the engine found, what is true, and when the sensors were read.

    Attributes:
        blur: for so long, s, at most, the true force is as near to the threshold of a touch as
            the load cell's noise is large, so that no reading can tell on which side it is.
    """

    result: Result
    truth: Truth
    stamps: Stamps
    blur: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """The largest event-time error of a run, in samples, and its two capability levels.

    Attributes:
        error: beyond the load cell's noise, which blurs a touch and nothing else.
        raw_error: noise included.
    """

    error: float
    raw_error: float
    level: int
    true_level: int


def play(results: Path, scenario: Scenario, seed: int, condition: Condition) -> Played:
    drive = Drive(results, scenario, seed)
    drive.whole_run(make_setup(condition, timeout=TIMEOUT))
    truth = truth_of_testbed(drive.source.testbed, TIMEOUT)
    scored, folder = drive.engine.scored, drive.engine.folder
    assert scored is not None
    assert truth is not None
    assert folder is not None
    drive.engine.close()
    return Played(scored.result, truth, stamps_in(folder), touch_blur(drive))


def touch_blur(drive: Drive) -> float:
    """How long the force takes through the noise about the threshold, on its slower side, s."""
    testbed = drive.source.testbed
    assert testbed.plan is not None
    touched = []
    for margin in (-NOISE, 0.0, NOISE):
        thresholds = testbed.geometry.thresholds
        force = thresholds.touch_force + margin
        geometry = replace(testbed.geometry, thresholds=replace(thresholds, touch_force=force))
        touched.append(observe(testbed.plan, geometry).touched)
    before, at, after = touched
    if before is None or at is None or after is None:
        return 0.0
    return max(at - before, after - at)


def stamps_in(folder: Path) -> Stamps:
    """The stamps of each signal in a bag."""
    decoder = Decoder(DEFAULT_MAPPINGS, MessageTypes())
    stamps: Stamps = {}
    for message in read_bag(folder).messages():
        sample = decoder.decode(message)
        if sample is not None:
            stamps.setdefault(sample.signal, []).append(sample.time)
    return stamps


def error_in_samples(found: EventRecord, true: Event, stamps: Stamps, blur: float = 0.0) -> float:
    """1 = found at the last instant of the sampling interval in which it truly happened.

    Args:
        found, true: one event, twice.
        stamps: when each signal was read.
        blur: for so long nobody could tell whether a touch had happened, s.
    """
    error = abs(found.time - true.time)
    if found.event is EventName.HANDLE_IS_TOUCHED:
        error = max(0.0, error - blur)
    for signal in SIGNALS.get(found.event, ()):
        times = stamps.get(signal, [])
        place = bisect_left(times, found.time)
        if place < len(times) and times[place] == found.time:
            interval = found.time - times[place - 1]
            return error / interval
    return error / 0.02  # not seen by a sensor


def compare(played: Played) -> Comparison:
    result, truth = played.result, played.truth
    assert [e.event for e in result.events] == [e.name for e in truth.events], lines(result, truth)
    assert result.outcome is truth.outcome, lines(result, truth)
    error, raw_error = (
        max(
            error_in_samples(found, true, played.stamps, blur)
            for found, true in zip(result.events, truth.events, strict=True)
        )
        for blur in (played.blur, 0.0)
    )
    level = result.indicators[IndicatorName.CAPABILITY_LEVEL].value
    assert isinstance(level, int)
    return Comparison(error, raw_error, level, truth.capability_level)


def lines(result: Result, truth: Truth) -> str:
    found = [f"{e.since_start:8.3f} {e.event}" for e in result.events]
    true = [f"{e.time - result.start:8.3f} {e.name}" for e in truth.events]
    return "\n".join(["found:", *found, result.outcome, "true:", *true, truth.outcome])


CONDITIONS = [
    Condition(BenchmarkType.NO_FORCE, opening, starting) for opening in Side for starting in Side
]


@pytest.mark.parametrize(
    "scenario",
    slow_but_for(
        [s for s in Scenario if s is not Scenario.RANDOM],
        *(Scenario.NOMINAL, Scenario.CLOSES_UNDER_SENSORS, Scenario.BOUNCES, Scenario.SLAM),
    ),
)
def test_every_scenario_is_found_as_it_truly_is(scenario: Scenario, tmp_path: Path) -> None:
    condition = CONDITIONS[list(Scenario).index(scenario) % 4]
    found = compare(play(tmp_path, scenario, 1, condition))
    assert found.error <= 1
    assert found.level == found.true_level


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_random_runs_are_found_as_they_truly_are(
    part: int, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    runs = request.config.getoption("--runs")
    found = {
        n: compare(play(tmp_path / str(n), Scenario.RANDOM, n, Condition.from_number(1 + n % 20)))
        for n in range(part, runs, 4)
    }
    worst = max(one.error for one in found.values())
    raw = max(one.raw_error for one in found.values())
    wrong = [n for n, one in found.items() if one.level != one.true_level]
    print(
        f"{len(found)} random runs: largest event-time error {worst:.3f} samples "
        f"({raw:.3f} with the load cell's noise), "
        f"{len(wrong)} wrong capability levels"
    )
    assert worst <= 1, [n for n, one in found.items() if one.error > 1]
    assert not wrong
