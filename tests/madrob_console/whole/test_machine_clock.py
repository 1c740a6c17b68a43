"""A machine whose clock is stepped by an hour in the middle of a run: nobody notices."""

from __future__ import annotations

import gc
import os
import random
import re
import shutil
import struct
import subprocess
import sys
import threading
import time
import time as real_time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import cycle, pairwise
from pathlib import Path
from statistics import median
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from madrob_console.archive import score
from madrob_console.archive.scored import OpenedRun, Scored
from madrob_console.common.clock import NS, SystemClock
from madrob_console.engine.client import RemoteEngine
from madrob_console.engine.core import Engine
from madrob_console.engine.engine_config import EngineConfig
from madrob_console.engine.journal_writer import Recording
from madrob_console.engine.observation import RunTracker
from madrob_console.engine.requests import Role
from madrob_console.engine.scorer import EarlierRun, RenderedResult
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import (
    Abort,
    ConfirmPose,
    DeclareTimeout,
    MarkIncident,
    Reissue,
    Rule,
    SetUp,
    Start,
    ZeroHandle,
)
from madrob_console.referee.journal import Journal, read_journal
from madrob_console.referee.records import IncidentKind
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario, SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from recorder.bag import RawMessage
from recorder.reader import read_bag
from recorder.writer import BagWriter
from scoring.evaluate import Assessment
from scoring.protocol import Condition, Outcome, Signal, Step
from scoring.result import Result
from tests.madrob_console.engine.drive import Drive, make_setup, signed
from tests.madrob_console.engine.faulty_source import FaultyDrive
from tests.madrob_console.engine.machine_time import Machine
from tests.madrob_console.engine.spoilt import Edit, set_value
from tests.madrob_console.engine_process import EngineProcess, WallClock
from tests.madrob_console.small_disk import disk_image
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
    monkeypatch.setattr("madrob_console.common.clock.time", machine)
    return machine


def result_of(drive: Drive) -> Result:
    assert drive.engine.scored is not None
    return drive.engine.scored.result


def folder_of(drive: Drive) -> Path:
    return drive.folder


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Result:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("madrob_console.common.clock.time", Machine())
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
    assert drive.engine.snapshot().all_faults == ()
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
    assert drive.engine.snapshot().all_faults == ()
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
    assert drive.engine.snapshot().all_faults == ()
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
    take = drive.source.take_messages

    def stepped(timeout: float) -> list[RawMessage]:
        return [shifted(message, jump) for message in take(timeout)]

    drive.source.take_messages = stepped  # type: ignore[method-assign]
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
        assert (shown.run.phase, shown.all_faults) == (Phase.RUNNING, ())
        document = engine.result()
        run_folder = engine.folder
        engine.wait_for(lambda s: abs(s.time - real_time.time() - jump) < 5.0)  # it did jump
    rescored = msgspec.json.decode(msgspec.json.encode(next(score(run_folder)).result))
    for part in ("indicators", "events", "steps", "quality", "outcome", "stop"):
        assert rescored[part] == document[part]
    check_log_times(run_folder)
    assert (document["outcome"], document["quality"]["remarks"]) == ("completed", [])
    return {event["event"]: event["since_start"] for event in document["events"]}


STALL = 5.0
SETTLE = 1.0


@contextmanager
def busy_cores() -> Iterator[None]:
    """Two programs of the same priority as the engine's on every core."""
    loops = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in range(2 * (os.cpu_count() or 1))
    ]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def run_through(
    results: Path, trouble: AbstractContextManager[None], lasting: float | None = None
) -> dict[str, Any]:
    """The result of a run in which there is trouble, from its start to its end or for a while."""
    with EngineProcess(results, "nominal") as engine:
        engine.start(make_setup(countdown=1.0))
        with trouble:
            if lasting is None:
                engine.result()
            else:
                time.sleep(lasting)
        document = engine.result()
        shown, folder = engine.snapshot(), engine.folder
    assert (shown.recorder.dropped, shown.all_faults) == (0, ())
    assert (document["outcome"], document["quality"]["remarks"]) == ("completed", [])
    assert read_bag(folder).complete
    rescored = msgspec.json.encode(next(score(folder)).result)
    assert msgspec.json.decode(rescored)["events"] == document["events"]
    return document


def events(document: dict[str, Any]) -> dict[str, float]:
    return {event["event"]: event["since_start"] for event in document["events"]}


def stop_seen_after(results: Path) -> float:
    """How long after the stop it was decided, the settle time left out, s."""
    (folder,) = results.glob("practice/subject_*")
    lines, _ = read_journal(folder / "journal.jsonl")
    (line,) = (line for line in lines if line.what == "run stops")
    return line.time - float(line.details["time"]) - SETTLE


def test_an_engine_that_was_held_up_takes_no_topic_for_silent(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.act(SetUp(make_setup()))
    drive.wait(2.5)
    drive.clock.sleep(1.5)  # in which the disk did not answer, or others had the processor
    held_up = drive.engine.snapshot()
    assert held_up.faults == ()
    assert held_up.door.angle is not None
    assert drive.engine.perform(ZeroHandle()) is None
    drive.wait(0.1)
    drive.source.close()
    drive.wait(0.8)
    assert "silent for" in drive.engine.snapshot().all_faults[0]


@pytest.mark.slow
def test_busy_cores_change_no_event_and_drop_nothing(tmp_path: Path) -> None:
    quiet = events(run_through(tmp_path / "quiet", nullcontext()))
    busy = events(run_through(tmp_path / "busy", busy_cores()))
    assert busy.keys() == quiet.keys()
    worst = max(abs(busy[name] - quiet[name]) for name in quiet)
    late = stop_seen_after(tmp_path / "busy")
    print(
        f"\n{2 * (os.cpu_count() or 1)} busy loops on {os.cpu_count()} cores: 0 dropped, events "
        f"differ by {1000 * worst:.1f} ms, the stop was seen after {1000 * late:.0f} ms"
    )
    assert worst <= SAMPLE
    assert late < 1.0


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.slow
def test_a_disk_that_stalls_for_seconds_changes_no_event_and_drops_nothing(tmp_path: Path) -> None:
    quiet = events(run_through(tmp_path / "quiet", nullcontext()))
    with disk_image(tmp_path / "disk") as disk:
        stalled = events(run_through(disk.folder / "results", disk.stalled(), STALL))
    assert stalled.keys() == quiet.keys()
    worst = max(abs(stalled[name] - quiet[name]) for name in quiet)
    print(f"\ndisk stalled for {STALL:g} s: 0 dropped, events differ by {1000 * worst:.1f} ms")
    assert worst <= SAMPLE


LASTING = 300.0  # s
SLICES = 24
SCORINGS = 5
SHOWN = 0.1  # s between two states for the screens
STRIPS = [m.topic for m in DEFAULT_MAPPINGS if "/passage/" in m.topic]


NOBODY, SOMEBODY = 3.0, 1.2  # m to what is below


def ranges(*heights: float) -> Edit:
    """These in turn."""
    turn = cycle(heights)
    return lambda message: set_value(message, next(turn))


def begun(results: Path, *heights: float) -> FaultyDrive:
    """A run that goes on, and will end by its timeout."""
    drive = FaultyDrive(results)
    drive.act(SetUp(make_setup(timeout=LASTING, countdown=1.0)))
    drive.wait(2.1)
    drive.act(ZeroHandle(), ConfirmPose())
    drive.begin()
    for topic in STRIPS:
        drive.faulty.fake(topic, ranges(*heights))
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)
    return drive


def cost(job: Callable[[], object]) -> float:
    """Processor time that it takes, s."""
    began = time.process_time()
    job()
    return time.process_time() - began


def going_on(drive: FaultyDrive) -> float:
    """Processor time of a slice of a run, s."""
    drive.faulty.handed.clear()

    def shown() -> None:
        for _ in range(round((LASTING - 2.0) / SLICES / SHOWN)):
            drive.wait(SHOWN)
            drive.engine.snapshot()

    return cost(shown)


def ended(drive: FaultyDrive) -> Callable[[], None]:
    """The end of a run; what scores it again, to the same result."""
    result = drive.result()
    assert result.outcome is Outcome.TIMEOUT
    folder = drive.folder
    drive.engine.close()

    def scored() -> None:
        assert next(score(folder)).result == result

    return scored


def ratios(costs: Iterable[tuple[float, float]]) -> list[float]:
    """How many times the first the second of each pair is: side by side, so that others disturb
    both alike."""
    return [second / first for first, second in costs]


@pytest.mark.slow
def test_strips_that_flicker_for_five_minutes_hold_nothing_up(tmp_path: Path) -> None:
    assert len(STRIPS) == 4
    quiet = begun(tmp_path / "quiet", NOBODY)
    flickering = begun(tmp_path / "flickering", SOMEBODY, NOBODY)
    engine = ratios((going_on(quiet), going_on(flickering)) for _ in range(SLICES))
    early, late = median(engine[: SLICES // 2]), median(engine[SLICES // 2 :])
    scorings = ended(quiet), ended(flickering)
    del quiet, flickering
    gc.collect()
    gc.freeze()  # scoring is a process of its own: its collector sees no engine and no tests
    scoring = median(ratios((cost(scorings[0]), cost(scorings[1])) for _ in range(SCORINGS)))
    gc.unfreeze()
    print(
        f"\nall strips flickering for {LASTING:g} s, processor time beside a quiet run: engine "
        f"{early:.2f} times in the first half, {late:.2f} in the second, "
        f"scoring again {scoring:.2f} times"
    )
    assert late <= 1.5 * early
    assert median(engine) <= 2.0
    assert scoring <= 2.0


PAGE = os.sysconf("SC_PAGE_SIZE")
MEMORY_GROWTH = 4_000_000
OF_A_RUN = (
    *(Engine, Recording, BagWriter, Journal, RunTracker, Assessment),
    *(Scored, OpenedRun, RenderedResult, EarlierRun),
)


@dataclass(frozen=True)
class Usage:
    """What a process holds."""

    memory: int
    threads: int
    handles: int

    @classmethod
    def of(cls, pid: int | str = "self") -> Usage:
        process = Path("/proc") / str(pid)
        return cls(
            memory=int((process / "statm").read_text().split()[1]) * PAGE,
            threads=len(list((process / "task").iterdir())),
            handles=len(list((process / "fd").iterdir())),
        )


def live_objects() -> Counter[str]:
    gc.collect()
    found = (type(o) for o in gc.get_objects() if isinstance(o, OF_A_RUN))
    return Counter(kind.__name__ for kind in found)


class Day:
    """One engine, and a referee who does something else in every run."""

    def __init__(self, results: Path) -> None:
        self.drive = Drive(results, Scenario.RANDOM)
        self.rng = random.Random(13)
        self.runs = 0
        self.began = self.drive.engine.now()
        self._kept: Path | None = None

    @property
    def hours(self) -> float:
        return (self.drive.engine.now() - self.began) / 3600

    def one_run(self) -> None:
        drive, engine = self.drive, self.drive.engine
        number, condition = self.runs // 20 + 1, Condition.from_number(self.runs % 20 + 1)
        setup = make_setup(condition, run_number=number, timeout=self.rng.uniform(20.0, 60.0))
        self.runs += 1
        drive.start(setup)
        self._in_the_middle()
        while engine.scored is None:
            drive.wait(0.1)
            engine.snapshot()  # as often as screens look
        drive.act(Rule(Step.CROSS, confirmed=True, reason="seen"))
        drive.act(signed(engine.snapshot()))
        assert engine.refused == ""
        assert engine.folder is not None
        folder = engine.folder
        self._afterwards(folder)
        drive.wait(self.rng.uniform(1.0, 5.0))

    def _in_the_middle(self) -> None:
        drive = self.drive
        match self.runs % 8:
            case 3:
                drive.act(MarkIncident(IncidentKind.COLLISION, "door frame"))
            case 5:
                drive.wait(4.0)
                drive.act(Abort("enough"))
            case 7:
                drive.wait(6.0)
                drive.act(DeclareTimeout("gave up"))

    def _afterwards(self, folder: Path) -> None:
        """Look at the run before now and then; keep the disk small."""
        if self.runs % 5 == 0 and self._kept is not None:
            assert self.drive.open(self._kept) is None
            self.drive.act(Reissue("appeal granted"))
        if self._kept is not None:
            shutil.rmtree(self._kept)
        self._kept = folder


@pytest.mark.slow
def test_memory_threads_and_handles_stay_flat_over_a_day_of_runs(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """1200 runs are ten hours."""
    count = max(20, request.config.getoption("--runs"))
    day = Day(tmp_path / "results")
    usage, objects = [], []
    before = live_objects()
    threads = threading.active_count()
    for _ in range(count):
        day.one_run()
        assert threading.active_count() == threads
        usage.append(Usage.of())
        if day.runs in (count // 2, count):
            objects.append(live_objects() - before)
    first, second = usage[count // 4 : count // 2], usage[count // 2 :]
    grown = max(u.memory for u in second) - max(u.memory for u in first)
    print(
        f"\n{count} runs, {day.hours:.1f} simulated hours: {megabytes(usage[count // 4])} after "
        f"{count // 4} runs, {megabytes(usage[-1])} at the end; {held(usage)}; live objects "
        f"{dict(objects[-1])}"
    )
    assert grown < MEMORY_GROWTH
    assert {u.threads for u in second} <= {u.threads for u in first}
    assert {u.handles for u in second} <= {u.handles for u in first}
    assert objects[0] == objects[1]
    assert max(objects[1].values()) <= 2
    day.drive.engine.close()


def megabytes(usage: Usage) -> str:
    return f"{usage.memory / 1e6:.1f} MB"


def held(usage: list[Usage]) -> str:
    threads, handles = {u.threads for u in usage}, {u.handles for u in usage}
    return f"threads {sorted(threads)}, file handles {sorted(handles)}"


@pytest.mark.slow
def test_screens_that_come_and_go_leave_nothing_behind(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    count = 5 * max(20, request.config.getoption("--runs"))
    usage = []
    with EngineProcess(tmp_path / "results", "nominal") as engine:
        time.sleep(5.0)  # it loads what scoring needs
        for number in range(count):
            screen = RemoteEngine(engine.name, Role.WATCH, f"screen {number}")
            screen.snapshot()
            screen.close()
            usage.append(Usage.of(engine.process.pid))
        time.sleep(1.0)
        usage.append(Usage.of(engine.process.pid))
    first, last = usage[count // 4], usage[-1]
    print(
        f"\n{count} screens came and went: {megabytes(first)} after {count // 4}, "
        f"{megabytes(last)} at the end; {held(usage)}"
    )
    assert last.memory - first.memory < MEMORY_GROWTH
    assert last.handles <= first.handles
    assert last.threads <= first.threads
