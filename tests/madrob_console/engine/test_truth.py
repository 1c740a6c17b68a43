"""What the engine finds against what the simulated testbed knows from its own plan.

`pytest -m slow tests/madrob_console/engine/test_truth.py --runs 300 -s` runs the full count.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from pathlib import Path

import pytest

from madrob_console.testbeds.messages import DEFAULT_MAPPINGS, Decoder, MessageTypes
from madrob_console.testbeds.simulation import Scenario
from madrob_console.testbeds.simulation.plan import MotionPlan
from madrob_console.testbeds.simulation.truth import Truth
from recorder.reader import read_bag
from scoring.evaluate import Result
from scoring.indicators import IndicatorName
from scoring.protocol import BenchmarkType, Condition, Event, EventName, Side, Signal, Thresholds
from tests.madrob_console.engine.drive import Drive, make_setup

TIMEOUT = 60.0
SIGNALS = {
    EventName.HANDLE_IS_TOUCHED: (Signal.HANDLE,),
    EventName.DOOR_OPENS: (Signal.DOOR,),
    EventName.DOOR_CLOSES: (Signal.DOOR,),
    EventName.APPROACHES_CW: (Signal.CW_LEFT, Signal.CW_RIGHT),
    EventName.MOVES_TO_CW: (Signal.CW_LEFT, Signal.CW_RIGHT),
    EventName.APPROACHES_CCW: (Signal.CCW_LEFT, Signal.CCW_RIGHT),
    EventName.MOVES_TO_CCW: (Signal.CCW_LEFT, Signal.CCW_RIGHT),
}
PASSAGE_SIDES = {
    name(side): side for side in Side for name in (EventName.approaches, EventName.moves_to)
}
Stamps = dict[Signal, list[float]]


@dataclass(frozen=True, slots=True)
class Comparison:
    """How far a result is from the truth.

    Attributes:
        error: the largest event-time error, samples.
        unmasked_error: the same of passage events that waited for the panel to clear their
            sensor. These need two samples: a door angle beyond the mask, then a range.
        level, true_level: capability levels.
    """

    error: float
    unmasked_error: float
    level: int
    true_level: int


@dataclass(frozen=True, slots=True)
class Played:
    """A run that was played, and what truly happened in it."""

    result: Result
    truth: Truth
    plan: MotionPlan
    stamps: Stamps


def play(results: Path, scenario: Scenario, seed: int, condition: Condition) -> Played:
    drive = Drive(results, scenario, seed)
    drive.whole_run(make_setup(condition, timeout=TIMEOUT))
    truth, plan = drive.source.truth(TIMEOUT), drive.source.testbed.plan
    scored, folder = drive.engine.scored, drive.engine.folder
    assert scored is not None
    assert truth is not None
    assert plan is not None
    assert folder is not None
    drive.engine.close()
    return Played(scored.result, truth, plan, stamps_in(folder))


def stamps_in(folder: Path) -> Stamps:
    """The stamps of each signal in a bag."""
    decoder = Decoder(DEFAULT_MAPPINGS, MessageTypes())
    stamps: Stamps = {}
    for message in read_bag(folder).messages():
        sample = decoder.decode(message)
        if sample is not None:
            stamps.setdefault(sample.signal, []).append(sample.time)
    return stamps


def error_in_samples(found: Event, true: Event, stamps: Stamps) -> float:
    """1 = found at the last instant of the sampling interval in which it truly happened."""
    for signal in SIGNALS.get(found.name, ()):
        place = bisect_left(stamps[signal], found.time)
        if place < len(stamps[signal]) and stamps[signal][place] == found.time:
            interval = found.time - stamps[signal][place - 1]
            return abs(found.time - true.time) / interval
    return abs(found.time - true.time) / 0.02  # the start, or the stop


def waited_for_the_panel(true: Event, played: Played) -> bool:
    """Whether the panel cleared a sensor of the event's side at the event's true time."""
    if true.name not in PASSAGE_SIDES:
        return False
    side = PASSAGE_SIDES[true.name]
    time = true.time - played.result.start

    def masked(index: int, at: float) -> bool:
        return Thresholds().masked(side, index, played.plan.angle(at))

    return any(masked(i, time - 0.002) and not masked(i, time + 0.002) for i in range(5))


def compare(played: Played) -> Comparison:
    result, truth = played.result, played.truth
    assert [e.name for e in result.events] == [e.name for e in truth.events], lines(result, truth)
    assert result.ending.outcome is truth.outcome, lines(result, truth)
    errors, unmasked = [0.0], [0.0]
    for found, true in zip(result.events, truth.events, strict=True):
        kind = unmasked if waited_for_the_panel(true, played) else errors
        kind.append(error_in_samples(found, true, played.stamps))
    level = result.indicator(IndicatorName.CAPABILITY_LEVEL).value
    assert isinstance(level, int)
    return Comparison(max(errors), max(unmasked), level, truth.capability_level)


def lines(result: Result, truth: Truth) -> str:
    def text(events: tuple[Event, ...]) -> list[str]:
        return [f"{e.time - result.start:8.3f} {e.name}" for e in events]

    found, true = text(result.events), text(truth.events)
    return "\n".join(["found:", *found, result.ending.outcome, "true:", *true, truth.outcome])


CONDITIONS = [
    Condition(BenchmarkType.NO_FORCE, opening, starting) for opening in Side for starting in Side
]


@pytest.mark.parametrize("scenario", [s for s in Scenario if s is not Scenario.RANDOM])
def test_every_scenario_is_found_as_it_truly_is(scenario: Scenario, tmp_path: Path) -> None:
    condition = CONDITIONS[list(Scenario).index(scenario) % 4]
    found = compare(play(tmp_path, scenario, 1, condition))
    assert found.error <= 1
    assert found.unmasked_error <= 2
    assert found.level == found.true_level


@pytest.mark.slow
def test_random_runs_are_found_as_they_truly_are(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    runs = request.config.getoption("--runs")
    found = [
        compare(play(tmp_path / str(n), Scenario.RANDOM, n, Condition.from_number(1 + n % 20)))
        for n in range(runs)
    ]
    worst, unmasked = max(c.error for c in found), max(c.unmasked_error for c in found)
    wrong = sum(c.level != c.true_level for c in found)
    print(
        f"{runs} random runs: largest event-time error {worst:.3f} samples "
        f"({unmasked:.3f} where a passage sensor waited for the panel), "
        f"{wrong} wrong capability levels"
    )
    assert worst <= 1
    assert unmasked <= 2
    assert wrong == 0
