"""A machine whose clock is stepped by an hour in the middle of a run: nobody notices."""

from __future__ import annotations

import random
import re
import struct
import time as real_time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from madrob_console.archive import score
from madrob_console.clock import NS, SystemClock
from madrob_console.engine.live.core import Engine
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.messages.codec import DEFAULT_MAPPINGS, MessageTypes
from madrob_console.referee.acts import Start
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario, SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from recorder.message import RawMessage
from recorder.reader import read_bag
from scoring.protocol import Signal
from scoring.result import Result
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.engine.machine_time import Machine
from tests.madrob_console.engine_process import EngineProcess, WallClock
from tests.slowly import slow_but_for

HOUR = 3600
SAMPLE = 0.025
SETTLED = 3.0
"""After a step outside of a run the topics look healthy again, s: rates are of 2 s."""

_JUMP = re.compile(r"clock stepped by ([-+0-9.]+) s, later stamps shifted back")
_STAMP = struct.Struct("<4xiI")  # the header's stamp, behind the four bytes that name the encoding


class SteppedDrive(Drive):
    """A drive on the machine's clock."""

    def __init__(self, results: Path, scenario: Scenario = Scenario.NOMINAL) -> None:
        types = MessageTypes()
        system = SystemClock()
        testbed = SimulatedTestbed(scenario, 0)
        self.source = SimulatedSource(testbed, system, types)
        config = EngineConfig(results, DEFAULT_MAPPINGS, lossless=True, disk_needed=0)
        self.engine = Engine(self.source, system, config, types)
        self.engine.open()


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    machine = Machine()
    monkeypatch.setattr("madrob_console.clock.time", machine)
    return machine


def result_of(drive: Drive) -> Result:
    assert drive.engine.scored is not None
    return drive.engine.scored.result


def folder_of(drive: Drive) -> Path:
    assert drive.engine.folder is not None
    return drive.engine.folder


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Result:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("madrob_console.clock.time", Machine())
        drive = SteppedDrive(tmp_path_factory.mktemp("undisturbed"))
        drive.whole_run(make_setup())
        drive.engine.close()
    return result_of(drive)


def in_countdown(drive: Drive) -> bool:
    return drive.engine.run.phase is Phase.COUNTDOWN


def touched(drive: Drive) -> bool:
    return len(drive.engine.snapshot().provisional) > 0


def settling(drive: Drive) -> bool:
    return drive.engine.snapshot().settling


def stopped(drive: Drive) -> bool:
    return drive.engine.run.phase is Phase.STOPPED


@pytest.mark.parametrize("jump", slow_but_for([HOUR, -HOUR], -HOUR))
@pytest.mark.parametrize(
    "moment", slow_but_for([in_countdown, touched, settling, stopped], touched)
)
def test_a_clock_stepped_during_a_run_changes_no_digit(
    moment: Callable[[Drive], bool],
    jump: float,
    machine: Machine,
    undisturbed: Result,
    tmp_path: Path,
) -> None:
    drive = SteppedDrive(tmp_path)
    drive.prepare(make_setup())
    drive.act(Start())
    drive.wait_until(lambda: moment(drive))
    drive.wait(0.3)
    machine.step(jump)
    drive.wait(0.1)
    assert drive.engine.snapshot().faults == ()
    drive.finish()
    assert result_of(drive) == undisturbed
    assert next(score(folder_of(drive))).result == undisturbed
    check_log_times(folder_of(drive))
    check_engine_goes_on(drive, undisturbed)


def check_log_times(folder: Path) -> None:
    """They are steady: no hole, no step back, no jump."""
    times: dict[str, list[int]] = {}
    for message in read_bag(folder).messages():
        times.setdefault(message.topic, []).append(message.receive_ns)
    for mapping in DEFAULT_MAPPINGS:
        of_topic = times.get(mapping.topic, [])
        intervals = [later - earlier for earlier, later in pairwise(of_topic)]
        assert all(0 < interval < 0.1 * NS for interval in intervals)
        assert len(intervals) > 500 or mapping.signal is Signal.LATCH


def check_engine_goes_on(drive: Drive, expected: Result) -> None:
    """The clock follows the machine's again: all looks healthy, and a run is as long."""
    drive.wait(SETTLED)
    assert drive.engine.snapshot().faults == ()
    drive.whole_run(make_setup(run_number=2))
    assert durations(result_of(drive)) == pytest.approx(durations(expected), abs=SAMPLE)


def durations(result: Result) -> dict[str, float]:
    found = {f"{n} {e.event}": e.since_start for n, e in enumerate(result.events)}
    indicators = result.indicators.items()
    return found | {name: i.value for name, i in indicators if i.unit == "s" and i.value}


@pytest.mark.parametrize("jump", slow_but_for([HOUR, -HOUR], HOUR))
def test_a_clock_stepped_before_the_start_delays_nothing(
    jump: float, machine: Machine, undisturbed: Result, tmp_path: Path
) -> None:
    drive = SteppedDrive(tmp_path)
    drive.prepare(make_setup())
    machine.step(jump)
    drive.wait(SETTLED)
    assert drive.engine.snapshot().faults == ()
    drive.act(Start())
    drive.finish()
    result = result_of(drive)
    assert result.start == pytest.approx(undisturbed.start + jump + SETTLED, abs=SAMPLE)
    assert durations(result) == pytest.approx(durations(undisturbed), abs=SAMPLE)
    assert next(score(folder_of(drive))).result == result


@pytest.mark.parametrize("jump", slow_but_for([HOUR, -HOUR], HOUR))
def test_a_timeout_is_steady_time(jump: float, machine: Machine, tmp_path: Path) -> None:
    drive = SteppedDrive(tmp_path, Scenario.TOUCH_ONLY)
    drive.start(make_setup(timeout=8.0))
    drive.wait(3.0)
    began = machine.monotonic_ns()
    machine.step(jump)
    drive.finish()
    run = drive.engine.run
    assert run.start is not None
    assert (run.outcome, run.stop) == ("timeout", run.start + 8.0)
    assert (machine.monotonic_ns() - began) / NS == pytest.approx(5.0 + 1.1, abs=0.1)


@pytest.mark.parametrize("jump", slow_but_for([HOUR, -HOUR], -HOUR))
def test_stamps_that_follow_the_stepped_clock_are_shifted_back_and_flagged(
    jump: int, machine: Machine, undisturbed: Result, tmp_path: Path
) -> None:
    drive = SteppedDrive(tmp_path)
    drive.start(make_setup())
    drive.wait(5.0)
    take = drive.source.take

    def stepped(timeout: float) -> list[RawMessage]:
        return [shifted(message, jump) for message in take(timeout)]

    drive.source.take = stepped  # type: ignore[method-assign]
    machine.step(jump)
    drive.finish()
    result = result_of(drive)
    assert result.outcome == undisturbed.outcome
    assert durations(result) == pytest.approx(durations(undisturbed), abs=SAMPLE)
    jumps = [_JUMP.search(remark) for remark in result.quality.remarks]
    assert [float(found[1]) for found in jumps if found] == pytest.approx([jump] * 6, abs=SAMPLE)
    assert next(score(folder_of(drive))).result == result


def shifted(message: RawMessage, jump: int) -> RawMessage:
    seconds, nanoseconds = _STAMP.unpack_from(message.data)
    stamp = _STAMP.pack(seconds + jump, nanoseconds)
    return replace(message, data=message.data[:4] + stamp[4:] + message.data[_STAMP.size :])


@pytest.mark.slow
def test_a_clock_stepped_again_and_again_loses_no_run(
    machine: Machine,
    undisturbed: Result,
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    count, rng = request.config.getoption("--runs"), random.Random(11)
    expected = durations(undisturbed)
    drive = SteppedDrive(tmp_path)
    worst = 0.0
    for number in range(1, count + 1):
        drive.prepare(make_setup(run_number=number))
        drive.act(Start())
        for _ in range(3):
            drive.wait(rng.uniform(0.5, 4.0))
            machine.step(rng.choice((HOUR, -HOUR, 0.7, -0.7)))
        drive.finish()
        found = durations(result_of(drive))
        assert found.keys() == expected.keys()
        worst = max(worst, *(abs(found[name] - expected[name]) for name in expected))
        assert next(score(folder_of(drive))).result == result_of(drive)
        drive.wait(SETTLED)
    print(f"\n{count} runs with 3 steps of the clock: 0 lost, {1000 * worst:.0f} ms at most")
    assert worst <= SAMPLE


@pytest.mark.needs("faketime")
@pytest.mark.slow
def test_a_process_whose_wall_clock_is_stepped_makes_the_same_run(tmp_path: Path) -> None:
    jumps = (0, HOUR, -HOUR)
    with ThreadPoolExecutor(len(jumps)) as pool:
        found = dict(zip(jumps, pool.map(partial(run_stepped_by, tmp_path), jumps), strict=True))
    worst = max(abs(found[jump][name] - found[0][name]) for jump in jumps for name in found[0])
    print(f"\nwall clock stepped by +1 h and by -1 h: events differ by {1000 * worst:.1f} ms")
    assert worst <= SAMPLE


def run_stepped_by(tmp_path: Path, jump: int) -> dict[str, float]:
    """Times of the events since the start of a run in whose middle the clock jumps."""
    folder = tmp_path / str(jump)
    folder.mkdir()
    clock = WallClock(folder)
    with EngineProcess(folder / "results", "nominal", clock) as engine:
        engine.start(make_setup(countdown=1.0))
        real_time.sleep(3.0)
        clock.step(jump)
        real_time.sleep(2.0)
        shown = engine.snapshot()
        assert (shown.run.phase, shown.faults) == (Phase.RUNNING, ())
        document = engine.result()
        run_folder = engine.folder
        engine.wait_for(lambda s: abs(s.time - real_time.time() - jump) < 5.0)  # it did jump
    rescored = msgspec.json.decode(msgspec.json.encode(next(score(run_folder)).result))
    for part in ("indicators", "events", "steps", "quality", "outcome", "stop"):
        assert rescored[part] == document[part]
    check_log_times(run_folder)
    assert (document["outcome"], document["quality"]["remarks"]) == ("completed", [])
    return {event["event"]: event["since_start"] for event in document["events"]}
