"""A stepped clock, busy cores, a long day: no digit changes and nothing grows."""

from __future__ import annotations

import gc
import os
import random
import shutil
import threading
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from madrob_console.archive import score
from madrob_console.archive.scored import OpenedRun, Scored
from madrob_console.common.clock import NS, SystemClock
from madrob_console.engine.core.run_tracker import IN_FLIGHT, RunTracker
from madrob_console.engine.core.scored_run import EarlierRun, RenderedResult
from madrob_console.engine.ipc.client import RemoteEngine
from madrob_console.engine.requests import Role
from madrob_console.engine.runtime.recording import Recording
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.referee.acts import (
    Abort,
    DeclareTimeout,
    MarkIncident,
    Reissue,
    Rule,
    SetUp,
    Start,
    ZeroHandle,
)
from madrob_console.referee.journal import Journal
from madrob_console.referee.records import IncidentKind
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from recorder.reader import Bag
from recorder.writer import BagWriter
from scoring.assessment import Assessment
from scoring.protocol import POST_ROLL, Condition, Signal, Step
from scoring.result import Result
from tests.madrob_console.engine.drive import Drive, make_setup, signed
from tests.madrob_console.engine.machine_time import Machine
from tests.madrob_console.engine_process import EngineProcess
from tests.madrob_console.robots import Robot
from tests.slowly import slow_but_for

HOUR = 3600
SAMPLE = 0.025
SETTLED = 3.0
"""After a step outside of a run the topics look healthy again, s: rates are of 2 s."""


class SteppedDrive(Drive):
    """A drive on the machine's clock."""

    def __init__(self, results: Path, scenario: Scenario = Scenario.NOMINAL) -> None:
        super().__init__(results, scenario, clock=SystemClock())

    def result(self) -> Result:
        """Of the run that ends now; scored again it is the same."""
        self.finish()
        assert self.engine.scored is not None
        result = self.engine.scored.result
        assert next(score(self.folder)).result == result
        return result


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    machine = Machine()
    monkeypatch.setattr("madrob_console.common.clock.time", machine)
    return machine


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Result:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("madrob_console.common.clock.time", Machine())
        drive = SteppedDrive(tmp_path_factory.mktemp("undisturbed"))
        drive.start(make_setup())
        return drive.result()


def durations(result: Result) -> dict[str, float]:
    found = {f"{n} {e.event}": e.since_start for n, e in enumerate(result.events)}
    indicators = result.indicators.items()
    return found | {name: i.value for name, i in indicators if i.unit == "s" and i.value}


def check_log_times(folder: Path) -> None:
    """They are steady: no hole, no step back, no jump."""
    times: dict[str, list[int]] = {}
    for message in Bag(folder).messages():
        times.setdefault(message.topic, []).append(message.receive_ns)
    for mapping in DEFAULT_MAPPINGS:
        intervals = [later - earlier for earlier, later in pairwise(times.get(mapping.topic, []))]
        assert all(0 < interval < 0.1 * NS for interval in intervals)
        assert len(intervals) > 500 or mapping.signal is Signal.LATCH


MOMENTS: dict[str, Callable[[Drive], bool]] = {
    "countdown": lambda drive: drive.engine.run.phase is Phase.COUNTDOWN,
    "touched": lambda drive: len(drive.engine.snapshot().provisional) > 0,
    "settling": lambda drive: drive.engine.snapshot().settling,
    "stopped": lambda drive: drive.engine.run.phase is Phase.STOPPED,
}


@pytest.mark.parametrize("moment", slow_but_for(MOMENTS, "touched"))
def test_a_clock_stepped_during_a_run_changes_no_digit(
    moment: str, machine: Machine, undisturbed: Result, tmp_path: Path
) -> None:
    drive = SteppedDrive(tmp_path)
    drive.prepare(make_setup())
    drive.act(Start())
    drive.wait_until(lambda: MOMENTS[moment](drive))
    drive.wait(0.3)
    machine.step(-HOUR)
    drive.wait(0.1)
    assert drive.engine.snapshot().all_faults == ()
    assert drive.result() == undisturbed
    check_log_times(drive.folder)
    drive.wait(SETTLED)  # the clock follows the machine's again, and a run is as long
    assert drive.engine.snapshot().all_faults == ()
    drive.start(make_setup(run_number=2))
    assert durations(drive.result()) == pytest.approx(durations(undisturbed), abs=SAMPLE)


def test_a_timeout_is_steady_time(machine: Machine, tmp_path: Path) -> None:
    drive = SteppedDrive(tmp_path, Scenario.TOUCH_ONLY)
    drive.start(make_setup(timeout=8.0))
    drive.wait(3.0)
    began = machine.monotonic_ns()
    machine.step(HOUR)
    drive.finish()
    run = drive.engine.run
    assert run.start is not None
    assert (run.outcome, run.stop) == ("timeout", run.start + 8.0)
    assert (machine.monotonic_ns() - began) / NS == pytest.approx(
        5.0 + IN_FLIGHT + POST_ROLL, abs=0.1
    )


@pytest.mark.slow
def test_a_clock_stepped_again_and_again_loses_no_run(
    machine: Machine, undisturbed: Result, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    rng = random.Random(11)
    drive = SteppedDrive(tmp_path)
    for number in range(1, request.config.getoption("--runs") + 1):
        drive.prepare(make_setup(run_number=number))
        drive.act(Start())
        for _ in range(3):
            drive.wait(rng.uniform(0.5, 4.0))
            machine.step(rng.choice((HOUR, -HOUR, 0.7, -0.7)))
        assert durations(drive.result()) == pytest.approx(durations(undisturbed), abs=SAMPLE)
        drive.wait(SETTLED)


def test_an_engine_that_was_held_up_takes_no_topic_for_silent(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.act(SetUp(make_setup()))
    drive.wait(2.5)
    drive.clock.sleep(1.5)  # in which the disk did not answer, or others had the processor
    assert drive.engine.snapshot().faults == ()
    assert drive.engine.snapshot().door.angle is not None
    drive.act(ZeroHandle())
    drive.wait(0.1)
    drive.source.close()
    drive.wait(0.8)
    assert "silent for" in drive.engine.snapshot().all_faults[0]


PAGE = os.sysconf("SC_PAGE_SIZE")
MEMORY_GROWTH = 4_000_000
OF_A_RUN = (
    *(Engine, Recording, BagWriter, Journal, RunTracker, Assessment),
    *(Scored, OpenedRun, RenderedResult, EarlierRun),
)


def usage(pid: int | str = "self") -> tuple[int, int, int]:
    """Memory, threads and file handles of a process."""
    process = Path("/proc") / str(pid)
    memory = int((process / "statm").read_text().split()[1]) * PAGE
    return memory, len(list((process / "task").iterdir())), len(list((process / "fd").iterdir()))


def live_objects() -> dict[str, int]:
    gc.collect()
    alive = [type(one) for one in gc.get_objects()]
    return {kind.__name__: alive.count(kind) for kind in OF_A_RUN}


def check_flat(used: list[tuple[int, int, int]]) -> None:
    """The second half keeps no more than the second quarter; for a moment it may have more open."""
    quarter, half = len(used) // 4, len(used) // 2
    first, second = ([*zip(*part, strict=True)] for part in (used[quarter:half], used[half:]))
    more = max(second[0]) - max(first[0])
    threads, handles = (min(b) - min(a) for a, b in zip(first[1:], second[1:], strict=True))
    print(f"\n{len(used)} times: {more / 1e6:+.1f} MB, {threads} threads, {handles} handles")
    assert more < MEMORY_GROWTH
    assert max(threads, handles) <= 0


def a_run_of_the_day(drive: Drive, number: int, rng: random.Random) -> Path:
    """The referee does something else in every run; its folder."""
    run, condition = number // 20 + 1, Condition.from_number(number % 20 + 1)
    drive.start(make_setup(condition, run_number=run, timeout=rng.uniform(20.0, 60.0)))
    match number % 8:
        case 4:
            drive.act(MarkIncident(IncidentKind.COLLISION, "door frame"))
        case 6:
            drive.wait(4.0)
            drive.act(Abort("enough"))
        case 0:
            drive.wait(6.0)
            drive.act(DeclareTimeout("gave up"))
    while drive.engine.scored is None:
        drive.wait(0.1)
        drive.engine.snapshot()  # as often as screens look
    drive.act(Rule(Step.CROSS, confirmed=True, reason="seen"))
    drive.act(signed(drive.engine.snapshot()))
    assert drive.engine.refused == ""
    return drive.folder


@pytest.mark.slow
def test_memory_threads_and_handles_stay_flat_over_a_day_of_runs(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """1200 runs are ten hours."""
    count, rng = max(20, request.config.getoption("--runs")), random.Random(13)
    drive, kept = Drive(tmp_path / "results", Robot.RANDOM), None
    threads, used, objects = threading.active_count(), [], [live_objects()]
    for number in range(count):
        folder = a_run_of_the_day(drive, number, rng)
        if kept is not None:
            if number % 5 == 0:
                assert drive.open(kept) is None
                drive.act(Reissue("appeal granted"))
            shutil.rmtree(kept)  # the disk stays small
        kept = folder
        drive.wait(rng.uniform(1.0, 5.0))
        assert threading.active_count() == threads
        used.append(usage())
        if number + 1 in (count // 2, count):
            objects.append(live_objects())
    check_flat(used)
    before, half, end = objects
    assert half == end
    assert max(end[kind] - before[kind] for kind in end) <= 2
    drive.engine.close()


@pytest.mark.slow
def test_screens_that_come_and_go_leave_nothing_behind(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    used = []
    with EngineProcess(tmp_path / "results", "nominal") as engine:
        engine.start(make_setup(countdown=1.0))
        engine.result()  # it has loaded what scoring needs
        for number in range(5 * max(20, request.config.getoption("--runs"))):
            screen = RemoteEngine(engine.stem, Role.WATCH, f"screen {number}")
            screen.snapshot()
            screen.close()
            used.append(usage(engine.process.pid))
    check_flat(used)
