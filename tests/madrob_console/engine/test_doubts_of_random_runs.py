"""How often doubts fire: on clean runs of random robots, and on runs with one fault each.

`pytest -m slow tests/madrob_console/engine/test_doubts_of_random_runs.py --runs 1000 -n 2 -rP`
runs the full count; of the faults a fifth of that."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from random import Random

import numpy as np
import pytest
from msgspec.structs import replace as changed

from madrob_console.archive.run_record import RunRecord
from madrob_console.archive.scored import read_recorded_run
from madrob_console.engine.core.scored_run import RenderedResult
from madrob_console.messages.codec import Decoder
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.simulated import Scenario, SimulatedTestbed
from madrob_console.testbeds.simulated.sensor_model import SensorSettings
from recorder.reader import Bag
from scoring.indicator_table import IndicatorName as Name
from scoring.protocol import BenchmarkType, Condition, Event, EventName, Outcome, Side, Signal
from scoring.result import Ending, EventRecord, Result
from scoring.samples import DoorSample, HandleSample, Sample
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.robots import EVERY, Played, Robot, openings
from tests.madrob_console.testbeds.truth import truth_of_testbed
from tests.scoring.clean_run import Fault, door_fault, force_fault, late, lost, passage_fault
from tests.scoring.runs import START
from tests.slowly import slow_but_for

TIMEOUT = 60.0


@dataclass(frozen=True, slots=True)
class Recorded:
    """A run of a random robot: its result, and its samples with the start at `START`."""

    result: Result
    record: RunRecord
    ending: Ending
    samples: list[Sample]

    def at(self, name: EventName) -> float | None:
        """When something happened last, s since the start."""
        times = [event.since_start for event in self.result.events if event.event is name]
        return times[-1] if times else None

    def spoilt(self, fault: Fault) -> Result:
        """The result with a fault in the samples."""
        assessment = self.record.assessment(START)
        done = None
        for sample in fault(self.samples):
            assessment.feed(sample)
            if done is None and isinstance(sample, DoorSample):
                done = assessment.procedure().completed  # a slammed door may open again after it
        ending = self.ending
        if ending.outcome is Outcome.COMPLETED and done is None:
            ending = Ending(Outcome.TIMEOUT, "time over", START + TIMEOUT)
        elif done is not None:
            ending = Ending(Outcome.COMPLETED, "all six steps done", done)
        return assessment.result(ending)[0]


def record(results: Path, seed: int) -> Recorded:
    """A run of the robot with that seed."""
    scored, folder, _ = played(results, Robot.RANDOM, seed, Condition.from_number(1 + seed % 20))
    recorded = read_recorded_run(folder)
    shift = scored.result.start - START
    samples = [
        changed(s, time=s.time - shift, log_time=s.log_time - shift) for s in decoded(folder)
    ]
    run = scored.run.ending
    stop = None if run.stop is None else run.stop - shift
    ending = Ending(run.outcome, run.reason, stop)
    return Recorded(scored.result, recorded.record, ending, samples)


def played(
    results: Path, scenario: Played, seed: int, condition: Condition
) -> tuple[RenderedResult, Path, SimulatedTestbed]:
    """A whole run: what came of it, its folder and its testbed."""
    drive = Drive(results, scenario, seed)
    drive.whole_run(make_setup(condition, timeout=TIMEOUT))
    drive.engine.close()
    assert drive.engine.scored is not None
    return drive.engine.scored, drive.folder, drive.source.testbed


def decoded(folder: Path) -> list[Sample]:
    decoder = Decoder(DEFAULT_MAPPINGS, MessageTypes())
    samples = (decoder.decode(message) for message in Bag(folder).messages())
    return [sample for sample in samples if sample is not None]


@pytest.mark.slow
@pytest.mark.parametrize("part", range(2))
def test_clean_runs_are_seldom_doubted(
    part: int, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    runs = max(20, request.config.getoption("--runs"))
    fired: Counter[str] = Counter()
    doubted = beyond = 0
    for seed in range(part, runs, 2):
        result = record(tmp_path / str(seed), seed).result
        if any(signal.impossible for signal in result.quality.signals):
            beyond += 1  # the robot pulls harder than the load cell can say: doubted with reason
            continue
        doubted += bool(result.doubts)
        fired.update(kind_of(words) for words in result.doubts)
    count = len(range(part, runs, 2)) - beyond
    print(f"{doubted} of {count} clean runs are doubted: {dict(fired)}; beyond 20 kgf: {beyond}")
    for kind, times in fired.items():
        assert times <= max(2, 0.01 * count), kind  # two of a few may be


def kind_of(words: str) -> str:
    """A doubt without its numbers."""
    return " ".join(part for part in words.split() if not any(c.isdigit() for c in part))


FAULTS = (
    *("touch", "spike", "impossible", "losses", "clipped"),
    *("stuck", "gap", "delay", "blip"),
)


def fault_in(run: Recorded, kind: str, random: Random) -> tuple[Fault, Name] | None:
    """A fault at a random place, and an indicator that it spoils; None where it spoils none."""
    touched, closed = run.at(EventName.HANDLE_IS_TOUCHED), run.at(EventName.DOOR_CLOSES)
    opened = run.at(EventName.DOOR_OPENS)
    roughness = run.result.indicators[Name.ROUGHNESS_OF_DOOR_ACTUATION].value or 0.0
    zero, end = run.result.handle_zero, (run.result.stop or START) - run.result.start
    match kind:
        case "touch" if touched is not None and touched > 0.5:
            at = random.uniform(0.2, touched - 0.2)
            pull = zero + random.choice((-1, 1)) * 6.0
            return force_fault(once(at, lambda _: pull)), Name.TIME_TO_HANDLE
        case "spike" if opened is not None and closed is not None:
            at = random.uniform(0.2, end - 0.2)
            by = math.copysign(0.6, random.random() - 0.5)

            def spike(angle: float) -> float:
                possible = abs(angle + by) < run.record.thresholds.largest_angle
                return angle + by if possible else angle - by

            return door_fault(once(at, spike)), Name.SMOOTHNESS_OF_DOOR_ACTUATION
        case "impossible" if opened is not None and closed is not None:
            at = random.uniform(opened, closed)
            return door_fault(once(at, lambda _: math.pi)), Name.SMOOTHNESS_OF_DOOR_ACTUATION
        case "losses" if opened is not None and closed is not None and closed - opened > 1.5:
            part = random.uniform(0.02, 0.1)
            losing = Random(random.random())
            return (
                door_fault(lambda _, angle: None if losing.random() < part else angle),
                Name.UNSAFETY_OF_DOOR_OPERATION,
            )
        case "clipped" if touched is not None and roughness > abs(zero) + 6.0:
            top = abs(zero) + random.uniform(0.3, 0.6) * (roughness - abs(zero))
            return (
                force_fault(lambda _, f: max(-top, min(f, top))),
                Name.ROUGHNESS_OF_DOOR_ACTUATION,
            )
        case "stuck":
            since = random.uniform(0.0, end - 0.7)
            kept: list[float] = []

            def hold(t: float, force: float) -> float:
                if not since <= t < since + 0.65:
                    return force
                kept.append(force)
                return kept[0]

            return force_fault(hold), Name.ROUGHNESS_OF_DOOR_ACTUATION
        case "gap" if touched is not None and touched > 0.2:
            since = touched - random.uniform(0.01, 0.1)
            return lost(since, since + 0.09, HandleSample), Name.TIME_TO_HANDLE
        case "delay" if run.result.indicators[Name.PASSAGE_TIME].value is not None:
            return late(DoorSample, random.uniform(0.03, 0.09)), Name.PASSAGE_TIME
        case "blip" if run.ending.outcome is Outcome.COMPLETED:
            # something is under one sensor of a side for one sample
            side, at = run.record.setup.condition.starting_side, end + random.uniform(-0.5, -0.1)
            return passage_fault(side, at, at + 0.02, there=True), Name.CAPABILITY_LEVEL
    return None


def once(at: float, change: Callable[[float], float]) -> Callable[[float, float], float]:
    """One sample at about `at` s is another."""
    done: list[float] = []

    def spoil(t: float, value: float) -> float:
        if t >= at and not done:
            done.append(t)
            return change(value)
        return value

    return spoil


@pytest.mark.slow
@pytest.mark.parametrize("part", range(2))
def test_every_fault_is_doubted(part: int, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    wanted = max(len(FAULTS), request.config.getoption("--runs") // 5)
    tried: Counter[str] = Counter()
    silent = []
    seed = 50_000 + part
    while sum(tried.values()) < wanted // 2:
        random = Random(seed)
        run = record(tmp_path / str(seed), seed)
        kind = FAULTS[(part * len(FAULTS) // 2 + sum(tried.values())) % len(FAULTS)]
        order = sorted(FAULTS, key=lambda each: (each != kind, random.random()))
        found = next((f for each in order if (f := fault_in(run, each, random))), None)
        kind = next(each for each in order if fault_in(run, each, Random(seed)) is not None)
        if found is not None:
            fault, spoils = found
            result = run.spoilt(fault)
            if kind == "blip" and result.events == run.spoilt(list).events:
                seed += 2  # under a panel that masks it
                continue
            tried[kind] += 1
            if not result.indicators[spoils].doubts:
                silent.append((seed, kind, spoils))
        seed += 2
    print(f"{sum(tried.values())} faults, {dict(tried)}, not doubted: {silent}")
    assert not silent


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


def errors_of(results: Path, scenario: Played, seed: int, condition: Condition) -> list[float]:
    """How far off the events of a run are, in samples; what else was found is what truly was.

    The noise of load cell and encoder blurs touches and edges of the door: that much is no error.
    """
    scored, folder, testbed = played(results, scenario, seed, condition)
    result, truth = scored.result, truth_of_testbed(testbed, TIMEOUT)
    assert truth is not None
    found = [e.event for e in result.events], result.outcome
    assert found == ([e.name for e in truth.events], truth.outcome), (result.events, truth.events)
    level = result.indicators[Name.CAPABILITY_LEVEL].value
    assert (seed, level) == (seed, truth.capability_level)
    stamps: Stamps = {}
    for sample in decoded(folder):
        stamps.setdefault(sample.signal, []).append(sample.time)
    pairs = zip(result.events, truth.events, strict=True)
    blurs = {Signal.HANDLE: touch_blur(testbed), Signal.DOOR: door_blur(testbed)}
    return [error_in_samples(one, true, stamps, blurs) for one, true in pairs]


def touch_blur(testbed: SimulatedTestbed) -> float:
    """How long the force takes through the noise about the threshold, on its slower side, s.

    So long no reading can tell on which side of it the force is.
    """
    plan, force = testbed.plan, testbed.geometry.thresholds.touch_force
    assert plan is not None
    times = np.arange(0.0, plan.end, 1e-4)
    pressed = np.abs(plan.grip.over(times))
    if pressed.max(initial=0.0) <= force + NOISE:
        return 0.0
    before, at, after = (times[np.argmax(pressed > force + by)] for by in (-NOISE, 0.0, NOISE))
    return float(max(at - before, after - at))


def door_blur(testbed: SimulatedTestbed) -> float:
    """How long the panel takes, at its slowest edge, through the encoder's noise on one side, s."""
    plan, thresholds = testbed.plan, testbed.geometry.thresholds
    assert plan is not None
    opening = openings(plan, np.arange(0.0, plan.end, 1e-4))
    level = thresholds.closed_angle - thresholds.encoder_count / 2  # a reading is rounded
    near = np.abs(opening - level) < 4 * thresholds.encoder_noise
    edges = np.flatnonzero(near[1:] != near[:-1])
    return float((edges[1::2] - edges[::2]).max(initial=0)) * 1e-4 / 2


def error_in_samples(
    found: EventRecord, true: Event, stamps: Stamps, blurs: Mapping[Signal, float]
) -> float:
    """1 = found at the last instant of the sampling interval in which it truly happened.

    Args:
        found, true: one event, twice.
        stamps: when each signal was read.
        blurs: for so long nobody could tell by a signal whether it had happened, s.
    """
    error = abs(found.time - true.time)
    for signal in SIGNALS.get(found.event, ()):
        times = stamps.get(signal, [])
        place = bisect_left(times, found.time)
        if place < len(times) and times[place] == found.time:
            interval = found.time - times[place - 1]
            return max(0.0, error - blurs.get(signal, 0.0)) / interval
    return error / 0.02  # not seen by a sensor


CONDITIONS = [
    Condition(BenchmarkType.NO_FORCE, opening, starting) for opening in Side for starting in Side
]


@pytest.mark.parametrize(
    "scenario",
    slow_but_for(
        EVERY,
        *(Scenario.NOMINAL, Robot.CLOSES_UNDER_SENSORS, Robot.BOUNCES, Scenario.SLAM),
    ),
)
def test_every_scenario_is_found_as_it_truly_is(scenario: Played, tmp_path: Path) -> None:
    condition = CONDITIONS[EVERY.index(scenario) % 4]
    assert max(errors_of(tmp_path, scenario, 1, condition)) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_random_runs_are_found_as_they_truly_are(
    part: int, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    runs = request.config.getoption("--runs")
    found = {
        n: max(errors_of(tmp_path / str(n), Robot.RANDOM, n, Condition.from_number(1 + n % 20)))
        for n in range(part, runs, 4)
    }
    worst = max(found.values())
    print(f"{len(found)} random runs: largest event-time error {worst:.3f} samples")
    assert worst <= 1, [n for n, error in found.items() if error > 1]
